//! Triangle weights: what does not look like the object (occluder, highlight) is left out, triangle by triangle.

use super::normal_equations::{LevelProblem, Rows, triangle_rms};
use super::photometric;
use super::workspace::Scratch;

/// Residuals below this are noise whatever the median says, grey levels.
const NOISE_FLOOR: f64 = 2.5;
/// A misalignment of this many pixels is nothing to punish: it lets triangles of high contrast have more residual.
const CONTRAST_PX: f64 = 0.2;
/// Triangles with less than this share inside the image are dropped.
const MIN_INSIDE: f64 = 0.5;

/// Where the weight of a triangle starts to fall and where it ends, in units of its expected residual.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Redescent {
    pub(super) full: f64,
    pub(super) zero: f64,
}

impl Redescent {
    /// What every robust method uses.
    pub(super) const DEFAULT: Self = Self { full: 1.0, zero: 3.0 };
}

/// Weight (0..1) of a triangle whose rms is `z` times the expected one: 1, falling as ((zero - z)/(zero - full))^2.
fn redescend(z: f64, r: Redescent) -> f64 {
    if z <= r.full {
        1.0
    } else if z < r.zero {
        ((r.zero - z) / (r.zero - r.full)).powi(2)
    } else {
        0.0
    }
}

/// s_i = visibility times robust weight. The median that scales the residuals is over the visible triangles.
pub(super) fn triangle_weights(
    problem: &LevelProblem<'_>,
    rows: &Rows<'_>,
    visibility: &[f64],
    redescent: Option<Redescent>,
    scratch: &mut Scratch,
    weights: &mut Vec<f64>,
) {
    let inside = |t: usize| rows.inside(problem.level, t) >= MIN_INSIDE;
    weights.clear();
    weights.extend(visibility.iter().enumerate().map(|(t, v)| if inside(t) { *v } else { 0.0 }));
    let Some(redescent) = redescent else { return };
    let Scratch { solutions, rms, values, .. } = scratch;
    photometric::solve(problem.groups, problem.level, rows, weights, solutions);
    let rms_of = |(t, v): (usize, &f64)| {
        if *v > 0.0 { triangle_rms(problem, rows, t, solutions) } else { 0.0 }
    };
    rms.clear();
    rms.extend(weights.iter().enumerate().map(rms_of));
    values.clear();
    values.reserve(weights.len());
    values.extend(weights.iter().zip(&*rms).filter(|(v, _)| **v > 0.0).map(|(_, r)| *r));
    let scale = median(values).max(NOISE_FLOOR);
    for (t, (weight, rms)) in weights.iter_mut().zip(rms).enumerate() {
        let gain = 1.0 + solutions[problem.groups.of_triangle[t]].value.x;
        let expected = scale.hypot(CONTRAST_PX * gain * problem.level.moments[t].contrast);
        *weight *= redescend(*rms / expected, redescent);
    }
}

/// Median; 0 for nothing. Changes the order of the values.
pub(super) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_falls_smoothly_to_zero() {
        let r = Redescent { full: 1.0, zero: 3.0 };
        assert_eq!([0.5, 1.0, 2.0, 3.0, 9.0].map(|z| redescend(z, r)), [1.0, 1.0, 0.25, 0.0, 0.0], "1 .. 3");
    }

    #[test]
    fn medians() {
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0, "odd");
        assert_eq!(median(&mut []), 0.0, "nothing");
    }
}
