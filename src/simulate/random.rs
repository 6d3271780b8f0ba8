//! Seeded randomness that is the same on every machine: `ChaCha` streams, lattice noise, a Gaussian table.
//!
//! Nothing here calls the platform's mathematics library: `libm` and the four basic operations are exact everywhere.

use std::sync::LazyLock;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// What a random stream is for; every purpose draws from a stream of its own, so that more draws for one
/// purpose do not change another.
#[derive(Debug, Clone, Copy)]
pub(super) enum Purpose {
    Shape = 1,
    Surface = 2,
    Background = 3,
    Occluder = 4,
    Path = 5,
    Light = 6,
    Noise = 7,
    Click = 8,
    Robot = 9,
}

/// One independent stream of random numbers.
#[derive(Debug, Clone)]
pub(super) struct Stream(ChaCha8Rng);

impl Stream {
    /// The stream `index` of a purpose.
    pub(super) fn new(seed: u64, purpose: Purpose, index: u64) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream((purpose as u64) << 48 | index);
        Self(generator)
    }

    /// 64 random bits.
    pub(super) fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform in [lo, hi).
    pub(super) fn range(&mut self, lo: f64, hi: f64) -> f64 {
        const UNIT: f64 = 1.0 / (1_u64 << 53) as f64;
        lo + (hi - lo) * ((self.bits() >> 11) as f64 * UNIT)
    }

    /// True with the given probability.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        self.range(0.0, 1.0) < probability
    }

    /// Fills a buffer with random bytes.
    pub(super) fn fill(&mut self, bytes: &mut [u8]) {
        self.0.fill_bytes(bytes);
    }
}

/// Standard normal quantiles of the 2^16 equally likely classes.
static QUANTILES: LazyLock<Vec<f64>> = LazyLock::new(quantiles);

/// Calls `each` with an independent standard normal value per item, in order.
pub(super) fn for_each_gaussian<T>(stream: &mut Stream, items: &mut [T], mut each: impl FnMut(&mut T, f64)) {
    let mut bytes = [0; 4096];
    for chunk in items.chunks_mut(bytes.len() / 2) {
        stream.fill(&mut bytes);
        for (item, b) in chunk.iter_mut().zip(bytes.chunks_exact(2)) {
            each(item, QUANTILES[usize::from(u16::from_le_bytes([b[0], b[1]]))]);
        }
    }
}

/// Newton's method on the normal distribution function, each class starting from its neighbour.
fn quantiles() -> Vec<f64> {
    const CLASSES: usize = 1 << 16;
    let mut table = vec![0.0; CLASSES];
    let mut z: f64 = 0.0;
    for i in CLASSES / 2..CLASSES {
        let tail = (CLASSES as f64 - i as f64 - 0.5) / CLASSES as f64;
        for _ in 0..12 {
            let error = 0.5 * libm::erfc(z * std::f64::consts::FRAC_1_SQRT_2) - tail;
            let density = libm::exp(-0.5 * z * z) * 0.398_942_280_401_432_7;
            let step = error / density;
            z += step;
            if step.abs() < 1e-13 {
                break;
            }
        }
        table[i] = z;
        table[CLASSES - 1 - i] = -z;
    }
    table
}

/// Smooth noise in [-1, 1] with one random value per unit cell corner.
pub(super) fn value_noise(seed: u64, x: f64, y: f64) -> f64 {
    let (x0, y0) = (x.floor(), y.floor());
    #[expect(clippy::cast_possible_truncation, reason = "surfaces are far smaller than 2^63 cells")]
    let (ix, iy) = (x0 as i64, y0 as i64);
    let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (fx, fy) = (fade(x - x0), fade(y - y0));
    let top = corner(seed, ix, iy) * (1.0 - fx) + corner(seed, ix + 1, iy) * fx;
    let bottom = corner(seed, ix, iy + 1) * (1.0 - fx) + corner(seed, ix + 1, iy + 1) * fx;
    top * (1.0 - fy) + bottom * fy
}

/// Random value in [-1, 1) of a lattice corner (the splitmix64 finaliser).
fn corner(seed: u64, ix: i64, iy: i64) -> f64 {
    let mut h = seed
        ^ ix.cast_unsigned().wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ iy.cast_unsigned().wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    h ^= h >> 31;
    (h >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussian_has_unit_variance_and_no_mean() {
        let mut values = vec![0.0; 200_000];
        for_each_gaussian(&mut Stream::new(3, Purpose::Noise, 0), &mut values, |v, z| *v = z);
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n;
        let beyond = values.iter().filter(|v| v.abs() > 1.959_964).count() as f64 / n;
        assert!(mean.abs() < 0.01, "mean {mean}");
        assert!((variance - 1.0).abs() < 0.015, "variance {variance}");
        assert!((beyond - 0.05).abs() < 0.003, "{beyond} of the values lie beyond the 95 % bounds");
    }

    #[test]
    fn streams_differ_and_repeat() {
        let draw = |purpose, index| Stream::new(1, purpose, index).bits();
        assert_eq!(draw(Purpose::Path, 1), draw(Purpose::Path, 1), "the same stream twice");
        assert_ne!(draw(Purpose::Path, 1), draw(Purpose::Path, 2), "another index");
        assert_ne!(draw(Purpose::Path, 1), draw(Purpose::Light, 1), "another purpose");
    }

    #[test]
    fn noise_is_continuous_and_bounded() {
        for i in 0..4000 {
            let x = f64::from(i) * 0.013 - 20.0;
            let (a, b) = (value_noise(5, x, 0.3 * x), value_noise(5, x + 1e-6, 0.3 * x));
            assert!(a.abs() <= 1.0 && (a - b).abs() < 1e-5, "jump at {x}: {a} to {b}");
        }
    }
}
