//! JtQJ, JtQr and the cost at a pose, from triangle sums and moments (`docs/maths.md`, "Moments").

use nalgebra::{DMatrix, DVector, Matrix6, Point3};

use super::Target;
use super::derivative::{CornerMotion, Derivative, TrianglePart};
use super::photometric::{self, Grouping, Groups, PRIOR_NOISE, Solution, centred};
use crate::backend::SumsRow;
use crate::geometry::{Camera, Pose};
use crate::model::LevelTemplate;
use crate::model::moments::{BIAS, FIRST_MODE, GAIN};

/// What stays the same while a level is aligned.
#[derive(Debug)]
pub(super) struct LevelProblem<'a> {
    pub(super) level: &'a LevelTemplate,
    /// Its number.
    pub(super) number: usize,
    /// Pyramid level of the image.
    pub(super) image_level: usize,
    /// Camera at the level of the image.
    pub(super) camera: Camera,
    pub(super) groups: Groups,
    /// Centre of rotation, object frame.
    pub(super) centre: Point3<f64>,
}

impl<'a> LevelProblem<'a> {
    /// A level of what is aligned; `at_full_size` says who shares gain and bias there, coarser levels always use
    /// [`Grouping::FaceAndView`].
    pub(super) fn new(target: &Target<'a>, level: usize, at_full_size: Grouping) -> Self {
        Self::across(target, level, level, at_full_size)
    }

    /// As [`Self::new`], with another level of the image: where the object is seen at another scale than in the
    /// reference views.
    pub(super) fn across(
        target: &Target<'a>,
        level: usize,
        image_level: usize,
        at_full_size: Grouping,
    ) -> Self {
        let template = &target.model.levels[level];
        let grouping = if level == 0 { at_full_size } else { Grouping::FaceAndView };
        Self {
            level: template,
            number: level,
            image_level,
            camera: target.camera.at_level(image_level),
            groups: Groups::new(grouping, &target.model.shape, template),
            centre: target.model.shape.centre,
        }
    }
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
    /// Sum of `g_i g_i^T` over the triangles, `g_i` the part of triangle i in the gradient: how much they disagree.
    pub(super) scatter: DMatrix<f64>,
    /// Number of triangles behind the scatter.
    pub(super) triangles: usize,
    /// Weighted mean squared residual, grey levels squared.
    pub(super) cost: f64,
    /// Sum of the weights behind the cost.
    pub(super) weight: f64,
    /// Mean of D^T D over the corners of the active triangles: d^T G d is the mean squared displacement in px.
    pub(super) displacement: Matrix6<f64>,
}

/// Coupling of one group's gain and bias with the pose and the appearance parameters.
#[derive(Clone, Default)]
struct Coupling {
    /// Columns of gain and bias: pose, then appearance. Empty until a triangle of the group takes part.
    columns: [Vec<f64>; 2],
}

impl NormalEquations {
    /// Adds up the triangles with weights `s` at a pose; `appearance` are the current parameters (for their prior),
    /// `derivative` says where the derivative of the residual comes from.
    pub(super) fn assemble(
        problem: &LevelProblem<'_>,
        pose: &Pose,
        appearance: &[f64],
        rows: &Rows<'_>,
        s: &[f64],
        derivative: Derivative<'_>,
    ) -> Self {
        let level = problem.level;
        let solutions = photometric::solve(&problem.groups, level, rows, s);
        let mut sum = Self::prior(appearance);
        let mut couplings = vec![Coupling::default(); problem.groups.len()];
        for (t, geometry) in level.geometry.iter().enumerate().filter(|(t, _)| s[*t] > 0.0) {
            let Some(geometry) = geometry else { continue };
            let Some(corners) = CornerMotion::new(&problem.camera, pose, geometry, &problem.centre) else {
                continue;
            };
            let group = problem.groups.of_triangle[t];
            let part = derivative.of_triangle(level, t, rows, &corners, solutions[group].value.x);
            let gain_and_bias = solutions[group].columns(problem.groups.centre[group]);
            sum.add_triangle(level, t, rows, s[t], &part);
            sum.scatter_triangle(level, t, rows, s[t], &part, gain_and_bias);
            couplings[group].add(level, t, rows, s[t], &part, problem.groups.centre[group]);
            sum.displacement += corners.metric;
            sum.triangles += 1;
        }
        for (coupling, solution) in couplings.iter().zip(&solutions) {
            sum.eliminate(coupling, solution);
        }
        #[expect(clippy::cast_precision_loss, reason = "triangle counts are small")]
        let active = sum.triangles.max(1) as f64;
        sum.displacement /= active;
        (sum.cost, sum.weight) = mean_cost(rows, s, &solutions, appearance);
        sum
    }

