//! What one triangle brings to the normal equations.

use super::derivative::TrianglePart;
use super::normal_equations::Rows;
use crate::model::moments::{BIAS, FIRST_MODE, GAIN};
use crate::model::{LevelTemplate, Moments};

/// A triangle that is being added. Its products are of plain arrays: those of nalgebra's that are this small cost more than
/// their arithmetic.
#[derive(Debug)]
pub(super) struct Contribution<'a> {
    moments: &'a Moments,
    /// sum q r A^T.
    pub(super) row: &'a [f64],
    /// Its weight.
    pub(super) s: f64,
    /// Its weight times the share (0..1, by weight) of its pixels inside the image.
    pub(super) share: f64,
    part: &'a TrianglePart<'a>,
    /// L^T sum q r f: its part in the pose block of JtQr, without the weight.
    pub(super) gradient: [f64; 6],
    /// The columns of L^T sum q f A^T.
    pub(super) coupled: &'a [[f64; 6]],
}

impl<'a> Contribution<'a> {
    /// A triangle with weight `s`, of which a share `inside` is in the image; `memory` is for its couplings.
    pub(super) fn new(
        level: &'a LevelTemplate,
        (triangle, rows): (usize, &Rows<'a>),
        (s, inside): (f64, f64),
        part: &'a TrianglePart<'a>,
        memory: &'a mut Vec<[f64; 6]>,
    ) -> Self {
        let transposed = part.motion.transpose();
        let project = |x: &[f64], factor: f64| {
            let mut projected = [0.0; 6];
            for (row, x) in transposed.data.0.iter().zip(x) {
                add(&mut projected, factor * x, row);
            }
            projected
        };
        memory.clear();
        memory.extend(part.cross.as_slice().chunks_exact(6).map(|column| project(column, part.share)));
        Self {
            moments: &level.moments[triangle],
            row: rows.row(triangle).appearance(),
            s,
            share: s * inside,
            part,
            gradient: project(part.gradient.as_slice(), 1.0),
            coupled: memory,
        }
    }

    /// A column of sum q A A^T over the whole triangle.
    pub(super) fn appearance(&self, column: usize) -> &'a [f64] {
        let n = self.moments.appearance.nrows();
        &self.moments.appearance.as_slice()[column * n..][..n]
    }

    /// The columns of s L^T M L, 6x6, down to the diagonal: its part in the pose block of JtQJ.
    pub(super) fn pose_hessian(&self) -> [[f64; 6]; 6] {
        let ([l, m], s) = ([&self.part.motion, &self.part.hessian].map(|m| &m.data.0), self.s);
        let mut hessian = [[0.0; 6]; 6];
        for (j, (column, of_motion)) in hessian.iter_mut().zip(l).enumerate() {
            let mut product = [0.0; 6];
            for (m, l) in m.iter().zip(of_motion) {
                add(&mut product, *l, m);
            }
            for (sum, l) in column.iter_mut().zip(l).take(j + 1) {
                *sum = s * l.iter().zip(&product).map(|(l, p)| l * p).sum::<f64>();
            }
        }
        hessian
    }

    /// Adds its coupling to the columns of gain and bias of its group: pose, then appearance.
    pub(super) fn couple(&self, [gains, biases]: [&mut [f64]; 2], centre: f64) {
        let add_column = |sums: &mut [f64], column: usize, factor: f64| {
            add(&mut sums[..6], self.s * factor, &self.coupled[column]);
            add(&mut sums[6..], self.share * factor, &self.appearance(column)[FIRST_MODE..]);
        };
        add_column(gains, GAIN, 1.0);
        add_column(gains, BIAS, -centre);
        add_column(biases, BIAS, 1.0);
    }
}

/// Adds multiples of values to sums.
pub(super) fn add(sums: &mut [f64], factor: f64, values: &[f64]) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += factor * value;
    }
}
