//! Random templates and images for the stage `scan`, and the comparison of its peaks.

use aam6d::backend::{ScanPeak, ScanPoint, ScanRequest, ScanTemplates};
use aam6d::imaging::NormalisedGradient;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a request is made of.
pub(crate) struct ScanScene {
    pub(crate) image: NormalisedGradient,
    pub(crate) templates: ScanTemplates,
    pub(crate) chosen: Vec<u32>,
}

impl ScanScene {
    /// An image of this size and templates that reach beyond its borders; every second one is chosen, last first.
    pub(crate) fn new(seed: u64, width: usize, height: usize, templates: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut value = move || rng.random_range(-0.7..0.7_f32);
        let values = (0..width * height).map(|_| [value(), value()]).collect();
        let mut rng = ChaCha8Rng::seed_from_u64(seed + 1);
        let mut all = ScanTemplates::default();
        for k in 0..templates {
            let point = |_| ScanPoint {
                offset: [rng.random_range(-14..15), rng.random_range(-9..10)],
                value: [rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)],
            };
            all.push(&(0..8 + 7 * k % 93).map(point).collect::<Vec<_>>());
        }
        let chosen = (0..u32::try_from(templates).expect("few")).rev().step_by(2).collect();
        Self { image: NormalisedGradient { width, height, values }, templates: all, chosen }
    }

    pub(crate) fn request(&self) -> ScanRequest<'_> {
        ScanRequest { image: &self.image, templates: &self.templates, chosen: &self.chosen }
    }
}

/// Scores within rounding, and the same positions; `tolerance` is that of a sum of at most a hundred terms in f32.
pub(crate) fn compare_peaks(expected: &[ScanPeak], found: &[ScanPeak]) -> Result<(), String> {
    const TOLERANCE: f32 = 2e-5;
    if expected.len() != found.len() {
        return Err(format!("{} peaks where there should be {}", found.len(), expected.len()));
    }
    for (k, (e, f)) in expected.iter().zip(found).enumerate() {
        let near = (e.score - f.score).abs() <= TOLERANCE * (1.0 + e.score.abs());
        if !near || e.position != f.position {
            return Err(format!("peak {k}: {f:?} is not {e:?}"));
        }
    }
    Ok(())
}
