//! JtQJ, JtQr and the cost at a pose, from triangle sums and moments (`docs/maths.md`, "Moments").

use nalgebra::{DMatrix, DVector, Matrix6, Point3, Vector6};

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
    /// Camera at this level.
    pub(super) camera: Camera,
    pub(super) groups: Groups,
    /// Centre of rotation, object frame.
    pub(super) centre: Point3<f64>,
}

impl<'a> LevelProblem<'a> {
    /// A level of what is aligned; `at_full_size` says who shares gain and bias there, coarser levels always use
    /// [`Grouping::FaceAndView`].
    pub(super) fn new(target: &Target<'a>, level: usize, at_full_size: Grouping) -> Self {
        let template = &target.model.levels[level];
        let grouping = if level == 0 { at_full_size } else { Grouping::FaceAndView };
        Self {
            level: template,
            camera: target.camera.at_level(level),
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
    /// Weighted mean squared residual, grey levels squared.
    pub(super) cost: f64,
    /// Sum of the weights behind the cost.
    pub(super) weight: f64,
    /// Mean of D^T D over the corners of the active triangles: d^T G d is the mean squared displacement in px.
    pub(super) displacement: Matrix6<f64>,
}

/// Coupling of one group's gain and bias with the pose and the appearance parameters.
#[derive(Clone)]
struct Coupling {
    pose: [Vector6<f64>; 2],
    appearance: [DVector<f64>; 2],
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
        let (level, l) = (problem.level, appearance.len());
        let solutions = photometric::solve(&problem.groups, level, rows, s);
        let mut sum = Self::prior(appearance);
        let none =
            Coupling { pose: [Vector6::zeros(); 2], appearance: [DVector::zeros(l), DVector::zeros(l)] };
        let mut couplings = vec![none; problem.groups.len()];
        let mut active = 0.0;
        for (t, geometry) in level.geometry.iter().enumerate().filter(|(t, _)| s[*t] > 0.0) {
            let Some(geometry) = geometry else { continue };
            let Some(corners) = CornerMotion::new(&problem.camera, pose, geometry, &problem.centre) else {
                continue;
            };
            let group = problem.groups.of_triangle[t];
            let part = derivative.of_triangle(level, t, rows, &corners, solutions[group].value.x);
            sum.add_triangle(level, t, rows, s[t], &part);
            couplings[group].add(level, t, rows, s[t], &part, problem.groups.centre[group]);
            sum.displacement += corners.metric;
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
        part: &TrianglePart,
    ) {
        let TrianglePart { motion, hessian, cross, gradient } = part;
        let mut pose = self.hessian.fixed_view_mut::<6, 6>(0, 0);
        pose += s * motion.transpose() * hessian * motion;
        let mut pose_gradient = self.gradient.fixed_rows_mut::<6>(0);
        pose_gradient += s * motion.transpose() * gradient;
        let (row, share) = (rows.row(triangle), s * rows.inside(level, triangle));
        let appearance = &level.moments[triangle].appearance;
        for k in 0..self.gradient.len() - 6 {
            let column = s * motion.transpose() * cross.fixed_view::<6, 1>(0, FIRST_MODE + k);
            let mut upper = self.hessian.fixed_view_mut::<6, 1>(0, 6 + k);
            upper += column;
            let mut lower = self.hessian.fixed_view_mut::<1, 6>(6 + k, 0);
            lower += column.transpose();
            for j in 0..self.gradient.len() - 6 {
                self.hessian[(6 + k, 6 + j)] += share * appearance[(FIRST_MODE + k, FIRST_MODE + j)];
            }
            self.gradient[6 + k] += s * row.appearance()[FIRST_MODE + k];
        }
    }

    /// Schur complement of one group's gain and bias.
    fn eliminate(&mut self, coupling: &Coupling, solution: &Solution) {
        let n = self.gradient.len();
        let column = |k: usize| {
            let mut c = DVector::zeros(n);
            c.fixed_rows_mut::<6>(0).copy_from(&coupling.pose[k]);
            c.rows_mut(6, n - 6).copy_from(&coupling.appearance[k]);
            c
        };
        let c = [column(0), column(1)];
        for (i, ci) in c.iter().enumerate() {
            for (j, cj) in c.iter().enumerate() {
                self.hessian.ger(-solution.inverse[(i, j)], ci, cj, 1.0);
            }
            self.gradient.axpy(solution.value[i], ci, 1.0);
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
        let one = part.cross.fixed_view::<6, 1>(0, BIAS);
        let gain = part.cross.fixed_view::<6, 1>(0, GAIN) - centre * one;
        self.pose[0] += s * part.motion.transpose() * gain;
        self.pose[1] += s * part.motion.transpose() * one;
        let (moments, share) = (&level.moments[triangle], s * rows.inside(level, triangle));
        for k in 0..self.appearance[0].len() {
            let with = |column: usize| moments.appearance[(FIRST_MODE + k, column)];
            self.appearance[0][k] += share * (with(GAIN) - centre * with(BIAS));
            self.appearance[1][k] += share * with(BIAS);
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
