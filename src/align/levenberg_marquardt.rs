//! One Levenberg-Marquardt descent as a state machine, so that many run in step with one backend call each.

use nalgebra::{DMatrix, DVector, Vector6};

use super::derivative::Derivative;
use super::normal_equations::{LevelProblem, NormalEquations, Rows, cost};
use super::robust::{Redescent, triangle_weights};
use crate::geometry::Pose;

/// Largest damping before a descent gives up.
const MAX_DAMPING: f64 = 1e8;

/// Choices that hold for all descents of a level.
#[derive(Debug, Clone, Copy)]
pub(super) struct Settings {
    pub(super) damping: f64,
    pub(super) max_iterations: usize,
    /// Stop when a step moves the corners by less (rms, pixels of the level).
    pub(super) stop_px: f64,
    pub(super) redescent: Option<Redescent>,
}

/// Pose and appearance parameters.
#[derive(Debug, Clone, PartialEq)]
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

/// A descent on one level.
#[derive(Debug)]
pub(super) struct Descent {
    pub(super) state: State,
    /// Sums at the state.
    pub(super) rows: Vec<f64>,
    /// Share of each triangle that nothing hides, at the start of the level.
    pub(super) visibility: Vec<f64>,
    pub(super) equations: NormalEquations,
    pub(super) iterations: usize,
    pub(super) stop: Option<Stop>,
    weights: Vec<f64>,
    damping: f64,
    candidate: Option<State>,
}

impl Descent {
    /// Starts at a state whose sums are known.
    pub(super) fn new(
        problem: &LevelProblem<'_>,
        settings: &Settings,
        state: State,
        visibility: Vec<f64>,
        rows: Rows<'_>,
    ) -> Self {
        let weights = triangle_weights(problem, &rows, &visibility, settings.redescent);
        let State { pose, appearance } = &state;
        let equations =
            NormalEquations::assemble(problem, pose, appearance, &rows, &weights, Derivative::Template);
        Self {
            state,
            rows: rows.data.to_vec(),
            visibility,
            equations,
            iterations: 0,
            stop: None,
            weights,
            damping: settings.damping,
            candidate: None,
        }
    }

    /// Solves for the next step, eq. (18) with diag(JtQJ). Returns the state to evaluate, or `None` when the descent
    /// has stopped. A step below the threshold is taken without another look.
    pub(super) fn propose(&mut self, problem: &LevelProblem<'_>, settings: &Settings) -> Option<&State> {
        if self.stop.is_some() {
            return None;
        }
        if self.iterations >= settings.max_iterations {
            self.stop = Some(Stop::Exhausted);
            return None;
        }
        let Some(step) = solve(&self.equations, self.damping) else {
            self.stop = Some(Stop::Singular);
            return None;
        };
        self.iterations += 1;
        let motion: Vector6<f64> = step.fixed_rows::<6>(0).into_owned();
        let moved = motion.dot(&(self.equations.displacement * motion)).max(0.0).sqrt();
        let next = State {
            pose: self.state.pose.compose(&Pose::increment(&motion, &problem.centre).inverse()),
            appearance: self.state.appearance.iter().zip(step.iter().skip(6)).map(|(a, d)| a + d).collect(),
        };
        if moved < settings.stop_px {
            self.state = next;
            self.stop = Some(Stop::Converged);
            return None;
        }
        self.candidate = Some(next);
        self.candidate.as_ref()
    }

    /// Accepts the proposed state if it lowers the cost with the same triangle weights, else damps more.
    pub(super) fn judge(&mut self, problem: &LevelProblem<'_>, settings: &Settings, rows: Rows<'_>) {
        let Some(candidate) = self.candidate.take() else { return };
        if cost(problem, &candidate.appearance, &rows, &self.weights) < self.equations.cost {
            self.state = candidate;
            self.damping /= 10.0;
            self.rows.copy_from_slice(rows.data);
            self.weights = triangle_weights(problem, &rows, &self.visibility, settings.redescent);
            let State { pose, appearance } = &self.state;
            self.equations = NormalEquations::assemble(
                problem,
                pose,
                appearance,
                &rows,
                &self.weights,
                Derivative::Template,
            );
        } else {
            self.damping *= 10.0;
            if self.damping > MAX_DAMPING {
                self.stop = Some(Stop::Exhausted);
            }
        }
    }
}

/// d = -(JtQJ + damping diag(JtQJ))^-1 JtQr with normalised columns; `None` if not positive definite.
pub(super) fn solve(equations: &NormalEquations, damping: f64) -> Option<DVector<f64>> {
    let diagonal = equations.hessian.diagonal();
    if diagonal.iter().any(|d| *d <= 0.0 || !d.is_finite()) {
        return None;
    }
    let scale = diagonal.map(|d| 1.0 / d.sqrt());
    let mut normalised = DMatrix::from_diagonal(&scale) * &equations.hessian * DMatrix::from_diagonal(&scale);
    for i in 0..normalised.nrows() {
        normalised[(i, i)] += damping;
    }
    let step = normalised.cholesky()?.solve(&equations.gradient.component_mul(&scale));
    let step = -step.component_mul(&scale);
    step.iter().all(|d| d.is_finite()).then_some(step)
}
