// How the stages that add up chunks of charts read and sum on a software adapter: tables are textures, because llvmpipe
// compiles a read of a buffer to a loop over the invocations of a vector and a fetch of a texel to straight code; and
// every invocation has a row of its own, which the host adds up, because shared memory is as slow as a buffer.
// The other way: `on_gpu.wgsl`.

@group(0) @binding(1) var chunks: texture_2d<u32>;
@group(0) @binding(2) var pixels: texture_2d<u32>;
@group(0) @binding(3) var modes: texture_2d<u32>;
@group(1) @binding(0) var warps: texture_2d<u32>;
@group(1) @binding(1) var appearance: texture_2d<u32>;

/// Texels per row of a table.
const TABLE_WIDTH: u32 = 2048u;

/// Where the texel of a number is.
fn place(i: u32) -> vec2u {
    return vec2u(i % TABLE_WIDTH, i / TABLE_WIDTH);
}

fn chunk_at(i: u32) -> Chunk {
    let words = textureLoad(chunks, place(i), 0);
    return Chunk(words.x, words.y, words.z, words.w);
}

fn pixel_at(i: u32) -> vec4u {
    return textureLoad(pixels, place(i), 0);
}

/// A texel holds two planes. The compiler sees that two reads of it are one.
fn packed_modes_at(plane: u32, p: u32) -> vec2u {
    let both = textureLoad(modes, place((plane / 2u) * level.pixels + p), 0);
    return select(both.xy, both.zw, plane % 2u == 1u);
}

fn warp_vector(i: u32) -> vec4f {
    return bitcast<vec4f>(textureLoad(warps, place(i), 0));
}

fn warp_at(i: u32) -> Warp {
    let first = 5u * i;
    return Warp(
        warp_vector(first),
        warp_vector(first + 1u),
        warp_vector(first + 2u),
        warp_vector(first + 3u),
        warp_vector(first + 4u),
    );
}

fn appearance_at(i: u32) -> vec4f {
    return bitcast<vec4f>(textureLoad(appearance, place(i), 0));
}

/// Where an invocation puts its first plane of sums.
fn first_plane(lane: u32, row: u32) -> u32 {
    return (row * WORKGROUP + lane) * SUM_PLANES;
}

fn put(plane: u32, sum: vec4f) {
    sums[plane] = sum;
}

/// Nothing is left to do.
fn finish(lane: u32, row: u32, write: bool) {}
