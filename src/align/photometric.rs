//! Gain and bias of groups of triangles, eliminated in closed form (variable projection).
//!
//! Per group G: B = sum s B_i + prior, w = sum s w_i, (gain, bias) = -B^-1 w, and the cost falls by w^T B^-1 w.
//! There is no state to carry, and any number of groups costs nothing in the solve of the pose.

use nalgebra::{Matrix2, Vector2};

use super::normal_equations::Rows;
use crate::model::moments::{BIAS, GAIN};
use crate::model::{Groups, LevelTemplate};

/// Noise behind the priors, grey levels.
pub(super) const PRIOR_NOISE: f64 = 4.0;
/// Prior standard deviation of a gain about 0 (template units).
const PRIOR_GAIN: f64 = 0.3;
/// Prior standard deviation of a bias about 0, grey levels.
const PRIOR_BIAS: f64 = 30.0;

/// Gain and bias of one group, with what is needed to eliminate them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solution {
    /// B^-1.
    pub(super) inverse: Matrix2<f64>,
    /// w.
    pub(super) gradient: Vector2<f64>,
    /// (gain, bias): the image is (1 + gain) (T - centre) + centre + bias.
    pub(super) value: Vector2<f64>,
}

impl Solution {
    /// Change of the residual as factors of the appearance columns: gain (T0 - centre) + bias.
    pub(super) fn columns(&self, centre: f64) -> [(usize, f64); 2] {
        [(GAIN, self.value.x), (BIAS, self.value.y - centre * self.value.x)]
    }

    /// By how much the elimination lowers the cost.
    pub(super) fn reduction(&self) -> f64 {
        -self.gradient.dot(&self.value)
    }
}

/// B_i of the columns (T0 - centre, 1).
pub(super) fn centred(b: &nalgebra::DMatrix<f64>, centre: f64) -> Matrix2<f64> {
    let (tt, t1, one) = (b[(GAIN, GAIN)], b[(GAIN, BIAS)], b[(BIAS, BIAS)]);
    let cross = t1 - centre * one;
    Matrix2::new(tt - 2.0 * centre * t1 + centre * centre * one, cross, cross, one)
}

/// w_i of the columns (T0 - centre, 1).
pub(super) fn centred_gradient(appearance: &[f64], centre: f64) -> Vector2<f64> {
    Vector2::new(appearance[GAIN] - centre * appearance[BIAS], appearance[BIAS])
}

/// Solves every group with the triangle weights `s`.
pub(super) fn solve(
    groups: &Groups,
    level: &LevelTemplate,
    rows: &Rows<'_>,
    s: &[f64],
    solutions: &mut Vec<Solution>,
) {
    let variance = PRIOR_NOISE * PRIOR_NOISE;
    let prior =
        Matrix2::new(variance / (PRIOR_GAIN * PRIOR_GAIN), 0.0, 0.0, variance / (PRIOR_BIAS * PRIOR_BIAS));
    let zero = Vector2::zeros();
    solutions.clear();
    // B is added up where its inverse will be.
    solutions.resize(groups.len(), Solution { inverse: prior, gradient: zero, value: zero });
    for (t, moments) in level.moments.iter().enumerate().filter(|(t, _)| s[*t] > 0.0) {
        let group = groups.of_triangle[t];
        let row = rows.row(t);
        let Solution { inverse: b, gradient: w, .. } = &mut solutions[group];
        *b += s[t] * rows.inside(level, t) * centred(&moments.appearance, groups.centre[group]);
        *w += s[t] * centred_gradient(row.appearance(), groups.centre[group]);
    }
    for solution in solutions {
        // The prior keeps B positive definite.
        solution.inverse = solution.inverse.try_inverse().unwrap_or_else(Matrix2::zeros);
        solution.value = -solution.inverse * solution.gradient;
    }
}
