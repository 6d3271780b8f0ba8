// What the stages that add up chunks of charts share: bindings, sampling and reduction. A stage defines SUM_PLANES, the
// number of planes of four sums, and the host puts `const MODE_PLANES: u32` in front: four modes are one plane.

/// Length of arrays over mode planes, which must not be empty.
const MODES: u32 = max(MODE_PLANES, 1u);

@group(0) @binding(0) var<uniform> level: Level;
@group(0) @binding(1) var<storage, read> chunks: array<Chunk>;
/// Signed u in the low, v in the high half, relative to the chart's centre.
@group(0) @binding(2) var<storage, read> positions: array<u32>;
/// Two 16-bit numbers to a word, the first in the low half: g_u and g_v with sign, T0 and q without.
@group(0) @binding(3) var<storage, read> texels: array<vec2u>;
/// T1..Tl, plane by plane, four 16-bit numbers with sign each.
@group(0) @binding(4) var<storage, read> modes: array<vec2u>;
@group(1) @binding(0) var<storage, read> warps: array<Warp>;
@group(1) @binding(1) var<storage, read> appearance: array<vec4f>;
@group(1) @binding(2) var<storage, read_write> sums: array<vec4f>;
/// The frames, one per layer.
@group(2) @binding(0) var image: texture_2d_array<f32>;
@group(2) @binding(1) var image_sampler: sampler;

/// Steps of the 16-bit numbers, as in `model::steps`.
const SIGNED_STEP: f32 = 1.0 / 128.0;
const INTENSITY_STEP: f32 = 1.0 / 256.0;
const WEIGHT_STEP: f32 = 1.0 / 32768.0;

/// Both halves of a word as numbers with sign.
fn halves(word: u32) -> vec2f {
    let both = bitcast<i32>(word);
    return vec2f(f32((both << 16u) >> 16u), f32(both >> 16u));
}

/// g_u, g_v, T0, q of a pixel.
fn texel_at(p: u32) -> vec4f {
    let packed = texels[p];
    let unsigned = vec2f(f32(packed.y & 0xffffu), f32(packed.y >> 16u));
    return vec4f(SIGNED_STEP * halves(packed.x), vec2f(INTENSITY_STEP, WEIGHT_STEP) * unsigned);
}

/// Four modes of a pixel.
fn modes_at(plane: u32, p: u32) -> vec4f {
    let packed = modes[plane * level.pixels + p];
    return SIGNED_STEP * vec4f(halves(packed.x), halves(packed.y));
}

var<workgroup> partial: array<vec4f, WORKGROUP * SUM_PLANES>;
/// The grey values 0..255 of the four pixels around a position in the order (0, 1), (1, 1), (1, 0), (0, 0); `pixel` is
/// the one with the smallest coordinates. Samplers interpolate with 8 bits, so the weights are ours.
fn neighbours(pixel: vec2f, size: vec2f, frame: u32) -> vec4f {
    return round(255.0 * textureGather(0, image, image_sampler, (pixel + 1.0) / size, frame));
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
