//! Does the image show the object where the pose says? Correlation per triangle tells right from wrong where
//! residuals do not.

use super::normal_equations::Rows;
use crate::model::LevelTemplate;
use crate::model::moments::{BIAS, FIRST_MODE, GAIN};

/// Triangles with less variance (grey levels squared) have no texture to correlate.
const MIN_VARIANCE: f64 = 25.0;
/// Correlation from which on a triangle counts as recognised.
const RECOGNISED: f64 = 0.7;
/// A triangle is looked at if this share of it is inside the image.
const MIN_INSIDE: f64 = 0.5;
/// Fewer textured triangles than this say nothing.
const MIN_TRIANGLES: usize = 3;
/// Share of the triangles, in the middle of their order, whose mean correlation counts. The median alone jumps where half of the
/// object is covered: it is that of a triangle that is seen or of one that is not.
const MIDDLE: f64 = 0.2;
/// A pose is lost below this correlation.
pub(super) const LOST_CORRELATION: f64 = 0.56;
/// A pose is lost below this share of recognised triangles.
pub(super) const LOST_SHARE: f64 = 0.42;
/// So much more than that is what right poses had at least and wrong ones lacked: the unit of the margin.
const UNIT_CORRELATION: f64 = 0.03;
/// The same for the share.
const UNIT_SHARE: f64 = 0.045;

/// Agreement of template and image at a pose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Score {
    /// Correlation between template and image over the visible textured triangles, -1..1: the mean of the middle fifth.
    pub correlation: f64,
    /// Share (0..1) of them with a correlation above 0.7.
    pub recognised: f64,
    /// Share (0..1) of the template's pixels that were visible and inside the image.
    pub visible: f64,
}

impl Score {
    /// True if the object is not where the pose says.
    pub fn is_lost(&self) -> bool {
        // Written so that NaN is lost.
        !(self.correlation >= LOST_CORRELATION && self.recognised >= LOST_SHARE)
    }

    /// How far the pose is from being lost, in units in which right poses have 1 and wrong ones -1 or less; the smaller one
    /// of both measures. [`crate::model::Calibration`] makes a probability of it.
    pub fn margin(&self) -> f64 {
        let correlation = (self.correlation - LOST_CORRELATION) / UNIT_CORRELATION;
        let recognised = (self.recognised - LOST_SHARE) / UNIT_SHARE;
        // Written so that NaN stays NaN.
        if recognised < correlation || recognised.is_nan() { recognised } else { correlation }
    }

    /// Scores a pose from its sums; `visibility` is the share of each triangle that nothing hides.
    pub(super) fn new(
        level: &LevelTemplate,
        rows: &Rows<'_>,
        visibility: &[f64],
        appearance: &[f64],
        correlations: &mut Vec<f64>,
    ) -> Self {
        let seen = |t: usize| visibility[t] > 0.0 && rows.inside(level, t) >= MIN_INSIDE;
        let textured = |t: &usize| seen(*t) && level.moments[*t].variance() >= MIN_VARIANCE;
        let textured = (0..visibility.len()).filter(textured);
        correlations.clear();
        correlations.reserve(visibility.len());
        correlations.extend(textured.map(|t| correlation(level, rows, t, appearance)));
        let all: f64 = level.moments.iter().map(|m| m.count).sum();
        let inside: f64 = (0..visibility.len()).map(|t| visibility[t] * rows.row(t).count()).sum();
        let visible = if all > 0.0 { inside / all } else { 0.0 };
        if correlations.len() < MIN_TRIANGLES {
            return Self { visible, ..Self::default() };
        }
        let recognised = correlations.iter().filter(|c| **c > RECOGNISED).count();
        #[expect(clippy::cast_precision_loss, reason = "triangle counts are small")]
        let recognised = recognised as f64 / correlations.len() as f64;
        Self { correlation: middle(correlations), recognised, visible }
    }
}

/// Mean of the middle of at least one value; changes their order.
fn middle(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
    let left = (values.len() as f64 * (1.0 - MIDDLE) / 2.0) as usize;
    let middle = &values[left..values.len() - left];
    middle.iter().sum::<f64>() / middle.len() as f64
}

/// Correlation of template T = sum a_k A_k and image I = T - r over one triangle, weighted by q.
fn correlation(level: &LevelTemplate, rows: &Rows<'_>, triangle: usize, appearance: &[f64]) -> f64 {
    let (row, inside) = (rows.row(triangle), rows.inside(level, triangle));
    let b = &level.moments[triangle].appearance;
    let a = || [(GAIN, 1.0)].into_iter().chain((FIRST_MODE..).zip(appearance.iter().copied()));
    let ba = |row: usize| inside * a().map(|(k, a)| a * b[(row, k)]).sum::<f64>();
    let aw: f64 = a().map(|(k, a)| a * row.appearance()[k]).sum();
    let n = row.weight();
    let (t, tt) = (ba(BIAS), a().map(|(k, a)| a * ba(k)).sum::<f64>());
    let (i, ti, ii) = (t - row.appearance()[BIAS], tt - aw, tt - 2.0 * aw + row.cost());
    let covariance = ti - t * i / n;
    let variances = (tt - t * t / n) * (ii - i * i / n);
    if variances > 0.0 { (covariance / variances.sqrt()).clamp(-1.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_does_not_jump() {
        let half = |seen: usize| {
            let mut values: Vec<f64> = (0..100).map(|k| if k < seen { 0.9 } else { 0.1 }).collect();
            middle(&mut values)
        };
        assert_eq!([half(30), half(70)].map(|c| (c * 10.0).round()), [1.0, 9.0], "like the median");
        assert!(
            (half(49) - 0.46).abs() < 1e-9 && (half(51) - 0.54).abs() < 1e-9,
            "{} {}",
            half(49),
            half(51)
        );
        assert_eq!(middle(&mut [0.3]), 0.3, "one");
    }
}
