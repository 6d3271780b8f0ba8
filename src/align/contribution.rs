//! What one triangle brings to the normal equations.

use nalgebra::Matrix6;

use super::derivative::TrianglePart;
use super::normal_equations::Rows;
use crate::model::moments::{BIAS, FIRST_MODE, GAIN};
use crate::model::{LevelTemplate, Moments};

/// A triangle that is being added.
#[derive(Debug)]
pub(super) struct Contribution<'a> {
    pub(super) level: &'a LevelTemplate,
    pub(super) triangle: usize,
    pub(super) rows: Rows<'a>,
    /// Its weight.
    pub(super) s: f64,
    /// Share (0..1, by weight) of its pixels inside the image.
    pub(super) inside: f64,
    pub(super) part: &'a TrianglePart<'a>,
}

impl<'a> Contribution<'a> {
    pub(super) fn moments(&self) -> &'a Moments {
        &self.level.moments[self.triangle]
    }

    /// sum q r A^T.
    pub(super) fn row(&self) -> &'a [f64] {
        self.rows.row(self.triangle).appearance()
    }

    /// s L^T M L, 6x6: its part in the pose block of JtQJ.
    pub(super) fn pose_hessian(&self) -> Matrix6<f64> {
        // Columns as plain arrays: products of nalgebra's that are this small cost more than their arithmetic.
        let ([l, m], s) = ([&self.part.motion, &self.part.hessian].map(|m| &m.data.0), self.s);
        let mut product = [[0.0; 6]; 6];
        for (column, l) in product.iter_mut().zip(l) {
            for (m, l) in m.iter().zip(l) {
                column.iter_mut().zip(m).for_each(|(sum, m)| *sum += m * l);
            }
        }
        let mut hessian = Matrix6::zeros();
        for (j, product) in product.iter().enumerate() {
            for (i, l) in l.iter().enumerate().take(j + 1) {
                let value = s * l.iter().zip(product).map(|(l, p)| l * p).sum::<f64>();
                (hessian[(i, j)], hessian[(j, i)]) = (value, value);
            }
        }
        hessian
    }

    /// Adds its coupling to the columns of gain and bias of its group: pose, then appearance.
    pub(super) fn couple(&self, columns: [&mut [f64]; 2], centre: f64) {
        let (appearance, share) = (&self.moments().appearance, self.s * self.inside);
        let TrianglePart { motion, cross, share: of_cross, .. } = self.part;
        let scale = self.s * of_cross;
        let one = cross.fixed_view::<6, 1>(0, BIAS) * scale;
        let gain = cross.fixed_view::<6, 1>(0, GAIN) * scale - centre * one;
        let [gains, biases] = columns;
        for (column, pose) in [(&mut *gains, motion.tr_mul(&gain)), (&mut *biases, motion.tr_mul(&one))] {
            for (sum, value) in column.iter_mut().zip(&pose) {
                *sum += value;
            }
        }
        for k in 0..gains.len() - 6 {
            let with = |column: usize| appearance[(FIRST_MODE + k, column)];
            gains[6 + k] += share * (with(GAIN) - centre * with(BIAS));
            biases[6 + k] += share * with(BIAS);
        }
    }
}
