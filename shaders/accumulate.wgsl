// Stage `accumulate`: warp, sample, residual, weight and sum over one chunk of a chart; eqs. (3), (9), (10), (17).
// Twin: `src/backend/cpu/accumulate.rs`. Bindings and reduction: `shaders/parts/`.

/// Planes of sums: the row of `backend::Sums` with its first 11 numbers padded to 12, then the modes.
const SUM_PLANES: u32 = 3u + MODE_PLANES;

/// As in `src/backend/warp.rs`: the blur that the template has already, square pixels; the grey level from which on a pixel is
/// saturated; the share of weights from which on a position is.
const TEMPLATE_BLUR: f32 = 1.0 / 12.0;
const SATURATED: f32 = 254.0;
const SATURATED_SHARE: f32 = 0.25;

/// Between the values of four neighbours.
fn bilinear(v: vec4f, fraction: vec2f) -> f32 {
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
    let is_blurred = any(warp.blur_u.xyz != vec3f()) || any(warp.blur_v.xyz != vec3f());
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
            let fraction = local - corner;
            var expected = texel.z;
            var mode: array<vec4f, MODES>;
            for (var k = 0u; k < MODE_PLANES; k++) {
                mode[k] = modes_at(k, p);
                expected += dot(lambda[k], mode[k]);
            }
            if (is_blurred) {
                let second = curvature_of(packed);
                let spread = fraction * (1.0 - fraction) - TEMPLATE_BLUR;
                expected += spread.x * dot(warp.blur_u.xyz, second) + spread.y * dot(warp.blur_v.xyz, second);
            }
            let around = neighbours(pixel, size, frame);
            let shown = bilinear(around, fraction);
            // What is saturated is taken for as bright as the light makes the template.
            let lit = expected + warp.blur_u.w * texel.z + warp.blur_v.w;
            let saturated = bilinear(select(vec4f(), vec4f(1.0), around >= vec4f(SATURATED)), fraction);
            let missing = min(saturated / SATURATED_SHARE, 1.0) * max(lit - shown, 0.0);
            let residual = expected - (shown + missing);
            let q = texel.w;
            let qr = q * residual;
            let g = qr * texel.xy;
            slope_u += vec4f(g.x * at, g.y * at.x);
            slope_v += vec4f(g.y * at.yz, qr * residual, q);
            gains += vec4f(select(1.0, 1.0 - min(missing, 1.0), q > 0.0), qr * texel.z, qr, 0.0);
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
