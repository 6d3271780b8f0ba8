//! One Levenberg-Marquardt descent as a state machine, so that many run in step with one backend call each.

use nalgebra::{DVector, Point3, Vector6};

use super::evaluator::{End, Sight};
use super::look::Look;
use super::normal_equations::{LevelProblem, NormalEquations, Rows, cost};
use super::robust::Redescent;
use super::workspace::{Scratch, Solver, reset_vector};
use crate::geometry::Pose;

/// Largest damping before a descent gives up.
const MAX_DAMPING: f64 = 1e8;
/// Least response that is believed.
const MIN_RESPONSE: f64 = 0.3;
/// Damping after a refused step at least: smaller ones hardly change the step.
const NOTICEABLE_DAMPING: f64 = 0.1;

/// Choices that hold for all descents of a level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Settings {
    pub(super) damping: f64,
    pub(super) max_iterations: usize,
    /// Stop when a step moves the corners by less (rms, pixels of the level).
    pub(super) stop_px: f64,
    /// Steps that move the corners by less (rms, pixels of the level) are taken whatever the cost says. The blur by sampling changes
    /// with every fraction of a pixel, of which the derivative knows nothing, so that the cost rises and falls on the way.
    pub(super) trusted_px: f64,
    pub(super) redescent: Option<Redescent>,
}

/// Pose and appearance parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct State {
    pub(super) pose: Pose,
    pub(super) appearance: Vec<f64>,
}

/// Why a descent stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stop {
    /// The proposed step was below the threshold.
    Converged,
    /// The iteration limit or the largest damping was reached.
    Exhausted,
    /// The equations could not be solved: too little of the object is visible.
    Singular,
}

/// The steps of a descent: where it is, where it may go next, and how careful it is.
#[derive(Debug, Default)]
pub(super) struct Steps {
    pub(super) state: State,
    /// Steps on this level.
    pub(super) iterations: usize,
    pub(super) stop: Option<Stop>,
    /// Steps on all levels so far.
    pub(super) total: usize,
    /// True if all levels so far converged.
    pub(super) converged: bool,
    damping: f64,
    candidate: State,
    is_proposed: bool,
    /// How far the last step moves the corners (rms, pixels of the level).
    moved: f64,
    /// The last step: pose increment, then appearance.
    step: Vec<f64>,
    /// Gradient along the accepted steps of this level, before and after them.
    along: [f64; 2],
}

impl Steps {
    /// Goes to where a descent starts.
    pub(super) fn start_at(&mut self, pose: Pose, appearance: &[f64]) {
        self.state.pose = pose;
        self.state.appearance.clear();
        self.state.appearance.extend(appearance);
        (self.total, self.converged) = (0, true);
    }

    /// Enters a level.
    pub(super) fn begin(&mut self, settings: &Settings) {
        (self.iterations, self.stop, self.is_proposed) = (0, None, false);
        (self.damping, self.along) = (settings.damping, [0.0; 2]);
    }

    /// Leaves a level.
    pub(super) fn end(&mut self) {
        self.total += self.iterations;
        self.converged &= self.stop == Some(Stop::Converged);
    }

    /// Solves for the next step, eq. (18) with diag(JtQJ), unless the descent has stopped. A step below the threshold
    /// is taken without another look.
    pub(super) fn propose(
        &mut self,
        equations: &NormalEquations,
        centre: &Point3<f64>,
        settings: &Settings,
        solver: &mut Solver,
    ) {
        if self.stop.is_some() {
            return;
        }
        if self.iterations >= settings.max_iterations {
            self.stop = Some(Stop::Exhausted);
            return;
        }
        let Some(step) = solve(equations, self.damping, solver) else {
            self.stop = Some(Stop::Singular);
            return;
        };
        self.iterations += 1;
        self.step.clear();
        self.step.extend(step);
        let motion: Vector6<f64> = step.fixed_rows::<6>(0).into_owned();
        let moved = motion.dot(&(equations.displacement * motion)).max(0.0).sqrt();
        self.candidate.pose = self.state.pose.compose(&Pose::increment(&motion, centre).inverse());
        self.candidate.appearance.clear();
        let appearance = self.state.appearance.iter().zip(step.iter().skip(6));
        self.candidate.appearance.extend(appearance.map(|(a, d)| a + d));
        self.moved = moved;
        let is_small = moved < settings.stop_px;
        self.is_proposed = !is_small;
        if is_small {
            std::mem::swap(&mut self.state, &mut self.candidate);
            self.stop = Some(Stop::Converged);
        }
    }

    /// Part of a gradient along the last step.
    pub(super) fn along(&self, gradient: &DVector<f64>) -> f64 {
        self.step.iter().zip(gradient).map(|(d, g)| d * g).sum()
    }

