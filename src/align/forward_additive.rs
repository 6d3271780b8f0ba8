//! The previous method, reference [15] of the paper: Gauss-Newton with the Jacobian recomputed in every iteration from
//! the gradient of the frame at the warped pixels (`docs/maths.md`, "Forward additive").

use nalgebra::Vector6;

use super::derivative::Derivative;
use super::evaluator::{End, Evaluator, check, finish, states_of, tracked_levels, visibility};
use super::levenberg_marquardt::{State, Stop, solve};
use super::normal_equations::{LevelProblem, NormalEquations, Rows};
use super::photometric::Grouping;
use super::robust::{Redescent, triangle_weights};
use super::{Aligner, PoseEstimate, Start, Target};
use crate::backend::Backend;
use crate::error::Result;
use crate::geometry::Pose;
use crate::model::Model;

/// Choices of the method; the defaults are those of [`super::Options`], for a fair comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct ForwardOptions {
    /// Gauss-Newton steps per level at most.
    pub max_iterations: usize,
    /// A level ends when a step moves the corners by less (rms, pixels of the level); the last entry also serves all
    /// coarser levels.
    pub stop_px: Vec<f64>,
    /// Leave out triangles that do not look like the object.
    pub robust: bool,
    /// Who shares gain and bias at full size; coarser levels always use [`Grouping::FaceAndView`].
    pub full_size_grouping: Grouping,
}

impl Default for ForwardOptions {
    fn default() -> Self {
        Self {
            max_iterations: 20,
            stop_px: vec![0.01, 0.02, 0.05],
            robust: true,
            full_size_grouping: Grouping::Triangle,
        }
    }
}

/// Forward additive alignment: H <- H Hd(d) with d = (JtQJ)^-1 JtQr and J = grad I(W)^T D at the current pose.
#[derive(Debug, Clone, Default)]
pub struct ForwardAdditive {
    /// Choices.
    pub options: ForwardOptions,
}

/// A descent on one level.
struct Descent {
    state: State,
    visibility: Vec<f64>,
    equations: Option<NormalEquations>,
    iterations: usize,
    stop: Option<Stop>,
}

impl Descent {
    fn new(target: &Target<'_>, state: State) -> Self {
        let visibility = visibility(target, &state.pose);
        Self { state, visibility, equations: None, iterations: 0, stop: None }
    }

    /// One step from the sums at the state.
    fn step(
        &mut self,
        problem: &LevelProblem<'_>,
        redescent: Option<Redescent>,
        rows: Rows<'_>,
        derivative: Derivative<'_>,
        stop_px: f64,
    ) {
        let weights = triangle_weights(problem, &rows, &self.visibility, redescent);
        let State { pose, appearance } = &mut self.state;
        let equations = NormalEquations::assemble(problem, pose, appearance, &rows, &weights, derivative);
        let step = solve(&equations, 0.0);
        if let Some(step) = step {
            let motion: Vector6<f64> = step.fixed_rows::<6>(0).into_owned();
            // The derivative has its sign: r changes by -J d, so the increment itself goes to the right.
            *pose = pose.compose(&Pose::increment(&motion, &problem.centre));
            appearance.iter_mut().zip(step.iter().skip(6)).for_each(|(a, d)| *a += d);
            self.iterations += 1;
            let moved = motion.dot(&(equations.displacement * motion)).max(0.0).sqrt();
            self.stop = (moved < stop_px).then_some(Stop::Converged);
        } else {
            self.stop = Some(Stop::Singular);
        }
        self.equations = Some(equations);
    }
}

impl ForwardAdditive {
    /// The method with the given choices.
    pub fn new(options: ForwardOptions) -> Self {
        Self { options }
    }

    fn level(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        level: usize,
        states: Vec<State>,
    ) -> Result<Vec<Descent>> {
        let options = &self.options;
        let problem = LevelProblem::new(target, level, options.full_size_grouping);
        let stop_px = options.stop_px.get(level).or(options.stop_px.last()).copied().unwrap_or(0.01);
        let redescent = options.robust.then_some(Redescent::DEFAULT);
        let mut descents: Vec<Descent> = states.into_iter().map(|s| Descent::new(target, s)).collect();
        let mut evaluator = Evaluator::new(backend, target, &problem);
        // At least one look, for the score.
        for _ in 0..options.max_iterations.max(1) {
            let active = || descents.iter().filter(|d| d.stop.is_none());
            if active().next().is_none() {
                break;
            }
            evaluator.linearize(active().map(|d| (&d.state, &d.visibility)))?;
            for (item, descent) in descents.iter_mut().filter(|d| d.stop.is_none()).enumerate() {
                let derivative = Derivative::Frame(evaluator.seconds(item));
                descent.step(&problem, redescent, evaluator.rows(item), derivative, stop_px);
            }
        }
        Ok(descents)
    }
}

impl Aligner for ForwardAdditive {
    fn levels(&self, model: &Model) -> usize {
        model.levels.len()
    }

    fn align(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
    ) -> Result<Vec<PoseEstimate>> {
        check(target, starts)?;
        let mut states = states_of(starts);
        let mut totals = vec![(0, true); starts.len()];
        let mut last = Vec::new();
        for level in tracked_levels(target.model) {
            last = self.level(backend, target, level, states)?;
            for ((iterations, converged), descent) in totals.iter_mut().zip(&last) {
                *iterations += descent.iterations;
                *converged &= descent.stop == Some(Stop::Converged);
            }
            states = last.iter().map(|d| d.state.clone()).collect();
        }
        let end = |(d, (iterations, converged)): (Descent, (usize, bool))| {
            let Descent { state, visibility, equations, .. } = d;
            // Every level looks at least once.
            Some(End { state, visibility, equations: equations?, iterations, converged })
        };
        finish(backend, target, last.into_iter().zip(totals).filter_map(end).collect())
    }
}
