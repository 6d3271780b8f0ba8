//! One object, several cameras at the same time: the increment is in the axes of the object, the same for all of them, so
//! their normal equations add up (`docs/maths.md`, "Several cameras").

use std::time::Instant;

use nalgebra::Matrix6;

use super::covariance::covariance;
use super::evaluator::{Evaluation, Evaluator, Sight, check, ms_since, score, tracked_levels};
use super::inverse_compositional::{COARSEST_ROBUST, InverseCompositional};
use super::levenberg_marquardt::{Settings, State, Steps};
use super::look::Look;
use super::normal_equations::{LevelProblem, NormalEquations, Rows, cost};
use super::score::Score;
use super::workspace::{Workspace, reset_matrix, reset_vector};
use super::{AlignTimes, PoseEstimate, Start, Target};
use crate::backend::{Backend, Sums};
use crate::error::Result;
use crate::geometry::Pose;
use crate::model::Grouping;

/// One of several cameras. All see the same object; if they do so with models of their own, these have the same centre and
/// no appearance modes.
pub struct Eye<'a> {
    /// Has the camera's current frame.
    pub backend: &'a mut dyn Backend,
    /// Model, camera and frame.
    pub target: Target<'a>,
    /// Where this camera is: poses are those of the object in the reference camera.
    pub camera_from_reference: Pose,
}

impl std::fmt::Debug for Eye<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Eye")
            .field("backend", &self.backend.name())
            .field("camera", &self.target.camera)
            .field("camera_from_reference", &self.camera_from_reference)
            .finish_non_exhaustive()
    }
}

impl Eye<'_> {
    /// A state as this camera sees it.
    fn state(&self, state: &State) -> State {
        State { pose: self.camera_from_reference.compose(&state.pose), appearance: state.appearance.clone() }
    }
}

/// A descent with several cameras.
#[derive(Debug, Default)]
struct Joint {
    steps: Steps,
    looks: Vec<Look>,
    /// Sums at the proposed state, camera by camera.
    proposed: Vec<Vec<f64>>,
    equations: NormalEquations,
}

