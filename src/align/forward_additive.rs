//! The previous method, reference [15] of the paper: Gauss-Newton with the Jacobian recomputed in every iteration from
//! the gradient of the frame at the warped pixels (`docs/maths.md`, "Forward additive").

use nalgebra::Vector6;

use super::derivative::Derivative;
use super::evaluator::{End, Evaluation, Evaluator, Sight, check, finish, tracked_levels};
use super::levenberg_marquardt::{State, Stop, solve};
use super::normal_equations::{LevelProblem, NormalEquations, Rows};
use super::robust::{Redescent, triangle_weights};
use super::visibility::visibility;
use super::workspace::{Scratch, Worker};
use super::{Aligner, PoseEstimate, Start, Target};
use crate::backend::Backend;
use crate::error::Result;
use crate::geometry::Pose;
use crate::model::{Grouping, Model};

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
            stop_px: vec![0.015, 0.05, 0.1],
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

/// A descent from level to level.
#[derive(Debug, Default)]
struct Descent {
    state: State,
    visibility: Vec<f64>,
    weights: Vec<f64>,
    equations: NormalEquations,
    /// Steps on all levels.
    iterations: usize,
    /// Why it stopped on this level.
    stop: Option<Stop>,
    /// True if all levels so far converged.
    converged: bool,
}

impl Descent {
    fn new(start: &Start) -> Self {
        let pose = start.camera_from_object.renormalised();
        let state = State { pose, appearance: start.appearance.clone() };
        Self { state, converged: true, ..Self::default() }
    }

    /// One step from the sums at the state.
    fn step(
        &mut self,
        problem: &LevelProblem<'_>,
        redescent: Option<Redescent>,
        rows: Rows<'_>,
        derivative: Derivative<'_>,
        stop_px: f64,
        scratch: &mut Scratch,
    ) {
        let Self { state, visibility, weights, equations, .. } = self;
        triangle_weights(problem, &rows, visibility, redescent, scratch, weights);
        equations.assemble(problem, state, &rows, weights, derivative, scratch);
        let Some(step) = solve(equations, 0.0, &mut scratch.solver) else {
            self.stop = Some(Stop::Singular);
            return;
        };
        let motion: Vector6<f64> = step.fixed_rows::<6>(0).into_owned();
        // The derivative has its sign: r changes by -J d, so the increment itself goes to the right.
        state.pose = state.pose.compose(&Pose::increment(&motion, &problem.shape.centre));
        state.appearance.iter_mut().zip(step.iter().skip(6)).for_each(|(a, d)| *a += d);
        self.iterations += 1;
        let moved = motion.dot(&(equations.displacement * motion)).max(0.0).sqrt();
        self.stop = (moved < stop_px).then_some(Stop::Converged);
    }

    fn ended(&self) -> End<'_> {
        let Self { equations, iterations, converged, .. } = self;
        let (iterations, converged) = (*iterations, *converged);
        End { sight: self.here(), equations, iterations, converged, response: 1.0 }
    }

    fn here(&self) -> Sight<'_> {
        Sight::new(&self.state, &self.visibility)
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
        descents: &mut [Descent],
        evaluation: &mut Evaluation,
        scratch: &mut Scratch,
    ) -> Result<()> {
        let options = &self.options;
        let problem = LevelProblem::new(target, level, options.full_size_grouping);
        let stop_px = options.stop_px.get(level).or(options.stop_px.last()).copied().unwrap_or(0.01);
        let redescent = options.robust.then_some(Redescent::DEFAULT);
        for descent in &mut *descents {
            descent.visibility = visibility(target, &descent.state.pose);
            descent.stop = None;
        }
        let mut evaluator = Evaluator::new(backend, std::slice::from_ref(target), &problem, evaluation);
        // At least one look, for the score.
        for _ in 0..options.max_iterations.max(1) {
            let active = || descents.iter().filter(|d| d.stop.is_none());
            if active().next().is_none() {
                break;
            }
            evaluator.linearize(active().map(Descent::here))?;
            for (item, descent) in descents.iter_mut().filter(|d| d.stop.is_none()).enumerate() {
                let derivative = Derivative::Frame(evaluator.seconds(item));
                descent.step(&problem, redescent, evaluator.rows(item), derivative, stop_px, scratch);
            }
        }
        for descent in descents {
            descent.converged &= descent.stop == Some(Stop::Converged);
        }
        Ok(())
    }
}

impl Aligner for ForwardAdditive {
    fn levels(&self, model: &Model) -> usize {
        model.levels.len()
    }

    fn another(&self) -> Box<dyn Aligner> {
        Box::new(self.clone())
    }

    fn align(
        &mut self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        check(target, starts)?;
        let (mut evaluation, mut worker) = (Evaluation::default(), Worker::default());
        let mut descents: Vec<Descent> = starts.iter().map(Descent::new).collect();
        for level in tracked_levels(target.model) {
            self.level(backend, target, level, &mut descents, &mut evaluation, &mut worker.scratch)?;
        }
        let ends = descents.iter().map(Descent::ended);
        finish(
            backend,
            std::slice::from_ref(target),
            ends,
            &mut evaluation,
            std::slice::from_mut(&mut worker),
            estimates,
        )
    }
}