    /// Pose block of JtQJ after the appearance parameters are eliminated; zero where they are not determined.
    pub(super) fn pose_hessian(&self) -> Matrix6<f64> {
        let l = self.gradient.len() - 6;
        let pose = self.hessian.fixed_view::<6, 6>(0, 0).into_owned();
        let coupling = self.hessian.view((0, 6), (6, l));
        let appearance = self.hessian.view((6, 6), (l, l)).into_owned();
        let Some(factor) = appearance.cholesky() else { return Matrix6::zeros() };
        let explained = coupling * factor.solve(&coupling.transpose());
        pose - explained.fixed_view::<6, 6>(0, 0)
    }

    fn prior(appearance: &[f64]) -> Self {
        let n = 6 + appearance.len();
        let mut prior = Self {
            hessian: DMatrix::zeros(n, n),
            gradient: DVector::zeros(n),
            scatter: DMatrix::zeros(n, n),
            triangles: 0,
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
        part: &TrianglePart,
    ) {
        let TrianglePart { motion, hessian, cross, gradient } = part;
        let transposed = s * motion.transpose();
        let mut pose = self.hessian.fixed_view_mut::<6, 6>(0, 0);
        pose += transposed * hessian * motion;
        let mut pose_gradient = self.gradient.fixed_rows_mut::<6>(0);
        pose_gradient += transposed * gradient;
        let (row, share) = (rows.row(triangle).appearance(), s * rows.inside(level, triangle));
        let appearance = &level.moments[triangle].appearance;
        for k in 0..self.gradient.len() - 6 {
            let column = transposed * cross.fixed_view::<6, 1>(0, FIRST_MODE + k);
            let mut upper = self.hessian.fixed_view_mut::<6, 1>(0, 6 + k);
            upper += column;
            let mut lower = self.hessian.fixed_view_mut::<1, 6>(6 + k, 0);
            lower += column.transpose();
            let mut sums = self.hessian.column_mut(6 + k);
            let products = appearance.column(FIRST_MODE + k);
            for (sum, product) in sums.iter_mut().skip(6).zip(products.iter().skip(FIRST_MODE)) {
                *sum += share * product;
            }
            self.gradient[6 + k] += s * row[FIRST_MODE + k];
        }
    }

    /// Adds the outer product of a triangle's part in the gradient, after gain and bias (factors of the appearance
    /// columns `gain_and_bias`).
    fn scatter_triangle(
        &mut self,
        level: &LevelTemplate,
        triangle: usize,
        rows: &Rows<'_>,
        s: f64,
        part: &TrianglePart,
        gain_and_bias: [(usize, f64); 2],
    ) {
        let n = self.gradient.len();
        let (moments, inside) = (&level.moments[triangle], rows.inside(level, triangle));
        let mut v = part.gradient;
        for (column, factor) in gain_and_bias {
            v += factor * part.cross.fixed_view::<6, 1>(0, column);
        }
        let mut g = DVector::zeros(n);
        g.fixed_rows_mut::<6>(0).copy_from(&(s * part.motion.transpose() * v));
        for k in 0..n - 6 {
            let photometric: f64 = gain_and_bias
                .iter()
                .map(|(c, f)| f * inside * moments.appearance[(FIRST_MODE + k, *c)])
                .sum();
            g[6 + k] = s * (rows.row(triangle).appearance()[FIRST_MODE + k] + photometric);
        }
        self.scatter.ger(1.0, &g, &g, 1.0);
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
        rows: &Rows<'_>,
        s: f64,
        part: &TrianglePart,
        centre: f64,
    ) {
        let (moments, share) = (&level.moments[triangle], s * rows.inside(level, triangle));
        let modes = moments.appearance.ncols() - FIRST_MODE;
        let one = part.cross.fixed_view::<6, 1>(0, BIAS);
        let gain = part.cross.fixed_view::<6, 1>(0, GAIN) - centre * one;
        let transposed = s * part.motion.transpose();
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
