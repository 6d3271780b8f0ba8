//! JtQJ, JtQr and the cost at a pose, from triangle sums and moments (`docs/maths.md`, "Moments").

use nalgebra::{DMatrix, DVector, Matrix2, Matrix6, Point3, Vector3, Vector6};

use super::photometric::{self, Groups, PRIOR_NOISE, Solution, centred};
use crate::backend::SumsRow;
use crate::geometry::warp::{affine, increment_jacobian};
use crate::geometry::{Camera, Pose};
use crate::model::moments::{BIAS, FIRST_MODE, GAIN};
use crate::model::{ChartGeometry, LevelTemplate};

/// Triangles are back-facing or edge-on where det A falls below this share of its value |A|^2 / 2 for a warp that
/// only turns and scales; relative, so that a distant object keeps its triangles.
const MIN_DETERMINANT: f64 = 0.02;

/// What stays the same while a level is aligned.
#[derive(Debug)]
pub(super) struct LevelProblem<'a> {
    pub(super) level: &'a LevelTemplate,
    /// Camera at this level.
    pub(super) camera: Camera,
    pub(super) groups: Groups,
    /// Centre of rotation, object frame.
    pub(super) centre: Point3<f64>,
}

/// The sums of one pose, one row per triangle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rows<'a> {
    pub(super) data: &'a [f64],
    pub(super) row_len: usize,
}

impl<'a> Rows<'a> {
    pub(super) fn row(&self, triangle: usize) -> SumsRow<'a> {
        SumsRow(&self.data[triangle * self.row_len..][..self.row_len])
    }

    /// Share (0..1, by weight) of a triangle's pixels that were inside the image.
    pub(super) fn inside(&self, level: &LevelTemplate, triangle: usize) -> f64 {
        let all = level.moments[triangle].weight();
        if all > 0.0 { self.row(triangle).weight() / all } else { 0.0 }
    }
}

/// The linear system of one Levenberg-Marquardt step, gain and bias eliminated.
#[derive(Debug, Clone)]
pub(super) struct NormalEquations {
    /// JtQJ, (6+l) x (6+l): pose increment, then appearance.
    pub(super) hessian: DMatrix<f64>,
    /// JtQr, 6+l.
    pub(super) gradient: DVector<f64>,
    /// Weighted mean squared residual, grey levels squared.
    pub(super) cost: f64,
    /// Sum of the weights behind the cost.
    pub(super) weight: f64,
    /// Mean of D^T D over the corners of the active triangles: d^T G d is the mean squared displacement in px.
    pub(super) displacement: Matrix6<f64>,
}

/// L_i (6x6): motion of the three corners in template pixels per pose increment, stack of A_i^-1 D(X_a), together
/// with the corners' share of the displacement metric; `None` if back-facing, edge-on or behind the camera.
fn corner_motion(
    problem: &LevelProblem<'_>,
    pose: &Pose,
    g: &ChartGeometry,
) -> Option<(Matrix6<f64>, Matrix6<f64>)> {
    let mut projected = g.corners;
    for (p, x) in projected.iter_mut().zip(&g.points) {
        *p = problem.camera.project(&pose.transform_point(x))?;
    }
    let a: Matrix2<f64> = affine(&g.corners, &projected)?.fixed_view::<2, 2>(0, 0).into_owned();
    if a.determinant() < MIN_DETERMINANT * a.norm_squared() / 2.0 {
        return None;
    }
    let inverse = a.try_inverse()?;
    let (mut motion, mut metric) = (Matrix6::zeros(), Matrix6::zeros());
    for (k, x) in g.points.iter().enumerate() {
        let d = increment_jacobian(&problem.camera, pose, x, &problem.centre);
        motion.fixed_view_mut::<2, 6>(2 * k, 0).copy_from(&(inverse * d));
        metric += d.transpose() * d / 3.0;
    }
    Some((motion, metric))
}