impl InverseCompositional {
    /// Aligns one pose with the frames of all cameras; start and estimate are poses in the reference camera. Gain, bias
    /// and triangle weights are each camera's own, appearance parameters belong to the object.
    ///
    /// # Errors
    /// Those of the backends, and [`crate::Error::Invalid`] for a start that does not fit the model.
    pub fn align_joint(&mut self, eyes: &mut [Eye<'_>], start: &Start) -> Result<PoseEstimate> {
        self.with_work(|method, work| method.joint_descent(eyes, start, work))
    }

    fn joint_descent(
        &self,
        eyes: &mut [Eye<'_>],
        start: &Start,
        work: &mut Workspace,
    ) -> Result<PoseEstimate> {
        let began = Instant::now();
        (work.times, work.evaluation.spent_ms) = (AlignTimes::default(), 0.0);
        let Some(first) = eyes.first() else { return Ok(PoseEstimate::default()) };
        let model = first.target.model;
        let mut joint = Joint::default();
        joint.looks.resize_with(eyes.len(), Look::default);
        joint.proposed.resize_with(eyes.len(), Vec::new);
        check(&first.target, std::slice::from_ref(start))?;
        joint.steps.start_at(start.camera_from_object.renormalised(), &start.appearance);
        for level in tracked_levels(model) {
            let robust = self.options.robust.then_some(COARSEST_ROBUST);
            joint.level(eyes, level, &self.settings(level, robust), self.options.full_size_grouping, work)?;
            joint.steps.end();
        }
        work.end_times(began);
        joint.finish(eyes, work)
    }
}

impl Joint {
    fn level(
        &mut self,
        eyes: &mut [Eye<'_>],
        level: usize,
        settings: &Settings,
        at_full_size: Grouping,
        work: &mut Workspace,
    ) -> Result<()> {
        let targets: Vec<Target<'_>> = eyes.iter().map(|e| e.target).collect();
        let problems: Vec<LevelProblem<'_>> =
            targets.iter().map(|t| LevelProblem::new(t, level, at_full_size)).collect();
        self.steps.begin(settings);
        let began = Instant::now();
        for (eye, look) in eyes.iter().zip(&mut self.looks) {
            let pose = eye.camera_from_reference.compose(&self.steps.state.pose);
            look.see(&eye.target, &pose, &mut work.workers[0].zbuffer);
        }
        work.times.visibility_ms += ms_since(began);
        let state = self.steps.state.clone();
        self.evaluate(eyes, &problems, &state, &mut work.evaluation)?;
        self.look(eyes, &problems, settings, work);
        loop {
            let centre = problems[0].shape.centre;
            self.steps.propose(&self.equations, &centre, settings, &mut work.workers[0].scratch.solver);
            let Some(state) = self.steps.proposed().cloned() else { return Ok(()) };
            self.evaluate(eyes, &problems, &state, &mut work.evaluation)?;
            let parts = problems.iter().zip(&self.looks).zip(&self.proposed);
            let solutions = &mut work.workers[0].scratch.solutions;
            let (cost, _) = total_cost(parts.map(|((problem, look), data)| {
                cost(problem, &state.appearance, &rows(problem, data), &look.weights, solutions)
            }));
            if self.steps.judge(cost < self.equations.cost, settings) {
                let before = self.steps.along(&self.equations.gradient);
                self.look(eyes, &problems, settings, work);
                self.steps.learn(before, self.steps.along(&self.equations.gradient));
            }
        }
    }

    /// The sums of a state in every camera.
    fn evaluate(
        &mut self,
        eyes: &mut [Eye<'_>],
        problems: &[LevelProblem<'_>],
        state: &State,
        evaluation: &mut Evaluation,
    ) -> Result<()> {
        for (k, (eye, problem)) in eyes.iter_mut().zip(problems).enumerate() {
            let seen = eye.state(state);
            let target = eye.target;
            let mut evaluator =
                Evaluator::new(&mut *eye.backend, std::slice::from_ref(&target), problem, evaluation);
            let visibility = &*self.looks[k].visibility;
            let light = &*self.looks[k].light;
            evaluator.evaluate(std::iter::once(Sight { light, ..Sight::new(&seen, visibility) }))?;
            self.proposed[k].clear();
            self.proposed[k].extend(evaluator.rows(0).data);
        }
        Ok(())
    }

    /// Weights and equations of every camera at the state, whose sums are known, and the equations of all.
    fn look(
        &mut self,
        eyes: &[Eye<'_>],
        problems: &[LevelProblem<'_>],
        settings: &Settings,
        work: &mut Workspace,
    ) {
        for (k, (eye, problem)) in eyes.iter().zip(problems).enumerate() {
            let state = eye.state(&self.steps.state);
            let rows = rows(problem, &self.proposed[k]);
            self.looks[k].take(problem, settings, &state, rows, &mut work.workers[0].scratch);
        }
        self.equations.sum(self.looks.iter().map(|l| &l.equations));
    }

    /// The estimate; its score is that of the camera that recognises the object best: one that sees nothing of it has no
    /// say against those that do.
    fn finish(&mut self, eyes: &mut [Eye<'_>], work: &mut Workspace) -> Result<PoseEstimate> {
        let began = Instant::now();
        let mut best = Score::default();
        for (eye, look) in eyes.iter_mut().zip(&self.looks) {
            let (state, target) = (eye.state(&self.steps.state), eye.target);
            let score = score(&mut *eye.backend, &target, &state, &look.visibility)?;
            if score.margin() > best.margin() {
                best = score;
            }
        }
        let solver = &mut work.workers[0].scratch.solver;
        let estimate = PoseEstimate {
            camera_from_object: self.steps.state.pose,
            appearance: self.steps.state.appearance.clone(),
            covariance: covariance(&self.equations, self.steps.response(self.equations.unsaturated), solver),
            hessian: self.equations.pose_hessian(solver),
            rms: if self.equations.cost.is_finite() { self.equations.cost.max(0.0).sqrt() } else { 0.0 },
            iterations: self.steps.total,
            converged: self.steps.converged,
            score: best,
        };
        work.times.score_ms = ms_since(began);
        Ok(estimate)
    }
}

fn rows<'r>(problem: &LevelProblem<'_>, data: &'r [f64]) -> Rows<'r> {
    Rows { data, row_len: Sums::row_len(problem.modes()) }
}

impl NormalEquations {
    /// The sum of the equations of several cameras, whose increments are the same: that of the object in its own axes. Costs
    /// and displacements become means over all of them; the prior of the appearance counts once per camera.
    fn sum<'e>(&mut self, parts: impl Iterator<Item = &'e Self> + Clone) {
        let n = parts.clone().map(|p| p.gradient.len()).max().unwrap_or(0);
        reset_matrix(&mut self.hessian, n, n);
        reset_matrix(&mut self.scatter, n, n);
        reset_vector(&mut self.gradient, n);
        (self.triangles, self.displacement) = (0, Matrix6::zeros());
        (self.cost, self.weight) = total_cost(parts.clone().map(|p| (p.cost, p.weight)));
        let unsaturated: f64 = parts.clone().map(|p| p.weight * p.unsaturated).sum();
        self.unsaturated = if self.weight > 0.0 { unsaturated / self.weight } else { 1.0 };
        for part in parts {
            self.hessian += &part.hessian;
            self.scatter += &part.scatter;
            self.gradient += &part.gradient;
            #[expect(clippy::cast_precision_loss, reason = "triangle counts are small")]
            let triangles = part.triangles as f64;
            self.displacement += part.displacement * triangles;
            self.triangles += part.triangles;
        }
        #[expect(clippy::cast_precision_loss, reason = "triangle counts are small")]
        let triangles = self.triangles.max(1) as f64;
        self.displacement /= triangles;
    }
}

/// Mean squared residual of several cameras from each one's mean and sum of weights; a camera that sees nothing has no say.
fn total_cost(parts: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    let (mut squares, mut weight) = (0.0, 0.0);
    for (cost, w) in parts.filter(|(_, w)| *w > 0.0) {
        squares += cost * w;
        weight += w;
    }
    if weight > 0.0 { (squares / weight, weight) } else { (f64::INFINITY, 0.0) }
}
