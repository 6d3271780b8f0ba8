//! The default method: template gradient, pose-dependent geometry, right composition, coarse to fine.

use super::evaluator::{End, Evaluator, check, finish, states_of, tracked_levels, visibility};
use super::levenberg_marquardt::{Descent, Settings, State, Stop};
use super::normal_equations::LevelProblem;
use super::photometric::Grouping;
use super::robust::Redescent;
use super::{Aligner, PoseEstimate, Start, Target};
use crate::backend::Backend;
use crate::error::Result;
use crate::model::Model;

/// Triangle weights act from this level down: on coarser ones they cost reach and spare nothing that finer levels
/// would not.
const COARSEST_ROBUST: usize = 1;

/// Choices of the method.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Levenberg-Marquardt steps per level at most.
    pub max_iterations: usize,
    /// A level ends when a step moves the corners by less (rms, pixels of the level); the last entry also serves all
    /// coarser levels.
    pub stop_px: Vec<f64>,
    /// First damping of every level.
    pub damping: f64,
    /// Leave out triangles that do not look like the object.
    pub robust: bool,
    /// Who shares gain and bias at full size; coarser levels always use [`Grouping::FaceAndView`].
    pub full_size_grouping: Grouping,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_iterations: 20,
            stop_px: vec![0.01, 0.02, 0.05],
            damping: 1e-3,
            robust: true,
            full_size_grouping: Grouping::Triangle,
        }
    }
}

/// Inverse compositional alignment with pose-dependent geometry (`docs/maths.md`).
#[derive(Debug, Clone, Default)]
pub struct InverseCompositional {
    /// Choices.
    pub options: Options,
}

impl InverseCompositional {
    /// The method with the given choices.
    pub fn new(options: Options) -> Self {
        Self { options }
    }

    fn settings(&self, level: usize, robust: bool) -> Settings {
        let stop_px =
            self.options.stop_px.get(level).or(self.options.stop_px.last()).copied().unwrap_or(0.01);
        Settings {
            damping: self.options.damping,
            max_iterations: self.options.max_iterations,
            stop_px,
            redescent: (robust && level <= COARSEST_ROBUST).then_some(Redescent::DEFAULT),
        }
    }

    pub(super) fn problem<'a>(&self, target: &Target<'a>, level: usize) -> LevelProblem<'a> {
        LevelProblem::new(target, level, self.options.full_size_grouping)
    }

    /// Descends from level to level; all states in step.
    pub(super) fn coarse_to_fine(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        levels: impl Iterator<Item = usize>,
        robust: bool,
        mut states: Vec<State>,
    ) -> Result<Vec<Descended>> {
        let mut totals = vec![(0, true); states.len()];
        let mut last = Vec::new();
        for level in levels {
            last = self.level(backend, target, level, robust, states)?;
            for ((iterations, converged), descent) in totals.iter_mut().zip(&last) {
                *iterations += descent.iterations;
                *converged &= descent.stop == Some(Stop::Converged);
            }
            states = last.iter().map(|d| d.state.clone()).collect();
        }
        let join = |(last, (iterations, converged))| Descended { last, iterations, converged };
        Ok(last.into_iter().zip(totals).map(join).collect())
    }

    fn level(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        level: usize,
        robust: bool,
        states: Vec<State>,
    ) -> Result<Vec<Descent>> {
        let problem = self.problem(target, level);
        let settings = self.settings(level, robust);
        let visibility: Vec<Vec<f64>> = states.iter().map(|s| visibility(target, &s.pose)).collect();
        let mut evaluator = Evaluator::new(backend, target, &problem);
        evaluator.evaluate(states.iter().zip(&visibility))?;
        let mut descents = Vec::with_capacity(states.len());
        for (i, (state, visibility)) in states.into_iter().zip(visibility).enumerate() {
            descents.push(Descent::new(&problem, &settings, state, visibility, evaluator.rows(i)));
        }
        loop {
            let mut proposals = Vec::new();
            for (i, descent) in descents.iter_mut().enumerate() {
                if let Some(state) = descent.propose(&problem, &settings) {
                    proposals.push((i, state.clone()));
                }
            }
            if proposals.is_empty() {
                return Ok(descents);
            }
            evaluator.evaluate(proposals.iter().map(|(i, state)| (state, &descents[*i].visibility)))?;
            for (k, (i, _)) in proposals.iter().enumerate() {
                descents[*i].judge(&problem, &settings, evaluator.rows(k));
            }
        }
    }
}

/// A descent through several levels.
#[derive(Debug)]
pub(super) struct Descended {
    /// The descent on the last level.
    pub(super) last: Descent,
    iterations: usize,
    converged: bool,
}

impl From<Descended> for End {
    fn from(descended: Descended) -> Self {
        let Descended { last: Descent { state, visibility, equations, .. }, iterations, converged } =
            descended;
        Self { state, visibility, equations, iterations, converged }
    }
}

impl Aligner for InverseCompositional {
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
        let levels = tracked_levels(target.model);
        let descents =
            self.coarse_to_fine(backend, target, levels, self.options.robust, states_of(starts))?;
        finish(backend, target, descents.into_iter().map(End::from).collect())
    }

    fn refine(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
    ) -> Result<Vec<PoseEstimate>> {
        check(target, starts)?;
        let levels = tracked_levels(target.model).filter(|level| *level <= COARSEST_ROBUST);
        let descents =
            self.coarse_to_fine(backend, target, levels, self.options.robust, states_of(starts))?;
        finish(backend, target, descents.into_iter().map(End::from).collect())
    }

    fn search(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        around: &Start,
    ) -> Result<Option<PoseEstimate>> {
        check(target, std::slice::from_ref(around))?;
        self.shift_search(backend, target, around).map(Some)
    }
}
