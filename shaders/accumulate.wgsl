// Stage `accumulate`: warp, sample, residual, weight and sum over one chunk of a chart; eqs. (3), (9), (10), (17).
// Twin: `src/backend/cpu/accumulate.rs`. Bindings and reduction: `shaders/parts/`.

/// Planes of sums: the row of `backend::Sums` with its first 11 numbers padded to 12, then the modes.
const SUM_PLANES: u32 = 3u + MODE_PLANES;

/// Grey value 0..255 at a pixel plus a fraction.
fn bilinear(pixel: vec2f, fraction: vec2f, size: vec2f, frame: u32) -> f32 {
    let v = neighbours(pixel, size, frame);
    let top = v.w + fraction.x * (v.z - v.w);
    let bottom = v.x + fraction.x * (v.y - v.x);
    return top + fraction.y * (bottom - top);
}

/// One chunk and pose per workgroup: chunks along x (and z, where x is full), poses along y.
@compute @workgroup_size(WORKGROUP)
fn accumulate(
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

    var slope_u = vec4f();
    var slope_v = vec4f();
    var gains = vec4f();
    var projections: array<vec4f, MODES>;
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
            var residual = texel.z - bilinear(pixel, local - corner, size, frame);
            var mode: array<vec4f, MODES>;
            for (var k = 0u; k < MODE_PLANES; k++) {
                mode[k] = modes_at(k, p);
                residual += dot(lambda[k], mode[k]);
            }
            let q = texel.w;
            let qr = q * residual;
            let g = qr * texel.xy;
            slope_u += vec4f(g.x * at, g.y * at.x);
            slope_v += vec4f(g.y * at.yz, qr * residual, q);
            gains += vec4f(1.0, qr * texel.z, qr, 0.0);
            for (var k = 0u; k < MODE_PLANES; k++) {
                projections[k] += qr * mode[k];
            }
        }
    }

    let row = group.y * level.chunks + index;
    if (index < level.chunks) {
        let mine = first_plane(lane, row);
        put(mine, slope_u);
        put(mine + 1u, slope_v);
        put(mine + 2u, gains);
        for (var k = 0u; k < MODE_PLANES; k++) {
            put(mine + 3u + k, projections[k]);
        }
    }
    finish(lane, row, index < level.chunks);
}
