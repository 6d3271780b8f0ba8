//! How fast memory can be read: the limit that no kernel can beat.

use fearless_simd::{Level, Simd, dispatch, prelude::*};

/// Numbers per step: four vectors of the widest kind.
const STEP: usize = 64;

/// Reads all numbers once, as fast as the processor can.
pub(super) fn read(level: Level, data: &[u32]) -> u32 {
    dispatch!(level, simd => sum(simd, data))
}

#[inline(always)]
fn sum<S: Simd>(simd: S, data: &[u32]) -> u32 {
    let zero = S::u32s::splat(simd, 0);
    // Several sums, so that none waits for the one before.
    let mut sums = [zero; 4];
    for step in data.chunks_exact(STEP) {
        for (k, vector) in step.chunks_exact(S::u32s::LEN).enumerate() {
            sums[k % 4] += S::u32s::from_slice(simd, vector);
        }
    }
    (sums[0] + sums[1] + sums[2] + sums[3]).reduce_sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_is_read() {
        let data: Vec<u32> = (0..640).collect();
        assert_eq!(read(Level::new(), &data), 640 * 639 / 2, "the sum of all numbers");
    }
}
