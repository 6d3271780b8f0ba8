// Stage `linearize`: as `accumulate`, with the gradient of the frame at the warped position in place of the template's,
// and with the second-order sums of a Gauss-Newton step. Twin: `src/backend/cpu/linearize.rs`. Bindings and
// reduction: `shaders/parts/`.

/// Planes of sums: those of `accumulate`, the second-order row of `backend::Linearization` with its first 30 numbers
/// padded to 32, then six planes per plane of modes.
const SUM_PLANES: u32 = 11u + 7u * MODE_PLANES;
/// Length of the array of couplings between pose and modes, which must not be empty.
const COUPLINGS: u32 = 6u * MODES;

/// Grey value 0..255 at a pixel plus a fraction, and its derivative by u and v.
fn bilinear_with_gradient(pixel: vec2f, fraction: vec2f, size: vec2f, frame: u32) -> vec3f {
    let v = neighbours(pixel, size, frame);
    let upper = v.z - v.w;
    let lower = v.y - v.x;
    let top = v.w + fraction.x * upper;
    let bottom = v.x + fraction.x * lower;
    return vec3f(top + fraction.y * (bottom - top), upper + fraction.y * (lower - upper), bottom - top);
}

/// One chunk and pose per workgroup: chunks along x (and z, where x is full), poses along y.
@compute @workgroup_size(WORKGROUP)
fn linearize(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = group.x + group.z * groups.x;
    let chunk = chunk_at(min(index, level.chunks - 1u));
    let warp = warp_at(group.y * level.triangles + chunk.triangle);
    let base = vec2f(warp.row_u.w, warp.row_v.w);
    let size = vec2f(textureDimensions(image));
    let frame = u32(max(warp.row_w.w - 1.0, 0.0));
    var lambda: array<vec4f, MODES>;
    for (var k = 0u; k < MODE_PLANES; k++) {
        lambda[k] = appearance_at(group.y * MODE_PLANES + k);
    }
    // Nothing returns early: all invocations meet at the barrier that a real GPU has.
    let end = select(chunk.start, chunk.end, index < level.chunks && warp.row_w.w > 0.0);

    var first: array<vec4f, 3>;
    var second: array<vec4f, 8>;
    var projections: array<vec4f, MODES>;
    var couplings: array<vec4f, COUPLINGS>;
    for (var p = chunk.start + lane; p < end; p += WORKGROUP) {
        let packed = pixel_at(p);
        let at = vec3f(position_of(packed), 1.0);
        let depth = dot(warp.row_w.xyz, at);
        let local = vec2f(dot(warp.row_u.xyz, at), dot(warp.row_v.xyz, at)) / depth;
        let corner = floor(local);
        let pixel = corner + base;
        // A positive range test, so that NaN is outside.
        if (depth > 0.0 && all(pixel >= vec2f()) && all(pixel < size - 1.0)) {
            let texel = texel_of(packed);
            let sample = bilinear_with_gradient(pixel, local - corner, size, frame);
            var residual = texel.z - sample.x;
            var mode: array<vec4f, MODES>;
            for (var k = 0u; k < MODE_PLANES; k++) {
                mode[k] = modes_at(k, p);
                residual += dot(lambda[k], mode[k]);
            }
            let q = texel.w;
            let qr = q * residual;
            let h = sample.yz;
            let along_u = h.x * at;
            let along_v = h.y * at;
            first[0] += qr * vec4f(along_u, along_v.x);
            first[1] += vec4f(qr * along_v.yz, qr * residual, q);
            first[2] += vec4f(1.0, qr * texel.z, qr, 0.0);
            // (u u, u v, u, v v) and (v, 1).
            let place = vec4f(at.x * at, at.y * at.y);
            let uu = q * h.x * h.x;
            let uv = q * h.x * h.y;
            let vv = q * h.y * h.y;
            let t = q * texel.z;
            second[0] += uu * place;
            second[1] += vec4f(uu * at.yz, uv * place.xy);
            second[2] += uv * vec4f(place.zw, at.yz);
            second[3] += vv * place;
            second[4] += vec4f(vv * at.yz, t * along_u.xy);
            second[5] += t * vec4f(along_u.z, along_v);
            second[6] += q * vec4f(along_u, along_v.x);
            second[7] += q * vec4f(along_v.yz, 0.0, 0.0);
            for (var k = 0u; k < MODE_PLANES; k++) {
                projections[k] += qr * mode[k];
                let weighted = q * mode[k];
                for (var a = 0u; a < 3u; a++) {
                    couplings[6u * k + a] += along_u[a] * weighted;
                    couplings[6u * k + 3u + a] += along_v[a] * weighted;
                }
            }
        }
    }

    let row = group.y * level.chunks + index;
    if (index < level.chunks) {
        let mine = first_plane(lane, row);
        for (var k = 0u; k < 3u; k++) {
            put(mine + k, first[k]);
        }
        for (var k = 0u; k < MODE_PLANES; k++) {
            put(mine + 3u + k, projections[k]);
        }
        for (var k = 0u; k < 8u; k++) {
            put(mine + 3u + MODE_PLANES + k, second[k]);
        }
        for (var k = 0u; k < 6u * MODE_PLANES; k++) {
            put(mine + 11u + MODE_PLANES + k, couplings[k]);
        }
    }
    finish(lane, row, index < level.chunks);
}
