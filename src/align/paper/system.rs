//! What the paper computes before the first frame: the reference, J as moments, JtQJ and Sigma.

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Point3};

use crate::align::derivative::{CornerMotion, barycentric_gradient};
use crate::align::normal_equations::Rows;
use crate::align::vertices::MovingVertex;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::model::moments::FIRST_MODE;
use crate::model::{ChartGeometry, LevelTemplate, Model, View};

/// The reference view and the constant part of J.
#[derive(Debug, Clone)]
pub(super) struct Reference {
    /// H = I stands for the pose of this view.
    pub(super) view: View,
    /// L_i at H = I; `None` for triangles without a chart or that the reference does not see from the front.
    pub(super) motions: Vec<Option<Matrix6<f64>>>,
    modes: usize,
}

impl Reference {
    /// The first of the views that carry most triangles.
    pub(super) fn new(model: &Model) -> Result<Self> {
        let level = &model.levels[0];
        let mut carried = vec![0_usize; model.views.len()];
        level.charts.iter().filter(|c| !c.is_empty()).for_each(|c| carried[c.view as usize] += 1);
        let most = carried.iter().copied().max().unwrap_or(0);
        let view = carried.iter().position(|n| *n == most && most > 0).map(|k| model.views[k]);
        let view =
            view.ok_or_else(|| Error::invalid("model", "no triangle has a chart", "train the model again"))?;
        let motion = |g: &Option<ChartGeometry>| g.as_ref().and_then(|g| motion(&view, g));
        Ok(Self { view, motions: level.geometry.iter().map(motion).collect(), modes: model.modes() })
    }

    /// JtQr from the sums of a pass.
    pub(super) fn gradient(&self, level: &LevelTemplate, rows: &Rows<'_>) -> DVector<f64> {
        let mut sum = DVector::zeros(6 + self.modes);
        for (t, motion, geometry) in self.used(level) {
            let row = rows.row(t);
            let mut pose = sum.fixed_rows_mut::<6>(0);
            pose += motion.transpose() * barycentric_gradient(row.gradient(), geometry);
            let modes = &row.appearance()[FIRST_MODE..];
            sum.iter_mut().skip(6).zip(modes).for_each(|(s, w)| *s += w);
        }
        sum
    }

    fn used<'a>(
        &'a self,
        level: &'a LevelTemplate,
    ) -> impl Iterator<Item = (usize, &'a Matrix6<f64>, &'a ChartGeometry)> {
        let both = self.motions.iter().zip(&level.geometry).enumerate();
        both.filter_map(|(t, (motion, geometry))| Some((t, motion.as_ref()?, geometry.as_ref()?)))
    }
}

/// L_i at H = I: motion of the corners with an increment about the origin of the reference camera. The affine warp's
/// derivative, eq. (15) times da/dp, is this motion interpolated with barycentric coordinates: no approximation here.
fn motion(view: &View, geometry: &ChartGeometry) -> Option<Matrix6<f64>> {
    let (still, rotation) = (Pose::identity(), Matrix3::identity());
    let [a, b, c] = geometry.points.map(|x| {
        let in_camera = view.camera_from_object.transform_point(&x);
        MovingVertex::new(&view.camera, &still, &rotation, &in_camera, &Point3::origin())
    });
    CornerMotion::new([&a?, &b?, &c?], geometry).map(|c| c.template)
}

/// JtQJ and Sigma of eq. (18).
#[derive(Debug, Clone)]
pub(super) struct System {
    hessian: DMatrix<f64>,
    /// Diagonal of Sigma: column sums of squares of J, not weighted.
    squares: DVector<f64>,
}

impl System {
    /// JtQJ with the weights of the level; Sigma is the diagonal of `JtJ`, that of `unweighted`.
    pub(super) fn new(reference: &Reference, level: &LevelTemplate, unweighted: Option<&Self>) -> Self {
        let n = 6 + reference.modes;
        let mut hessian = DMatrix::zeros(n, n);
        for (t, motion, _) in reference.used(level) {
            let moments = &level.moments[t];
            let mut pose = hessian.fixed_view_mut::<6, 6>(0, 0);
            pose += motion.transpose() * moments.hessian * motion;
            let cross = motion.transpose() * moments.cross.columns(FIRST_MODE, reference.modes);
            let mut upper = hessian.view_mut((0, 6), (6, reference.modes));
            upper += &cross;
            let mut lower = hessian.view_mut((6, 0), (reference.modes, 6));
            lower += cross.transpose();
            let mut modes = hessian.view_mut((6, 6), (reference.modes, reference.modes));
            modes += moments.appearance.view((FIRST_MODE, FIRST_MODE), (reference.modes, reference.modes));
        }
        let squares = unweighted.map_or_else(|| hessian.diagonal(), |u| u.squares.clone());
        Self { hessian, squares }
    }

    /// Eq. (18) with the minus it lacks; `None` if the system cannot be solved.
    pub(super) fn solve(&self, gradient: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
        let damped = &self.hessian + DMatrix::from_diagonal(&(&self.squares * damping));
        let scale = damped.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { f64::NAN });
        let diagonal = DMatrix::from_diagonal(&scale);
        let factor = (&diagonal * damped * &diagonal).cholesky()?;
        let step = -factor.solve(&gradient.component_mul(&scale)).component_mul(&scale);
        step.iter().all(|d| d.is_finite()).then_some(step)
    }

    /// Pose block of the inverse of JtQJ; zero if there is none.
    pub(super) fn inverse(&self) -> Matrix6<f64> {
        let scale = self.hessian.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
        let diagonal = DMatrix::from_diagonal(&scale);
        let factor = (&diagonal * &self.hessian * &diagonal).cholesky();
        factor.map_or_else(Matrix6::zeros, |c| {
            (&diagonal * c.inverse() * &diagonal).fixed_view::<6, 6>(0, 0).into_owned()
        })
    }
}
