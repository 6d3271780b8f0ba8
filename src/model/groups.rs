//! Which triangles share gain and bias.

use std::collections::HashMap;

use super::chart::Chart;
use super::moments::{BIAS, GAIN, Moments};
use super::shape::Shape;

/// Which triangles share gain and bias.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grouping {
    /// Those of one face in one reference view.
    FaceAndView,
    /// Every triangle has its own. Only near the solution: it takes most of the basin away.
    Triangle,
}

/// The groups of one level.
#[derive(Debug, Clone, PartialEq)]
pub struct Groups {
    /// Group of every triangle.
    pub of_triangle: Vec<usize>,
    /// Mean template intensity per group, grey levels: the gain acts about it.
    pub centre: Vec<f64>,
}

impl Groups {
    /// The groups of a level's charts.
    pub fn new(grouping: Grouping, shape: &Shape, charts: &[Chart], moments: &[Moments]) -> Self {
        let mut numbers = HashMap::new();
        let of_triangle: Vec<usize> = (0..charts.len())
            .map(|t| {
                let key = match grouping {
                    Grouping::FaceAndView => (shape.faces.of_triangle[t], charts[t].view, 0),
                    Grouping::Triangle => (0, 0, t),
                };
                let next = numbers.len();
                *numbers.entry(key).or_insert(next)
            })
            .collect();
        let mut sums = vec![(0.0, 0.0); numbers.len()];
        for (t, moments) in moments.iter().enumerate() {
            let (weighted, weight) = &mut sums[of_triangle[t]];
            *weighted += moments.appearance[(GAIN, BIAS)];
            *weight += moments.weight();
        }
        let centre = sums.into_iter().map(|(s, w): (f64, f64)| if w > 0.0 { s / w } else { 0.0 }).collect();
        Self { of_triangle, centre }
    }

    /// Number of groups.
    pub fn len(&self) -> usize {
        self.centre.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.centre.is_empty()
    }
}
