// Stage `accumulate`: warp, sample, residual, weight and sum over one chunk of a chart; eqs. (3), (9), (10), (17).
// Twin: `src/backend/cpu/accumulate.rs`. The host puts `const MODE_PLANES: u32` in front: four modes are one plane.

/// Planes of sums: the row of `backend::Sums` with its first 11 numbers padded to 12, then the modes.
const SUM_PLANES: u32 = 3u + MODE_PLANES;
/// Length of arrays over mode planes, which must not be empty.
const MODES: u32 = max(MODE_PLANES, 1u);

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> chunks: array<Chunk>;
/// Signed u in the low, v in the high half, relative to the chart's centre.
@group(0) @binding(2) var<storage, read> positions: array<u32>;
/// g_u, g_v, T0, q.
@group(0) @binding(3) var<storage, read> texels: array<vec4f>;
/// T1..Tl, plane by plane.
@group(0) @binding(4) var<storage, read> modes: array<vec4f>;
@group(1) @binding(0) var<storage, read> warps: array<Warp>;
@group(1) @binding(1) var<storage, read> appearance: array<vec4f>;
@group(1) @binding(2) var<storage, read_write> sums: array<vec4f>;
@group(2) @binding(0) var image: texture_2d<f32>;
@group(2) @binding(1) var image_sampler: sampler;

var<workgroup> partial: array<vec4f, WORKGROUP * SUM_PLANES>;

/// Grey value 0..255 at a pixel plus a fraction. Samplers interpolate with 8 bits, so the weights are ours.
fn bilinear(pixel: vec2f, fraction: vec2f, size: vec2f) -> f32 {
    // The four values in the order (0, 1), (1, 1), (1, 0), (0, 0).
    let v = round(255.0 * textureGather(0, image, image_sampler, (pixel + 1.0) / size));
    let top = v.w + fraction.x * (v.z - v.w);
    let bottom = v.x + fraction.x * (v.y - v.x);
    return top + fraction.y * (bottom - top);
}

/// Adds up the workgroup's sums in a fixed order and writes them to the row. Every invocation has to come here.
fn reduce(lane: u32, row: u32, write: bool) {
    workgroupBarrier();
    for (var i = lane; i < SUM_PLANES * (WORKGROUP / REDUCE); i += WORKGROUP) {
        let first = (i / SUM_PLANES) * REDUCE * SUM_PLANES + i % SUM_PLANES;
        var sum = partial[first];
        for (var k = 1u; k < REDUCE; k++) {
            sum += partial[first + k * SUM_PLANES];
        }
        if (WORKGROUP > REDUCE) {
            partial[first] = sum;
        } else if (write) {
            sums[row + i] = sum;
        }
    }
    if (WORKGROUP > REDUCE) {
        workgroupBarrier();
        for (var i = lane; write && i < SUM_PLANES; i += WORKGROUP) {
            var sum = partial[i];
            for (var k = REDUCE; k < WORKGROUP; k += REDUCE) {
                sum += partial[k * SUM_PLANES + i];
            }
            sums[row + i] = sum;
        }
    }
}

/// One chunk and pose per workgroup: chunks along x (and z, where x is full), poses along y.
@compute @workgroup_size(WORKGROUP)
fn accumulate(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let index = group.x + group.z * groups.x;
    let chunk = chunks[min(index, level.chunks - 1u)];
    let warp = warps[group.y * level.triangles + chunk.triangle];
    let base = vec2f(warp.row_u.w, warp.row_v.w);
    let size = vec2f(textureDimensions(image));
    var lambda: array<vec4f, MODES>;
    for (var k = 0u; k < MODE_PLANES; k++) {
        lambda[k] = appearance[group.y * MODE_PLANES + k];
    }
    // Nothing returns early: all invocations meet at the barrier.
    let end = select(chunk.start, chunk.end, index < level.chunks && warp.row_w.w > 0.0);

    var slope_u = vec4f();
    var slope_v = vec4f();
    var gains = vec4f();
    var projections: array<vec4f, MODES>;
    for (var p = chunk.start + lane; p < end; p += WORKGROUP) {
        let packed = bitcast<i32>(positions[p]);
        let at = vec3f(f32((packed << 16u) >> 16u), f32(packed >> 16u), 1.0);
        let depth = dot(warp.row_w.xyz, at);
        let local = vec2f(dot(warp.row_u.xyz, at), dot(warp.row_v.xyz, at)) / depth;
        let corner = floor(local);
        let pixel = corner + base;
        // A positive range test, so that NaN is outside.
        if (depth > 0.0 && all(pixel >= vec2f()) && all(pixel < size - 1.0)) {
            let texel = texels[p];
            var residual = texel.z - bilinear(pixel, local - corner, size);
            var mode: array<vec4f, MODES>;
            for (var k = 0u; k < MODE_PLANES; k++) {
                mode[k] = modes[k * level.pixels + p];
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

    let mine = lane * SUM_PLANES;
    partial[mine] = slope_u;
    partial[mine + 1u] = slope_v;
    partial[mine + 2u] = gains;
    for (var k = 0u; k < MODE_PLANES; k++) {
        partial[mine + 3u + k] = projections[k];
    }
    reduce(lane, (group.y * level.chunks + index) * SUM_PLANES, index < level.chunks);
}
