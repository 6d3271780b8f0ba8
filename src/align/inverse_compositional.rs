//! The default method: template gradient, pose-dependent geometry, right composition, coarse to fine.

use std::time::Instant;

use super::evaluator::{Evaluator, check, ms_since, tracked_levels};
use super::levenberg_marquardt::Settings;
use super::normal_equations::LevelProblem;
use super::robust::Redescent;
use super::workspace::Workspace;
use super::{AlignTimes, Aligner, PoseEstimate, Start, Target};
use crate::backend::Backend;
use crate::error::Result;
use crate::model::{Grouping, Model};

/// Triangle weights act from this level down: on coarser ones they cost reach.
pub(super) const COARSEST_ROBUST: usize = 1;

/// A further descent from a prediction.
struct Retry {
    /// Coarsest level, and coarsest with triangle weights.
    levels: (usize, usize),
    /// Is it also for ends that did not converge, or only for those that are lost?
    unconverged: bool,
}

/// What covers much of the object leads a descent astray that trusts everything on its coarse levels: first without those,
/// since a prediction is mostly right to a pixel or two, then with weights on all.
const RETRIES: [Retry; 2] = [
    Retry { levels: (COARSEST_ROBUST, COARSEST_ROBUST), unconverged: true },
    Retry { levels: (usize::MAX, usize::MAX), unconverged: false },
];

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
            stop_px: vec![0.015, 0.05, 0.1],
            damping: 1e-3,
            robust: true,
            full_size_grouping: Grouping::Triangle,
        }
    }
}

/// Inverse compositional alignment with pose-dependent geometry (`docs/maths.md`).
#[derive(Debug, Default)]
pub struct InverseCompositional {
    /// Choices.
    pub options: Options,
    work: Workspace,
}

impl InverseCompositional {
    /// The method with the given choices.
    pub fn new(options: Options) -> Self {
        Self { options, work: Workspace::default() }
    }

    /// Lends the memory that is kept between frames.
    pub(super) fn with_work<T>(&mut self, task: impl FnOnce(&Self, &mut Workspace) -> T) -> T {
        let mut work = std::mem::take(&mut self.work);
        let done = task(self, &mut work);
        self.work = work;
        done
    }

    pub(super) fn settings(&self, level: usize, robust: Option<usize>) -> Settings {
        let stop_px =
            self.options.stop_px.get(level).or(self.options.stop_px.last()).copied().unwrap_or(0.01);
        Settings {
            damping: self.options.damping,
            max_iterations: self.options.max_iterations,
            stop_px,
            redescent: robust.filter(|coarsest| level <= *coarsest).map(|_| Redescent::DEFAULT),
        }
    }

    /// Descends from the levels up to `coarsest`, with triangle weights from level `robust_from` down.
    fn descend(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        (coarsest, robust_from): (usize, usize),
        starts: &[Start],
        work: &mut Workspace,
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        let began = Instant::now();
        work.begin(starts);
        let levels = tracked_levels(target.model).filter(|level| *level <= coarsest);
        let robust = self.options.robust.then_some(robust_from);
        self.coarse_to_fine(backend, target, levels, robust, work)?;
        work.end_times(began);
        work.finish(backend, target, estimates)
    }

    /// Picks up predictions, and those that went astray again as [`RETRIES`] says.
    fn picked_up(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
        work: &mut Workspace,
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        self.descend(backend, target, (usize::MAX, COARSEST_ROBUST), starts, work, estimates)?;
        for Retry { levels, unconverged } in RETRIES.into_iter().filter(|_| self.options.robust) {
            let is_astray = |end: &PoseEstimate| end.score.is_lost() || (unconverged && !end.converged);
            let astray: Vec<usize> = (0..starts.len()).filter(|&i| is_astray(&estimates[i])).collect();
            if astray.is_empty() {
                return Ok(());
            }
            self.retry(backend, target, levels, starts, &astray, work, estimates)?;
        }
        Ok(())
    }