    /// Learns what an accepted step did to the gradient along it.
    pub(super) fn learn(&mut self, before: f64, after: f64) {
        self.along = [self.along[0] + before, self.along[1] + after];
    }

    /// How much the gradient of this level changes with the pose, in units of what JtQJ says (0.3..1): a step should take all
    /// of it away. Noise in the template makes JtQJ too large, and so does an image more blurred than the template; what is saturated,
    /// all but a share `unsaturated`, does not change with the pose.
    pub(super) fn response(&self, unsaturated: f64) -> f64 {
        let [before, after] = self.along;
        let measured = if before < 0.0 { (before - after) / before } else { 1.0 };
        measured.min(unsaturated).clamp(MIN_RESPONSE, 1.0)
    }

    /// The state to evaluate next.
    pub(super) fn proposed(&self) -> Option<&State> {
        self.is_proposed.then_some(&self.candidate)
    }

    /// Goes to the proposed state if it lowers the cost or is as near as the settings trust, else damps more. True if it went.
    pub(super) fn judge(&mut self, is_lower: bool, settings: &Settings) -> bool {
        self.is_proposed = false;
        let is_taken = is_lower || self.moved < settings.trusted_px;
        if is_taken {
            std::mem::swap(&mut self.state, &mut self.candidate);
            self.damping /= 10.0;
        } else {
            self.damping = (self.damping * 10.0).max(NOTICEABLE_DAMPING);
            if self.damping > MAX_DAMPING {
                self.stop = Some(Stop::Exhausted);
            }
        }
        is_taken
    }
}

/// A descent from level to level with one camera.
#[derive(Debug, Default)]
pub(super) struct Descent {
    /// Number of the target in whose frame it descends.
    pub(super) frame: usize,
    pub(super) steps: Steps,
    pub(super) look: Look,
}

impl Descent {
    /// Where the last level ended.
    pub(super) fn ended(&self) -> End<'_> {
        let (Steps { total, converged, .. }, equations) = (&self.steps, &self.look.equations);
        let response = self.steps.response(equations.unsaturated);
        End { sight: self.here(), equations, iterations: *total, converged: *converged, response }
    }

    /// Where it is.
    pub(super) fn here(&self) -> Sight<'_> {
        self.sight(&self.steps.state)
    }

    /// Where it may go next, if it goes on.
    pub(super) fn proposed(&self) -> Option<Sight<'_>> {
        self.steps.proposed().map(|state| self.sight(state))
    }

    fn sight<'s>(&'s self, state: &'s State) -> Sight<'s> {
        Sight { frame: self.frame, state, visibility: &self.look.visibility, light: &self.look.light }
    }

    /// Starts a level at the state, whose sums and visibility are known.
    pub(super) fn begin(
        &mut self,
        problem: &LevelProblem<'_>,
        settings: &Settings,
        rows: Rows<'_>,
        scratch: &mut Scratch,
    ) {
        self.steps.begin(settings);
        self.look.take(problem, settings, &self.steps.state, rows, scratch);
    }

    pub(super) fn propose(&mut self, problem: &LevelProblem<'_>, settings: &Settings, solver: &mut Solver) {
        self.steps.propose(&self.look.equations, &problem.shape.centre, settings, solver);
    }

    /// Accepts the proposed state if it lowers the cost with the same triangle weights, or is near.
    pub(super) fn judge(
        &mut self,
        problem: &LevelProblem<'_>,
        settings: &Settings,
        rows: Rows<'_>,
        scratch: &mut Scratch,
    ) {
        let Some(state) = self.steps.proposed() else { return };
        let (cost, _) = cost(problem, &state.appearance, &rows, &self.look.weights, &mut scratch.solutions);
        if self.steps.judge(cost < self.look.equations.cost, settings) {
            let before = self.steps.along(&self.look.equations.gradient);
            self.look.take(problem, settings, &self.steps.state, rows, scratch);
            self.steps.learn(before, self.steps.along(&self.look.equations.gradient));
        }
    }
}

/// d = -(JtQJ + damping diag(JtQJ))^-1 JtQr with normalised columns; `None` if not positive definite.
pub(super) fn solve<'s>(
    equations: &NormalEquations,
    damping: f64,
    solver: &'s mut Solver,
) -> Option<&'s DVector<f64>> {
    let factor = solver.factor(&equations.hessian, damping)?;
    let Solver { scale, vector, system, .. } = solver;
    reset_vector(vector, scale.len());
    vector.copy_from(&equations.gradient);
    vector.component_mul_assign(scale);
    factor.solve_mut(vector);
    vector.component_mul_assign(scale);
    vector.neg_mut();
    *system = factor.unpack_dirty();
    vector.iter().all(|d| d.is_finite()).then_some(vector)
}
