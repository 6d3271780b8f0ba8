//! Gain and bias of groups of triangles, eliminated in closed form (variable projection).
//!
//! Per group G: B = sum s B_i + prior, w = sum s w_i, (gain, bias) = -B^-1 w, and the cost falls by w^T B^-1 w.
//! There is no state to carry, and any number of groups costs nothing in the solve of the pose.

use std::collections::HashMap;

use nalgebra::{Matrix2, Vector2};

use super::normal_equations::Rows;
use crate::model::moments::{BIAS, GAIN};
use crate::model::{LevelTemplate, Shape};

/// Noise behind the priors, grey levels.
pub(super) const PRIOR_NOISE: f64 = 4.0;
/// Prior standard deviation of a gain about 0 (template units).
const PRIOR_GAIN: f64 = 0.3;
/// Prior standard deviation of a bias about 0, grey levels.
const PRIOR_BIAS: f64 = 30.0;

/// Which triangles share gain and bias.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grouping {
    /// Those of one face in one reference view.
    FaceAndView,
    /// Every triangle has its own. Only near the solution: it takes most of the basin away.
    Triangle,
}

/// The groups of one level.
#[derive(Debug, Clone)]
pub(super) struct Groups {
    /// Group of every triangle.
    pub(super) of_triangle: Vec<usize>,
    /// Mean template intensity per group: the gain acts about it.
    pub(super) centre: Vec<f64>,
}

impl Groups {
    pub(super) fn new(grouping: Grouping, shape: &Shape, level: &LevelTemplate) -> Self {
        let mut numbers = HashMap::new();
        let of_triangle: Vec<usize> = (0..level.charts.len())
            .map(|t| {
                let key = match grouping {
                    Grouping::FaceAndView => (shape.faces.of_triangle[t], level.charts[t].view, 0),
                    Grouping::Triangle => (0, 0, t),
                };
                let next = numbers.len();
                *numbers.entry(key).or_insert(next)
            })
            .collect();
        let mut sums = vec![(0.0, 0.0); numbers.len()];
        for (t, moments) in level.moments.iter().enumerate() {
            let (weighted, weight) = &mut sums[of_triangle[t]];
            *weighted += moments.appearance[(GAIN, BIAS)];
            *weight += moments.weight();
        }
        let centre = sums.into_iter().map(|(s, w): (f64, f64)| if w > 0.0 { s / w } else { 0.0 }).collect();
        Self { of_triangle, centre }
    }

    pub(super) fn len(&self) -> usize {
        self.centre.len()
    }
}

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
pub(super) fn solve(groups: &Groups, level: &LevelTemplate, rows: &Rows<'_>, s: &[f64]) -> Vec<Solution> {
    let variance = PRIOR_NOISE * PRIOR_NOISE;
    let prior =
        Matrix2::new(variance / (PRIOR_GAIN * PRIOR_GAIN), 0.0, 0.0, variance / (PRIOR_BIAS * PRIOR_BIAS));
    let mut sums = vec![(prior, Vector2::zeros()); groups.len()];
    for (t, moments) in level.moments.iter().enumerate().filter(|(t, _)| s[*t] > 0.0) {
        let group = groups.of_triangle[t];
        let row = rows.row(t);
        let (b, w) = &mut sums[group];
        *b += s[t] * rows.inside(level, t) * centred(&moments.appearance, groups.centre[group]);
        *w += s[t] * centred_gradient(row.appearance(), groups.centre[group]);
    }
    sums.into_iter()
        .map(|(b, gradient)| {
            // The prior keeps B positive definite.
            let inverse = b.try_inverse().unwrap_or_else(Matrix2::zeros);
            Solution { inverse, gradient, value: -inverse * gradient }
        })
        .collect()
}
