//! From the agreement of template and image to the probability that a pose is right.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Slope of a model that was not calibrated: a margin of 1, which all right poses of 535 had and no wrong one, is believed
/// with 0.9.
const SLOPE: f64 = 2.2;
/// How far calibration may easily turn the curve: standard deviation of the logarithm of the slope.
const SPREAD: f64 = 0.5;
/// What is known from other objects counts as much as so many right poses with a margin of 1, and as many wrong ones
/// with -1: training images without repetitions must not make it careless.
const KNOWN: f64 = 5.0;
/// Newton steps; the cost is convex but for the logarithm, and a handful is enough.
const STEPS: usize = 50;

/// Probability that a pose is right, by the margin m of its score ([`crate::align::Score::margin`]):
/// `1 / (1 + exp(-(slope m + offset)))`. Calibrated, it means the same for every object.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Per unit of the margin, positive.
    pub slope: f64,
    /// At a margin of zero.
    pub offset: f64,
}

impl Default for Calibration {
    fn default() -> Self {
        Self { slope: SLOPE, offset: 0.0 }
    }
}

impl Calibration {
    /// Probability that a pose with this margin is right; zero for NaN.
    pub fn probability(&self, margin: f64) -> f64 {
        let p = 1.0 / (1.0 + (-(self.slope * margin + self.offset)).exp());
        if p.is_nan() { 0.0 } else { p }
    }

    /// Refuses numbers that no calibration gives.
    pub(super) fn validate(&self) -> Result<()> {
        if self.slope > 0.0 && self.slope.is_finite() && self.offset.is_finite() {
            return Ok(());
        }
        let problem = format!("slope {}, offset {}", self.slope, self.offset);
        Err(Error::invalid("calibration of the score", problem, "train the model again"))
    }

    /// The most probable curve for margins of poses that are known to be right or wrong, beside what is known from other
    /// objects (logistic regression with a prior; Platt 1999). Few samples change little.
    pub fn fit(samples: &[(f64, bool)]) -> Self {
        let (mut turn, mut offset) = (0.0_f64, 0.0_f64);
        let stiffness = 1.0 / (SPREAD * SPREAD);
        let known = [(1.0, true, KNOWN), (-1.0, false, KNOWN)];
        let samples =
            || samples.iter().filter(|s| s.0.is_finite()).map(|&(m, right)| (m, right, 1.0)).chain(known);
        for _ in 0..STEPS {
            let curve = Self { slope: SLOPE * turn.exp(), offset };
            // Gradient and Gauss-Newton matrix of the negative logarithm of the posterior.
            let mut gradient = [stiffness * turn, 0.0];
            let mut hessian = [stiffness, 0.0, 0.0];
            for (margin, right, weight) in samples() {
                let p = curve.probability(margin);
                let (error, variance) = (weight * (p - f64::from(u8::from(right))), weight * p * (1.0 - p));
                let d = [curve.slope * margin, 1.0];
                gradient = [gradient[0] + error * d[0], gradient[1] + error];
                hessian[0] += variance * d[0] * d[0];
                hessian[1] += variance * d[0];
                hessian[2] += variance;
            }
            let determinant = hessian[0] * hessian[2] - hessian[1] * hessian[1];
            let step = [
                (hessian[2] * gradient[0] - hessian[1] * gradient[1]) / determinant,
                (hessian[0] * gradient[1] - hessian[1] * gradient[0]) / determinant,
            ];
            turn = (turn - step[0].clamp(-0.5, 0.5)).clamp(-3.0, 3.0);
            offset -= step[1].clamp(-0.5, 0.5);
        }
        Self { slope: SLOPE * turn.exp(), offset }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_samples_what_is_known_stays() {
        let (fitted, default) = (Calibration::fit(&[]), Calibration::default());
        assert!(fitted.offset.abs() < 1e-9 && (2.0..4.0).contains(&fitted.slope), "{fitted:?}");
        assert!((default.probability(1.0) - 0.9).abs() < 0.01, "a margin of 1");
        assert!(default.probability(f64::NAN) == 0.0, "NaN is not believed");
    }

    #[test]
    fn samples_of_a_curve_give_it_back() {
        // As many samples at each margin as the curve says are right.
        let truth = Calibration { slope: 1.3, offset: -1.5 };
        let sample = |k: u32| {
            let margin = f64::from(k / 100) * 0.1 - 4.0;
            (margin, f64::from(k % 100) + 0.5 < 100.0 * truth.probability(margin))
        };
        let samples: Vec<_> = (0..10_000).map(sample).collect();
        let fitted = Calibration::fit(&samples);
        assert!((fitted.slope - truth.slope).abs() < 0.05, "{fitted:?}");
        assert!((fitted.offset - truth.offset).abs() < 0.1, "{fitted:?}");
    }

    #[test]
    fn wrong_poses_with_good_scores_make_it_careful() {
        let samples: Vec<_> = (0..40).map(|k| (f64::from(k) * 0.1, k >= 20)).collect();
        let fitted = Calibration::fit(&samples);
        assert!(fitted.probability(1.0) < 0.6 && fitted.probability(3.0) > 0.7, "{fitted:?}");
    }

    #[test]
    fn separated_samples_have_an_end() {
        let samples: Vec<_> =
            (0..200).map(|k| if k % 2 == 0 { (12.0, true) } else { (-9.0, false) }).collect();
        let fitted = Calibration::fit(&samples);
        assert!(fitted.slope.is_finite() && fitted.validate().is_ok(), "{fitted:?}");
        assert!((1.0..20.0).contains(&fitted.slope) && fitted.offset.abs() < 2.0, "{fitted:?}");
    }
}
