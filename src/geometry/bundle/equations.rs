//! The normal equations of bundle adjustment in blocks, the points eliminated.

use std::ops::SubAssign;

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Matrix6x3, Vector3, Vector6};

/// Scaled reduced normal equations with a smaller eigenvalue leave a pose open.
const DEGENERATE: f64 = 1e-10;

/// Change of every `w` and every pose (translation, rotation vector).
pub(super) struct Step {
    pub(super) w: Vec<Vector3<f64>>,
    pub(super) poses: Vec<Vector6<f64>>,
}

/// Normal equations in blocks: poses, points, and between them (`mixed[i][k]`).
pub(super) struct Equations {
    pub(super) pose: Vec<Matrix6<f64>>,
    pub(super) pose_gradient: Vec<Vector6<f64>>,
    pub(super) point: Vec<Matrix3<f64>>,
    pub(super) point_gradient: Vec<Vector3<f64>>,
    pub(super) mixed: Vec<Vec<Matrix6x3<f64>>>,
}

impl Equations {
    /// `S = U - W V^-1 W^T` and `a - W V^-1 b`, `inverses` being `V^-1`.
    fn reduced(&self, pose: &[Matrix6<f64>], inverses: &[Matrix3<f64>]) -> (DMatrix<f64>, DVector<f64>) {
        let size = 6 * pose.len();
        let (mut s, mut g) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for (i, pose) in pose.iter().enumerate() {
            s.fixed_view_mut::<6, 6>(6 * i, 6 * i).copy_from(pose);
            g.fixed_rows_mut::<6>(6 * i).copy_from(&self.pose_gradient[i]);
            for (k, inverse) in inverses.iter().enumerate() {
                let left = self.mixed[i][k] * inverse;
                g.fixed_rows_mut::<6>(6 * i).sub_assign(left * self.point_gradient[k]);
                for j in 0..self.pose.len() {
                    s.fixed_view_mut::<6, 6>(6 * i, 6 * j).sub_assign(left * self.mixed[j][k].transpose());
                }
            }
        }
        (s, g)
    }

    /// The damped step: every diagonal entry is enlarged by the share `damping`.
    pub(super) fn step(&self, damping: f64) -> Option<Step> {
        let inverse = |v: &Matrix3<f64>| (v + Matrix3::from_diagonal(&v.diagonal()) * damping).try_inverse();
        let inverses: Vec<Matrix3<f64>> = self.point.iter().map(inverse).collect::<Option<_>>()?;
        let pose = |u: &Matrix6<f64>| u + Matrix6::from_diagonal(&u.diagonal()) * damping;
        let poses: Vec<Matrix6<f64>> = self.pose.iter().map(pose).collect();
        let (s, g) = self.reduced(&poses, &inverses);
        let d = -s.cholesky()?.solve(&g);
        let poses: Vec<Vector6<f64>> = (0..poses.len()).map(|i| d.fixed_rows::<6>(6 * i).into()).collect();
        let point = |(k, inverse): (usize, &Matrix3<f64>)| {
            let pull = |sum: Vector3<f64>, (i, d): (usize, &Vector6<f64>)| sum + self.mixed[i][k].tr_mul(d);
            -inverse * poses.iter().enumerate().fold(self.point_gradient[k], pull)
        };
        Some(Step { w: inverses.iter().enumerate().map(point).collect(), poses })
    }

    /// Covariance of every `w`: `V^-1 + V^-1 W^T S^-1 W V^-1`; `None` if a pose is open.
    pub(super) fn covariances(&self) -> Option<Vec<Matrix3<f64>>> {
        let inverses: Vec<Matrix3<f64>> =
            self.point.iter().map(|v| v.try_inverse()).collect::<Option<_>>()?;
        let (s, _) = self.reduced(&self.pose, &inverses);
        let scale = DVector::from_fn(s.nrows(), |j, _| 1.0 / self.pose[j / 6][(j % 6, j % 6)].sqrt());
        let scaled = DMatrix::from_fn(s.nrows(), s.ncols(), |i, j| s[(i, j)] * scale[i] * scale[j]);
        let determined =
            scaled.iter().all(|v| v.is_finite()) && scaled.symmetric_eigenvalues().min() > DEGENERATE;
        let factor = s.cholesky().filter(|_| determined)?;
        let left = |(k, inverse): (usize, &Matrix3<f64>)| {
            let mut w = DMatrix::zeros(6 * self.pose.len(), 3);
            for i in 0..self.pose.len() {
                w.fixed_rows_mut::<6>(6 * i).copy_from(&self.mixed[i][k]);
            }
            let spread = w.tr_mul(&factor.solve(&w));
            inverse + inverse * spread.fixed_view::<3, 3>(0, 0) * inverse
        };
        Some(inverses.iter().enumerate().map(left).collect())
    }
}
