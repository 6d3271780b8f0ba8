// Stage `downsample`: image level k to k+1, (a + b + c + d + 2) / 4 of every 2x2 block.
// Twin: `src/backend/cpu/downsample.rs`.

@group(0) @binding(0) var<uniform> halving: Halving;
@group(0) @binding(1) var<storage, read> larger: array<u32>;
@group(0) @binding(2) var<storage, read_write> smaller: array<u32>;

/// The two 16-bit sums of neighbouring bytes of a word.
fn pair_sums(word: u32) -> u32 {
    return (word & 0x00ff00ffu) + ((word >> 8u) & 0x00ff00ffu);
}

/// Rounded averages of the two 2x2 blocks under a pair of words, in bytes 0 and 1.
fn average(top: u32, bottom: u32) -> u32 {
    let mean = ((pair_sums(top) + pair_sums(bottom) + 0x00020002u) >> 2u) & 0x00ff00ffu;
    return (mean | (mean >> 8u)) & 0xffffu;
}

/// One word (four pixels) of the smaller image per invocation, frames along z. Bytes beyond its width are not defined, and the next
/// level does not look at them.
@compute @workgroup_size(WORKGROUP)
fn downsample(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= halving.words || id.y >= halving.rows) {
        return;
    }
    let top = (id.z * halving.rows_in + 2u * id.y) * halving.stride_in + 2u * id.x;
    let bottom = top + halving.stride_in;
    let left = average(larger[top], larger[bottom]);
    let right = average(larger[top + 1u], larger[bottom + 1u]);
    smaller[(id.z * halving.rows + id.y) * halving.stride_out + id.x] = left | (right << 16u);
}