/// v_i = sum q r f from the kernel's low-rank sums: b_a is linear in (u, v, 1).
fn barycentric_gradient(sums: &[f64], g: &ChartGeometry) -> Vector6<f64> {
    let along_u = g.barycentric * Vector3::new(sums[0], sums[1], sums[2]);
    let along_v = g.barycentric * Vector3::new(sums[3], sums[4], sums[5]);
    Vector6::new(along_u[0], along_v[0], along_u[1], along_v[1], along_u[2], along_v[2])
}

/// Coupling of one group's gain and bias with the pose and the appearance parameters.
#[derive(Clone, Default)]
struct Coupling {
    /// Columns of gain and bias: pose, then appearance. Empty until a triangle of the group takes part.
    columns: [Vec<f64>; 2],
}

impl NormalEquations {
    /// Adds up the triangles with weights `s` at a pose; `appearance` are the current parameters (for their prior).
    pub(super) fn assemble(
        problem: &LevelProblem<'_>,
        pose: &Pose,
        appearance: &[f64],
        rows: &Rows<'_>,
        s: &[f64],
    ) -> Self {
        let (level, l) = (problem.level, appearance.len());
        let solutions = photometric::solve(&problem.groups, level, rows, s);
        let mut sum = Self::prior(appearance);
        let mut couplings = vec![Coupling::default(); problem.groups.len()];
        let mut active = 0.0;
        for (t, geometry) in level.geometry.iter().enumerate().filter(|(t, _)| s[*t] > 0.0) {
            let Some((motion, metric)) = geometry.as_ref().and_then(|g| corner_motion(problem, pose, g))
            else {
                continue;
            };
            let Some(geometry) = geometry else { continue };
            let group = problem.groups.of_triangle[t];
            // The template's gradient follows its gain.
            let motion = motion * (1.0 + solutions[group].value.x);
            let v = barycentric_gradient(rows.row(t).gradient(), geometry);
            sum.add_triangle(level, t, rows, s[t], &motion, &v);
            let share = s[t] * rows.inside(level, t);
            couplings[group].add(level, t, l, share, &motion, problem.groups.centre[group]);
            sum.displacement += metric;
            active += 1.0;
        }
        for (coupling, solution) in couplings.iter().zip(&solutions) {
            sum.eliminate(coupling, solution);
        }
        sum.displacement /= f64::max(active, 1.0);
        (sum.cost, sum.weight) = mean_cost(rows, s, &solutions, appearance);
        sum
    }

    fn prior(appearance: &[f64]) -> Self {
        let n = 6 + appearance.len();
        let mut prior = Self {
            hessian: DMatrix::zeros(n, n),
            gradient: DVector::zeros(n),
            cost: 0.0,
            weight: 0.0,
            displacement: Matrix6::zeros(),
        };
        for (k, lambda) in appearance.iter().enumerate() {
            prior.hessian[(6 + k, 6 + k)] = PRIOR_NOISE * PRIOR_NOISE;
            prior.gradient[6 + k] = PRIOR_NOISE * PRIOR_NOISE * lambda;
        }
        prior
    }

    fn add_triangle(
        &mut self,
        level: &LevelTemplate,
        triangle: usize,
        rows: &Rows<'_>,
        s: f64,
        motion: &Matrix6<f64>,
        v: &Vector6<f64>,
    ) {
        let moments = &level.moments[triangle];
        let (share, transposed) = (s * rows.inside(level, triangle), motion.transpose());
        let mut pose = self.hessian.fixed_view_mut::<6, 6>(0, 0);
        pose += share * transposed * moments.hessian * motion;
        let mut pose_gradient = self.gradient.fixed_rows_mut::<6>(0);
        pose_gradient += s * transposed * v;
        let (shared, row) = (share * transposed, rows.row(triangle).appearance());
        for k in 0..self.gradient.len() - 6 {
            let column = shared * moments.cross.fixed_view::<6, 1>(0, FIRST_MODE + k);
            let mut upper = self.hessian.fixed_view_mut::<6, 1>(0, 6 + k);
            upper += column;
            let mut lower = self.hessian.fixed_view_mut::<1, 6>(6 + k, 0);
            lower += column.transpose();
            let mut sums = self.hessian.column_mut(6 + k);
            let products = moments.appearance.column(FIRST_MODE + k);
            for (sum, product) in sums.iter_mut().skip(6).zip(products.iter().skip(FIRST_MODE)) {
                *sum += share * product;
            }
            self.gradient[6 + k] += s * row[FIRST_MODE + k];
        }
    }

