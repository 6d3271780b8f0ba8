//! What a training image says about the mesh: where its vertices really are, and how well its triangles fit.
//!
//! The template bends, every vertex for itself. With the pose as it is, vertex a of a triangle may lie `d_a` pixels from where the pose puts it; between the corners
//! the shift is linear. With L = blockdiag(A^-1, A^-1, A^-1) the residual is `r = f^T L d`, so the moments that give the
//! pose its normal equations give those of all vertices as well (`docs/maths.md`, section 13).

use nalgebra::{DMatrix, DVector, Matrix2, Matrix6, Matrix6x2, Vector2, Vector6};

use super::Target;
use super::derivative::{barycentric_gradient, chart_from_image, projected_corners};
use super::evaluator::{Evaluation, Evaluator, Sight, score};
use super::levenberg_marquardt::State;
use super::normal_equations::{LevelProblem, Rows, cost, triangle_rms};
use super::photometric::{self, Solution};
use super::robust::{Redescent, triangle_weights};
use super::visibility::visibility;
use super::workspace::Scratch;
use crate::backend::Backend;
use crate::error::Result;
use crate::geometry::Pose;
use crate::model::moments::{BIAS, GAIN};
use crate::model::{ChartGeometry, Grouping, Moments};

/// Standard deviation of a shift before the image is looked at, pixels: larger ones the linear equations do not find.
const PRIOR_PX: f64 = 2.0;
/// Residuals are never believed to be smaller, grey levels.
const LEAST_NOISE: f64 = 1.0;

/// A triangle is judged if this share of it is inside the image.
const MIN_INSIDE: f64 = 0.5;

/// How far a vertex is from where the pose puts it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VertexShift {
    /// Pixels of the image.
    pub shift: Vector2<f64>,
    /// What the noise of the image leaves open, square pixels.
    pub covariance: Matrix2<f64>,
}

/// How well a triangle agrees with an image, its own gain and bias aside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangleFit {
    /// Sum of q r^2, grey levels squared.
    pub cost: f64,
    /// Sum of q.
    pub weight: f64,
    /// Weight (0..1) by which a robust method would believe it.
    pub belief: f64,
}

/// The shifts of all vertices of the model's mesh at a pose that is right to a pixel, at full size and without appearance
/// modes; `None` for vertices of which the image shows no triangle, and for all if the object is not recognised.
///
/// # Errors
/// Those of the backend.
pub fn vertex_shifts(
    backend: &mut dyn Backend,
    target: &Target<'_>,
    pose: &Pose,
) -> Result<Vec<Option<VertexShift>>> {
    let mesh = &target.model.shape.mesh;
    let vertices = mesh.vertices.len();
    let shifts = inspect(backend, target, pose, |seen| {
        let (mean, weights) = (seen.mean, &seen.weights);
        let mut equations = Equations::new(vertices);
        for (t, &s) in weights.iter().enumerate().filter(|(_, s)| **s > 0.0) {
            let Some(geometry) = &seen.problem.level.geometry[t] else { continue };
            let corners = projected_corners(&seen.problem.camera, pose, geometry);
            let Some(inverse) = corners.and_then(|c| chart_from_image(&c, geometry)) else { continue };
            equations.add(mesh.triangles[t], &Part::new(seen, (t, geometry), s, &inverse));
        }
        equations.solve(mean.max(LEAST_NOISE * LEAST_NOISE))
    })?;
    Ok(shifts.unwrap_or_else(|| vec![None; vertices]))
}

/// The fit of all triangles at a pose, at full size and without appearance modes; `None` for those that the image does
/// not show, and for all if the object is not recognised.
///
/// # Errors
/// Those of the backend.
pub fn triangle_fits(
    backend: &mut dyn Backend,
    target: &Target<'_>,
    pose: &Pose,
) -> Result<Vec<Option<TriangleFit>>> {
    let triangles = target.model.shape.triangles();
    let fits = inspect(backend, target, pose, |seen| {
        let fit = |t: usize| {
            let weight = seen.rows.row(t).weight();
            let rms = triangle_rms(seen.problem, &seen.rows, t, &seen.solutions);
            let whole = seen.visibility[t] > 0.0 && seen.rows.inside(seen.problem.level, t) >= MIN_INSIDE;
            let belief = seen.weights[t] / seen.visibility[t];
            (whole && weight > 0.0).then_some(TriangleFit { cost: rms * rms * weight, weight, belief })
        };
        (0..triangles).map(fit).collect()
    })?;
    Ok(fits.unwrap_or_else(|| vec![None; triangles]))
}

/// What an image shows of a model at a pose.
struct Seen<'a> {
    problem: &'a LevelProblem<'a>,
    rows: Rows<'a>,
    visibility: Vec<f64>,
    weights: Vec<f64>,
    /// Gain and bias of every triangle.
    solutions: Vec<Solution>,
    /// Weighted mean squared residual, grey levels squared.
    mean: f64,
}