    /// Descends once more from the given ones of the starts; an end that fits better takes the place of the first.
    #[expect(clippy::too_many_arguments, reason = "what a descent needs, and from which starts")]
    fn retry(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        levels: (usize, usize),
        starts: &[Start],
        astray: &[usize],
        work: &mut Workspace,
        estimates: &mut [PoseEstimate],
    ) -> Result<()> {
        let (first, mut guarded) = (work.times, Vec::new());
        let again: Vec<Start> = astray.iter().map(|&i| starts[i].clone()).collect();
        self.descend(backend, target, levels, &again, work, &mut guarded)?;
        work.times += first;
        for (&i, guarded) in astray.iter().zip(guarded) {
            let iterations = estimates[i].iterations + guarded.iterations;
            if guarded.score.correlation > estimates[i].score.correlation {
                estimates[i] = guarded;
            }
            estimates[i].iterations = iterations;
        }
        Ok(())
    }

    pub(super) fn problem<'a>(&self, target: &Target<'a>, level: usize) -> LevelProblem<'a> {
        LevelProblem::new(target, level, self.options.full_size_grouping)
    }

    /// Descends from level to level, with triangle weights from level `robust` down; all descents of the workspace in
    /// step.
    pub(super) fn coarse_to_fine(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        levels: impl Iterator<Item = usize>,
        robust: Option<usize>,
        work: &mut Workspace,
    ) -> Result<()> {
        for level in levels {
            self.level(backend, target, level, robust, work)?;
            work.descents.iter_mut().for_each(|d| d.steps.end());
        }
        Ok(())
    }

    fn level(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        level: usize,
        robust: Option<usize>,
        work: &mut Workspace,
    ) -> Result<()> {
        let problem = self.problem(target, level);
        let settings = self.settings(level, robust);
        let Workspace { descents, evaluation, zbuffer, scratch, times } = work;
        let began = Instant::now();
        for descent in descents.iter_mut() {
            descent.look.see(target, &descent.steps.state.pose, zbuffer);
        }
        times.visibility_ms += ms_since(began);
        let mut evaluator = Evaluator::new(backend, target, &problem, evaluation);
        evaluator.evaluate(descents.iter().map(|d| (&d.steps.state, &*d.look.visibility)))?;
        for (i, descent) in descents.iter_mut().enumerate() {
            descent.begin(&problem, &settings, evaluator.rows(i), scratch);
        }
        loop {
            for descent in descents.iter_mut() {
                descent.propose(&problem, &settings, &mut scratch.solver);
            }
            let proposed =
                || descents.iter().filter_map(|d| d.steps.proposed().map(|s| (s, &*d.look.visibility)));
            if proposed().next().is_none() {
                return Ok(());
            }
            // What has stopped is no longer part of the call.
            evaluator.evaluate(proposed())?;
            let judged = descents.iter_mut().filter(|d| d.steps.proposed().is_some());
            for (k, descent) in judged.enumerate() {
                descent.judge(&problem, &settings, evaluator.rows(k), scratch);
            }
        }
    }
}

impl Aligner for InverseCompositional {
    fn levels(&self, model: &Model) -> usize {
        model.levels.len()
    }

    fn another(&self) -> Box<dyn Aligner> {
        Box::new(Self::new(self.options.clone()))
    }

    fn times(&self) -> AlignTimes {
        self.work.times
    }

    fn align(
        &mut self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        check(target, starts)?;
        self.with_work(|method, work| method.picked_up(backend, target, starts, work, estimates))
    }

    fn refine(
        &mut self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        check(target, starts)?;
        let levels = (COARSEST_ROBUST, COARSEST_ROBUST);
        self.with_work(|method, work| method.descend(backend, target, levels, starts, work, estimates))
    }

    fn search(
        &mut self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        around: &Start,
    ) -> Result<Option<PoseEstimate>> {
        check(target, std::slice::from_ref(around))?;
        self.with_work(|method, work| method.shift_search(backend, target, around, work)).map(Some)
    }
}
