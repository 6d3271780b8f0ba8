// What the stages that add up chunks of charts share: bindings, unpacking and sampling. A stage defines SUM_PLANES, the
// number of planes of four sums, and the host puts `const MODE_PLANES: u32` in front: four modes are one plane. The host
// adds `on_gpu.wgsl` or `on_software.wgsl`, which say how tables are read and how sums leave the workgroup.

/// Length of arrays over mode planes, which must not be empty.
const MODES: u32 = max(MODE_PLANES, 1u);

@group(0) @binding(0) var<uniform> level: Level;
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

// A pixel is four words of two 16-bit numbers, the first in the low half: u and v relative to the chart's centre and g_u
// and g_v with sign, T0 and q without; the last word is free. A plane of modes has two words for a pixel, four numbers
// with sign.

/// u and v of a pixel relative to the chart's centre.
fn position_of(pixel: vec4u) -> vec2f {
    return halves(pixel.x);
}

/// g_u, g_v, T0, q of a pixel.
fn texel_of(pixel: vec4u) -> vec4f {
    let unsigned = vec2f(f32(pixel.z & 0xffffu), f32(pixel.z >> 16u));
    return vec4f(SIGNED_STEP * halves(pixel.y), vec2f(INTENSITY_STEP, WEIGHT_STEP) * unsigned);
}

/// Four modes of a pixel.
fn modes_at(plane: u32, p: u32) -> vec4f {
    let packed = packed_modes_at(plane, p);
    return SIGNED_STEP * vec4f(halves(packed.x), halves(packed.y));
}

/// The grey values 0..255 of the four pixels around a position in the order (0, 1), (1, 1), (1, 0), (0, 0); `pixel` is
/// the one with the smallest coordinates. Samplers interpolate with 8 bits, so the weights are ours.
fn neighbours(pixel: vec2f, size: vec2f, frame: u32) -> vec4f {
    return round(255.0 * textureGather(0, image, image_sampler, (pixel + 1.0) / size, frame));
}