/// Looks at the full size image with one group per triangle; `None` if the object is not recognised.
fn inspect<T>(
    backend: &mut dyn Backend,
    target: &Target<'_>,
    pose: &Pose,
    report: impl FnOnce(&Seen<'_>) -> T,
) -> Result<Option<T>> {
    let visibility = visibility(target, pose);
    let state = State { pose: *pose, appearance: vec![0.0; target.model.modes()] };
    if score(backend, target, &state, &visibility)?.is_lost() {
        return Ok(None);
    }
    let problem = LevelProblem::new(target, 0, Grouping::Triangle);
    let mut evaluation = Evaluation::default();
    let mut evaluator = Evaluator::new(backend, std::slice::from_ref(target), &problem, &mut evaluation);
    evaluator.evaluate(std::iter::once(Sight::new(&state, &visibility)))?;
    let rows = evaluator.rows(0);
    let (mut scratch, mut weights) = (Scratch::default(), Vec::new());
    triangle_weights(&problem, &rows, &visibility, Some(Redescent::DEFAULT), &mut scratch, &mut weights);
    let mut solutions = scratch.solutions;
    let (mean, _) = cost(&problem, &state.appearance, &rows, &weights, &mut solutions);
    // Triangles that are not believed have gain and bias too.
    let all: Vec<f64> = visibility.iter().map(|v| f64::from(*v > 0.0)).collect();
    photometric::solve(problem.groups, problem.level, &rows, &all, &mut solutions);
    Ok(Some(report(&Seen { problem: &problem, rows, visibility, weights, solutions, mean })))
}

/// What one triangle says about its corners, gain and bias eliminated.
struct Part {
    hessian: Matrix6<f64>,
    gradient: Vector6<f64>,
}

impl Part {
    /// Triangle `t` with weight `s`; `inverse` is its `A^-1`.
    fn new(seen: &Seen<'_>, (t, geometry): (usize, &ChartGeometry), s: f64, inverse: &Matrix2<f64>) -> Self {
        let Seen { problem, rows, .. } = seen;
        let group = problem.groups.of_triangle[t];
        let (solution, centre) = (&seen.solutions[group], problem.groups.centre[group]);
        let Moments { hessian, cross, .. } = &problem.level.moments[t];
        let inside = rows.inside(problem.level, t);
        let (gain, bias) = (cross.fixed_view::<6, 1>(0, GAIN), cross.fixed_view::<6, 1>(0, BIAS));
        let coupling = Matrix6x2::from_columns(&[gain - centre * bias, bias.into_owned()]) * inside;
        let sums = barycentric_gradient(rows.row(t).gradient(), geometry);
        // The template's gradient follows its gain.
        let motion = inverse * (1.0 + solution.value.x);
        let mut corners = Matrix6::zeros();
        for k in 0..3 {
            corners.fixed_view_mut::<2, 2>(2 * k, 2 * k).copy_from(&motion);
        }
        let explained = coupling * solution.inverse * coupling.transpose();
        Self {
            hessian: corners.tr_mul(&(hessian * inside - explained)) * corners * s,
            gradient: corners.tr_mul(&(sums + coupling * solution.value)) * s,
        }
    }
}

/// Normal equations of the shifts of all vertices, two unknowns each.
struct Equations {
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl Equations {
    fn new(vertices: usize) -> Self {
        let n = 2 * vertices;
        Self { hessian: DMatrix::zeros(n, n), gradient: DVector::zeros(n) }
    }

    fn add(&mut self, triangle: [u32; 3], part: &Part) {
        let places = triangle.map(|v| 2 * v as usize);
        for (i, &row) in places.iter().enumerate() {
            let mut gradient = self.gradient.fixed_rows_mut::<2>(row);
            gradient += part.gradient.fixed_rows::<2>(2 * i);
            for (j, &column) in places.iter().enumerate() {
                let mut block = self.hessian.fixed_view_mut::<2, 2>(row, column);
                block += part.hessian.fixed_view::<2, 2>(2 * i, 2 * j);
            }
        }
    }

    /// `noise` is the variance of a residual, grey levels squared.
    fn solve(mut self, noise: f64) -> Vec<Option<VertexShift>> {
        let vertices = self.gradient.len() / 2;
        let seen: Vec<bool> =
            (0..vertices).map(|v| self.hessian.fixed_view::<2, 2>(2 * v, 2 * v).trace() > 0.0).collect();
        for i in 0..2 * vertices {
            self.hessian[(i, i)] += noise / (PRIOR_PX * PRIOR_PX);
        }
        let Some(factor) = self.hessian.cholesky() else { return vec![None; vertices] };
        let (shifts, inverse) = (factor.solve(&self.gradient), factor.inverse());
        let shift = |v: usize| VertexShift {
            shift: shifts.fixed_rows::<2>(2 * v).into_owned(),
            covariance: inverse.fixed_view::<2, 2>(2 * v, 2 * v) * noise,
        };
        seen.into_iter().enumerate().map(|(v, seen)| seen.then(|| shift(v))).collect()
    }
}
