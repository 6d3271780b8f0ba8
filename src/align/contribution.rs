//! What one triangle brings to the normal equations.

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
    pub(super) part: &'a TrianglePart,
}

impl<'a> Contribution<'a> {
    pub(super) fn moments(&self) -> &'a Moments {
        &self.level.moments[self.triangle]
    }

    /// sum q r A^T.
    pub(super) fn row(&self) -> &'a [f64] {
        self.rows.row(self.triangle).appearance()
    }

    pub(super) fn inside(&self) -> f64 {
        self.rows.inside(self.level, self.triangle)
    }

    /// Adds its coupling to the columns of gain and bias of its group: pose, then appearance.
    pub(super) fn couple(&self, columns: [&mut [f64]; 2], centre: f64) {
        let (appearance, share) = (&self.moments().appearance, self.s * self.inside());
        let one = self.part.cross.fixed_view::<6, 1>(0, BIAS);
        let gain = self.part.cross.fixed_view::<6, 1>(0, GAIN) - centre * one;
        let transposed = self.s * self.part.motion.transpose();
        let [gains, biases] = columns;
        for (column, pose) in [(&mut *gains, transposed * gain), (&mut *biases, transposed * one)] {
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
