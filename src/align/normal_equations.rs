//! JtQJ, JtQr and the cost at a pose, from triangle sums and moments (`docs/maths.md`, "Moments").

use nalgebra::{DMatrix, DVector, Matrix6};

use super::Target;
use super::contribution::{Contribution, add};
use super::derivative::{CornerMotion, Derivative};
use super::levenberg_marquardt::State;
use super::photometric::{self, PRIOR_NOISE, Solution, centred};
use super::workspace::{Scratch, Solver, factor, reset_matrix, reset_vector};
use crate::backend::SumsRow;
use crate::geometry::Camera;
use crate::model::moments::FIRST_MODE;
use crate::model::{Grouping, Groups, LevelTemplate, Shape};

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
    pub(super) groups: &'a Groups,
    /// The mesh, and the centre of rotation.
    pub(super) shape: &'a Shape,
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
            groups: template.groups(grouping),
            shape: &target.model.shape,
        }
    }

    /// Number of appearance modes.
    pub(super) fn modes(&self) -> usize {
        self.level.pixels.modes.len()
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
    /// Sum of `g_i g_i^T` over the triangles, `g_i` the part of triangle i in the gradient: how much they disagree. Zero on coarse
    /// levels.
    pub(super) scatter: DMatrix<f64>,
    /// Number of triangles behind the scatter.
    pub(super) triangles: usize,
    /// Weighted mean squared residual, grey levels squared.
    pub(super) cost: f64,
    /// Sum of the weights behind the cost.
    pub(super) weight: f64,
    /// Share (0..1) of the pixels that the frame does not show saturated where the object would be brighter.
    pub(super) unsaturated: f64,
    /// Mean of D^T D over the corners of the active triangles: d^T G d is the mean squared displacement in px.
    pub(super) displacement: Matrix6<f64>,
}

impl Default for NormalEquations {
    fn default() -> Self {
        let (matrix, vector) = (DMatrix::zeros(0, 0), DVector::zeros(0));
        Self {
            hessian: matrix.clone(),
            gradient: vector,
            scatter: matrix,
            triangles: 0,
            cost: 0.0,
            weight: 0.0,
            unsaturated: 1.0,
            displacement: Matrix6::zeros(),
        }
    }
}

impl NormalEquations {
    /// Adds up the triangles with weights `s` at a state; its appearance parameters are needed for their prior.
    /// `derivative` says where the derivative of the residual comes from.
    pub(super) fn assemble(
        &mut self,
        problem: &LevelProblem<'_>,
        state: &State,
        rows: &Rows<'_>,
        s: &[f64],
        derivative: Derivative<'_>,
        scratch: &mut Scratch,
    ) {
        let (level, groups, mesh) = (problem.level, problem.groups, &problem.shape.mesh);
        let Scratch { solutions, couplings, vertices, cross, coupled, column, .. } = scratch;
        photometric::solve(groups, level, rows, s, solutions);
        self.start_from_prior(&state.appearance);
        couplings.reset(groups.len(), self.gradient.len());
        vertices.place(&problem.camera, &state.pose, mesh, &problem.shape.centre);
        for (t, geometry) in level.geometry.iter().enumerate().filter(|(t, _)| s[*t] > 0.0) {
            let (Some(geometry), Some(corners)) = (geometry, vertices.corners(&mesh.triangles[t])) else {
                continue;
            };
            let Some(corners) = CornerMotion::new(corners, geometry) else { continue };
            let (group, seen) = (groups.of_triangle[t], (rows.row(t), rows.inside(level, t)));
            let gain = solutions[group].value.x;
            let part = derivative.of_triangle(level, (t, geometry), seen, &corners, gain, cross);
            let here = Contribution::new(level, (t, rows), (s[t], seen.1), &part, coupled);
            self.add_triangle(&here);
            // Only where a descent ends its covariance is asked for.
            if problem.number == 0 {
                self.scatter_triangle(&here, solutions[group].columns(groups.centre[group]), column);
            }
            here.couple(couplings.of(group), groups.centre[group]);
            vertices.use_triangle(&mesh.triangles[t]);
            self.triangles += 1;
        }
        for (group, columns) in couplings.iter() {
            self.eliminate(columns, &solutions[group]);
        }
        self.hessian.fill_lower_triangle_with_upper_triangle();
        self.scatter.fill_lower_triangle_with_upper_triangle();
        self.displacement = vertices.displacement();
        (self.cost, self.weight) = mean_cost(rows, s, solutions, &state.appearance);
        self.unsaturated = unsaturated(level, rows, s);
    }

