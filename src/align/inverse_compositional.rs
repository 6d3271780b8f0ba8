//! The default method: template gradient, pose-dependent geometry, right composition, coarse to fine.

use std::time::Instant;

use super::evaluator::{Evaluator, check, ms_since, tracked_levels};
use super::levenberg_marquardt::{Descent, Settings};
use super::normal_equations::LevelProblem;
use super::robust::Redescent;
use super::workspace::{Workspace, for_each};
use super::{AlignTimes, Aligner, PoseEstimate, Start, Target};
use crate::backend::Backend;
use crate::error::Result;
use crate::model::{Grouping, Model};

/// Triangle weights act from this level down: on coarser ones they cost reach.
pub(super) const COARSEST_ROBUST: usize = 1;
/// Steps at full size that are taken whatever the cost says, pixels.
const TRUSTED_PX: f64 = 0.1;
/// How a prediction is picked up: from all levels, with triangle weights on the fine ones.
pub(super) const TRACKED: (usize, usize) = (usize::MAX, COARSEST_ROBUST);

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
        let mut work = Workspace::lent(&mut self.work);
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
            trusted_px: if level == 0 { TRUSTED_PX } else { 0.0 },
            redescent: robust.filter(|coarsest| level <= *coarsest).map(|_| Redescent::DEFAULT),
        }
    }

    /// Descends from the levels up to `coarsest`, with triangle weights from level `robust_from` down.
    pub(super) fn descend(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        (coarsest, robust_from): (usize, usize),
        starts: &[Start],
        work: &mut Workspace,
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        work.begin(starts);
        self.run(backend, std::slice::from_ref(target), (coarsest, robust_from), work, estimates)
    }

    /// As [`Self::descend`] for the descents that the workspace has begun, in the frames of the targets.
    fn run(
        &self,
        backend: &mut dyn Backend,
        targets: &[Target<'_>],
        (coarsest, robust_from): (usize, usize),
        work: &mut Workspace,
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        let began = Instant::now();
        let levels = tracked_levels(targets[0].model).filter(|level| *level <= coarsest);
        let robust = self.options.robust.then_some(robust_from);
        self.coarse_to_fine(backend, targets, levels, robust, work)?;
        work.end_times(began);
        work.finish(backend, targets, estimates)
    }

    pub(super) fn problem<'a>(&self, target: &Target<'a>, level: usize) -> LevelProblem<'a> {
        LevelProblem::new(target, level, self.options.full_size_grouping)
    }

    /// Descends from level to level, with triangle weights from level `robust` down; all descents of the workspace in
    /// step.
    pub(super) fn coarse_to_fine(
        &self,
        backend: &mut dyn Backend,
        targets: &[Target<'_>],
        levels: impl Iterator<Item = usize>,
        robust: Option<usize>,
        work: &mut Workspace,
    ) -> Result<()> {
        for level in levels {
            self.level(backend, targets, level, robust, work)?;
            work.descents.iter_mut().for_each(|d| d.steps.end());
        }
        Ok(())
    }

    fn level(
        &self,
        backend: &mut dyn Backend,
        targets: &[Target<'_>],
        level: usize,
        robust: Option<usize>,
        work: &mut Workspace,
    ) -> Result<()> {
        let problem = |frame: usize| self.problem(&targets[frame], level);
        let (settings, of_all) = (self.settings(level, robust), problem(0));
        let Workspace { descents, evaluation, workers, times } = work;
        let began = Instant::now();
        for_each(descents.iter_mut(), workers, |_, d, worker| {
            d.look.see(&targets[d.frame], &d.steps.state.pose, &mut worker.zbuffer);
        });
        times.visibility_ms += ms_since(began);
        let mut evaluator = Evaluator::new(backend, targets, &of_all, evaluation);
        evaluator.evaluate(descents.iter().map(Descent::here))?;
        {
            let rows = evaluator.all_rows();
            for_each(descents.iter_mut(), workers, |k, d, worker| {
                d.begin(&problem(d.frame), &settings, rows(k), &mut worker.scratch);
            });
        }
        loop {
            for_each(descents.iter_mut(), workers, |_, d, worker| {
                d.propose(&problem(d.frame), &settings, &mut worker.scratch.solver);
            });
            let proposed = || descents.iter().filter_map(Descent::proposed);
            if proposed().next().is_none() {
                return Ok(());
            }
            // What has stopped is no longer part of the call.
            evaluator.evaluate(proposed())?;
            let rows = evaluator.all_rows();
            let judged = descents.iter_mut().filter(|d| d.proposed().is_some());
            for_each(judged, workers, |k, d, worker| {
                d.judge(&problem(d.frame), &settings, rows(k), &mut worker.scratch);
            });
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

    fn shares_calls(&self) -> bool {
        true
    }

    fn align_streams(
        &mut self,
        backend: &mut dyn Backend,
        targets: &[Target<'_>],
        starts: &[Start],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        for (target, start) in targets.iter().zip(starts) {
            check(target, std::slice::from_ref(start))?;
        }
        self.with_work(|method, work| {
            work.begin_streams(starts);
            method.run(backend, targets, TRACKED, work, estimates)
        })
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