    /// Schur complement of one group's gain and bias.
    fn eliminate(&mut self, coupling: &Coupling, solution: &Solution) {
        let Coupling { columns: [gain, bias] } = coupling;
        let inverse = &solution.inverse;
        for (j, (g, b)) in gain.iter().zip(bias).enumerate() {
            let with_gain = inverse[(0, 0)] * g + inverse[(0, 1)] * b;
            let with_bias = inverse[(1, 0)] * g + inverse[(1, 1)] * b;
            for (sum, (g, b)) in self.hessian.column_mut(j).iter_mut().zip(gain.iter().zip(bias)) {
                *sum -= g * with_gain + b * with_bias;
            }
            self.gradient[j] += solution.value[0] * g + solution.value[1] * b;
        }
    }
}

impl Coupling {
    fn add(
        &mut self,
        level: &LevelTemplate,
        triangle: usize,
        modes: usize,
        share: f64,
        motion: &Matrix6<f64>,
        centre: f64,
    ) {
        let moments = &level.moments[triangle];
        let one = moments.cross.fixed_view::<6, 1>(0, BIAS);
        let gain = moments.cross.fixed_view::<6, 1>(0, GAIN) - centre * one;
        let transposed = share * motion.transpose();
        let pose = [transposed * gain, transposed * one];
        for (column, pose) in self.columns.iter_mut().zip(pose) {
            column.resize(6 + modes, 0.0);
            for (sum, value) in column.iter_mut().zip(&pose) {
                *sum += value;
            }
        }
        for k in 0..modes {
            let with = |column: usize| moments.appearance[(FIRST_MODE + k, column)];
            self.columns[0][6 + k] += share * (with(GAIN) - centre * with(BIAS));
            self.columns[1][6 + k] += share * with(BIAS);
        }
    }
}

/// Weighted mean squared residual after gain and bias with the given triangle weights, and the sum of weights.
pub(super) fn cost(problem: &LevelProblem<'_>, appearance: &[f64], rows: &Rows<'_>, s: &[f64]) -> f64 {
    let solutions = photometric::solve(&problem.groups, problem.level, rows, s);
    mean_cost(rows, s, &solutions, appearance).0
}

/// The mean (not the sum) lets poses with different numbers of pixels inside the image be compared.
fn mean_cost(rows: &Rows<'_>, s: &[f64], solutions: &[Solution], appearance: &[f64]) -> (f64, f64) {
    let active = || s.iter().enumerate().filter(|(_, s)| **s > 0.0);
    let squares: f64 = active().map(|(t, s)| s * rows.row(t).cost()).sum();
    let weight: f64 = active().map(|(t, s)| s * rows.row(t).weight()).sum();
    let reduction: f64 = solutions.iter().map(Solution::reduction).sum();
    let prior = PRIOR_NOISE * PRIOR_NOISE * appearance.iter().map(|a| a * a).sum::<f64>();
    if weight > 0.0 { ((squares - reduction + prior) / weight, weight) } else { (f64::INFINITY, 0.0) }
}

/// Root mean square residual of a triangle after its group's gain and bias, grey levels.
pub(super) fn triangle_rms(
    problem: &LevelProblem<'_>,
    rows: &Rows<'_>,
    triangle: usize,
    solutions: &[Solution],
) -> f64 {
    let group = problem.groups.of_triangle[triangle];
    let (row, x, c) = (rows.row(triangle), solutions[group].value, problem.groups.centre[group]);
    let b = centred(&problem.level.moments[triangle].appearance, c) * rows.inside(problem.level, triangle);
    let w = photometric::centred_gradient(row.appearance(), c);
    let squares = row.cost() + 2.0 * x.dot(&w) + x.dot(&(b * x));
    (squares.max(0.0) / row.weight().max(f64::MIN_POSITIVE)).sqrt()
}