    /// Pose block of JtQJ after the appearance parameters are eliminated; zero where they are not determined.
    pub(super) fn pose_hessian(&self, solver: &mut Solver) -> Matrix6<f64> {
        let l = self.gradient.len() - 6;
        let pose = self.hessian.fixed_view::<6, 6>(0, 0).into_owned();
        let Solver { appearance, coupling, .. } = solver;
        reset_matrix(appearance, l, l);
        appearance.copy_from(&self.hessian.view((6, 6), (l, l)));
        let Some(factor) = factor(appearance) else { return Matrix6::zeros() };
        reset_matrix(coupling, l, 6);
        coupling.copy_from(&self.hessian.view((6, 0), (l, 6)));
        factor.solve_mut(coupling);
        *appearance = factor.unpack_dirty();
        let mut explained = Matrix6::zeros();
        explained.gemm(1.0, &self.hessian.view((0, 6), (6, l)), coupling, 0.0);
        pose - explained
    }

    fn start_from_prior(&mut self, appearance: &[f64]) {
        let n = 6 + appearance.len();
        reset_matrix(&mut self.hessian, n, n);
        reset_matrix(&mut self.scatter, n, n);
        reset_vector(&mut self.gradient, n);
        (self.triangles, self.displacement) = (0, Matrix6::zeros());
        for (k, lambda) in appearance.iter().enumerate() {
            self.hessian[(6 + k, 6 + k)] = PRIOR_NOISE * PRIOR_NOISE;
            self.gradient[6 + k] = PRIOR_NOISE * PRIOR_NOISE * lambda;
        }
    }

    /// Adds a triangle to the gradient and to the upper half of the matrix.
    fn add_triangle(&mut self, here: &Contribution<'_>) {
        let (n, s) = (self.gradient.len(), here.s);
        let (of_pose, of_modes) = self.hessian.as_mut_slice().split_at_mut(6 * n);
        for (sums, column) in of_pose.chunks_exact_mut(n).zip(&here.pose_hessian()) {
            add(&mut sums[..6], 1.0, column);
        }
        for (k, sums) in of_modes.chunks_exact_mut(n).enumerate() {
            add(&mut sums[..6], s, &here.coupled[FIRST_MODE + k]);
            add(&mut sums[6..=6 + k], here.share, &here.appearance(FIRST_MODE + k)[FIRST_MODE..]);
        }
        let (of_pose, of_modes) = self.gradient.as_mut_slice().split_at_mut(6);
        add(of_pose, s, &here.gradient);
        add(of_modes, s, &here.row[FIRST_MODE..]);
    }

    /// Adds the outer product of a triangle's part in the gradient, after gain and bias (factors of the appearance
    /// columns `gain_and_bias`), to the upper half of the scatter.
    fn scatter_triangle(
        &mut self,
        here: &Contribution<'_>,
        gain_and_bias: [(usize, f64); 2],
        column: &mut Vec<f64>,
    ) {
        column.clear();
        column.extend(here.gradient.iter().chain(&here.row[FIRST_MODE..]).map(|g| here.s * g));
        for (c, factor) in gain_and_bias {
            add(&mut column[..6], here.s * factor, &here.coupled[c]);
            add(&mut column[6..], here.share * factor, &here.appearance(c)[FIRST_MODE..]);
        }
        for (j, sums) in self.scatter.as_mut_slice().chunks_exact_mut(column.len()).enumerate() {
            add(&mut sums[..=j], column[j], column);
        }
    }

    /// Schur complement of one group's gain and bias, in the upper half.
    fn eliminate(&mut self, [gain, bias]: [&[f64]; 2], solution: &Solution) {
        let (inverse, n) = (&solution.inverse, self.gradient.len());
        for (j, (g, b)) in gain.iter().zip(bias).enumerate() {
            let with_gain = inverse[(0, 0)] * g + inverse[(0, 1)] * b;
            let with_bias = inverse[(1, 0)] * g + inverse[(1, 1)] * b;
            let sums = &mut self.hessian.as_mut_slice()[j * n..][..=j];
            add(sums, -with_gain, gain);
            add(sums, -with_bias, bias);
            self.gradient[j] += solution.value[0] * g + solution.value[1] * b;
        }
    }
}

/// Weighted mean squared residual after gain and bias with the given triangle weights, and the sum of weights.
pub(super) fn cost(
    problem: &LevelProblem<'_>,
    appearance: &[f64],
    rows: &Rows<'_>,
    s: &[f64],
    solutions: &mut Vec<Solution>,
) -> (f64, f64) {
    photometric::solve(problem.groups, problem.level, rows, s, solutions);
    mean_cost(rows, s, solutions, appearance)
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

/// Share of the pixels inside the image that count, by the triangles' weights; of a triangle cut by the border as many are inside as
/// its share by weight says.
fn unsaturated(level: &LevelTemplate, rows: &Rows<'_>, s: &[f64]) -> f64 {
    let (mut counted, mut all) = (0.0, 0.0);
    for (t, s) in s.iter().enumerate().filter(|(_, s)| **s > 0.0) {
        counted += s * rows.row(t).count();
        all += s * rows.inside(level, t) * level.moments[t].count;
    }
    if all > 0.0 { (counted / all).clamp(0.0, 1.0) } else { 1.0 }
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
