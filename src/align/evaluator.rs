//! What the methods share: checks of the starts, calls of the backend, and the estimate at the end.

use std::time::Instant;

use rayon::prelude::*;

use super::covariance::covariance;
use super::derivative::SecondRows;
use super::levenberg_marquardt::State;
use super::normal_equations::{LevelProblem, NormalEquations, Rows};
use super::rendering::{Light, rendered};
use super::score::Score;
use super::workspace::{Worker, for_each};
use super::{PoseEstimate, Start, Target};
use crate::backend::{Backend, Linearization, ModelId, Request, Sums, TriangleWarp};
use crate::error::{Error, Result};
use crate::geometry::warp::projection;
use crate::model::{Grouping, Model};

/// Pyramid level on which template and image are correlated: at full size heavy noise hides a right pose.
const SCORE_LEVEL: usize = 1;

/// Pyramid level on which a prediction is picked up; coarser ones are for the search.
const COARSEST_TRACKED: usize = 2;

/// The levels on which a prediction is tracked, from coarse to fine.
pub(super) fn tracked_levels(model: &Model) -> impl Iterator<Item = usize> + use<> {
    (0..=COARSEST_TRACKED.min(model.levels.len() - 1)).rev()
}

/// Pyramid levels that a frame must have for [`scores`].
pub(super) fn levels_for_scores(model: &Model) -> usize {
    model.levels.len().min(SCORE_LEVEL + 1)
}

/// Refuses starts that do not fit the model.
pub(super) fn check(target: &Target<'_>, starts: &[Start]) -> Result<()> {
    let modes = target.model.modes();
    for (i, start) in starts.iter().enumerate() {
        if !start.camera_from_object.is_finite() {
            return Err(Error::invalid(format!("start pose {i}"), "it is not finite", "give a valid pose"));
        }
        if start.appearance.len() != modes {
            let problem = format!("{} appearance parameters, the model has {modes}", start.appearance.len());
            return Err(Error::invalid(format!("start {i}"), problem, "give one per mode, 0 for the mean"));
        }
    }
    Ok(())
}

/// Where a descent ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct End<'a> {
    /// The state, and what is visible there.
    pub(super) sight: Sight<'a>,
    /// Those at full size, within a step below the stop threshold of the state.
    pub(super) equations: &'a NormalEquations,
    /// Steps over all levels.
    pub(super) iterations: usize,
    /// False if any level did not converge.
    pub(super) converged: bool,
    /// How much the gradient changes with the pose, in units of what JtQJ says.
    pub(super) response: f64,
}

/// The estimates of ends, in the memory of earlier ones.
pub(super) fn finish<'a>(
    backend: &mut dyn Backend,
    targets: &[Target<'_>],
    ends: impl Iterator<Item = End<'a>> + Clone,
    evaluation: &mut Evaluation,
    workers: &mut [Worker],
    estimates: &mut Vec<PoseEstimate>,
) -> Result<()> {
    estimates.resize_with(ends.clone().count(), PoseEstimate::default);
    for_each(estimates.iter_mut().zip(ends.clone()), workers, |_, (estimate, end), worker| {
        let (equations, solver) = (end.equations, &mut worker.scratch.solver);
        estimate.covariance = covariance(equations, end.response, solver);
        estimate.hessian = equations.pose_hessian(solver);
        estimate.rms = if equations.cost.is_finite() { equations.cost.max(0.0).sqrt() } else { 0.0 };
        estimate.camera_from_object = end.sight.state.pose;
        estimate.appearance.clone_from(&end.sight.state.appearance);
        (estimate.iterations, estimate.converged) = (end.iterations, end.converged);
    });
    let scores_of = estimates.iter_mut().map(|estimate| &mut estimate.score);
    scores(backend, targets, ends.map(|end| end.sight), scores_of, evaluation, workers)
}

/// The scores of states, the same measure for every method.
fn scores<'s>(
    backend: &mut dyn Backend,
    targets: &[Target<'_>],
    sights: impl Iterator<Item = Sight<'s>> + Clone,
    scores: impl Iterator<Item = &'s mut Score>,
    evaluation: &mut Evaluation,
    workers: &mut [Worker],
) -> Result<()> {
    let level = SCORE_LEVEL.min(targets[0].model.levels.len() - 1);
    let problem = LevelProblem::new(&targets[0], level, Grouping::FaceAndView);
    let mut evaluator = Evaluator::new(backend, targets, &problem, evaluation);
    evaluator.evaluate(sights.clone())?;
    let rows = evaluator.all_rows();
    for_each(sights.zip(scores), workers, |k, (sight, score), worker| {
        let (values, lambda) = (&mut worker.scratch.values, &sight.state.appearance);
        *score = Score::new(problem.level, &rows(k), sight.visibility, lambda, values);
    });
    Ok(())
}

/// The score of a single state.
pub(super) fn score(
    backend: &mut dyn Backend,
    target: &Target<'_>,
    state: &State,
    visibility: &[f64],
) -> Result<Score> {
    let (mut evaluation, mut worker, mut found) =
        (Evaluation::default(), Worker::default(), Score::default());
    let (targets, workers) = (std::slice::from_ref(target), std::slice::from_mut(&mut worker));
    let sights = std::iter::once(Sight::new(state, visibility));
    scores(backend, targets, sights, std::iter::once(&mut found), &mut evaluation, workers)?;
    Ok(found)
}

/// A state to evaluate.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight<'s> {
    /// Number of the target whose frame it is looked at in.
    pub(super) frame: usize,
    pub(super) state: &'s State,
    /// Share of each triangle that nothing hides.
    pub(super) visibility: &'s [f64],
    /// Light on each triangle; empty where it is not known.
    pub(super) light: &'s [Light],
}

impl<'s> Sight<'s> {
    /// In the first target's frame, in light that is not known.
    pub(super) fn new(state: &'s State, visibility: &'s [f64]) -> Self {
        Self { frame: 0, state, visibility, light: &[] }
    }
}

/// What the stages are given and what they hand back.
#[derive(Debug, Default)]
pub(super) struct Evaluation {
    out: Linearization,
    frames: Vec<usize>,
    warps: Vec<TriangleWarp>,
    appearance: Vec<f32>,
    /// Wall time spent in the backend, milliseconds.
    pub(super) spent_ms: f64,
}

impl Evaluation {
    /// What was filled in last, where what comes of it goes, and the time it takes.
    fn request(
        &mut self,
        model: ModelId,
        problem: &LevelProblem<'_>,
    ) -> (Request<'_>, &mut Linearization, &mut f64) {
        let LevelProblem { number: level, image_level, .. } = *problem;
        let Self { out, frames, warps, appearance, spent_ms } = self;
        let items = frames.len();
        (Request { model, level, image_level, items, frames, warps, appearance }, out, spent_ms)
    }
}

/// Runs the stages for many states of one level, with the perspective-exact warp.
pub(super) struct Evaluator<'a> {
    backend: &'a mut dyn Backend,
    /// One per current frame, all of the problem's model.
    targets: &'a [Target<'a>],
    problem: &'a LevelProblem<'a>,
    memory: &'a mut Evaluation,
}

impl<'a> Evaluator<'a> {
    pub(super) fn new(
        backend: &'a mut dyn Backend,
        targets: &'a [Target<'a>],
        problem: &'a LevelProblem<'a>,
        memory: &'a mut Evaluation,
    ) -> Self {
        Self { backend, targets, problem, memory }
    }

    /// Stage `accumulate`.
    pub(super) fn evaluate<'s>(&mut self, sights: impl Iterator<Item = Sight<'s>> + Clone) -> Result<()> {
        self.encode(sights, self.problem.number == 0);
        let began = Instant::now();
        let (request, out, spent_ms) = self.memory.request(self.targets[0].id, self.problem);
        self.backend.accumulate(&request, &mut out.sums)?;
        *spent_ms += ms_since(began);
        Ok(())
    }

    /// Stage `linearize`.
    pub(super) fn linearize<'s>(&mut self, sights: impl Iterator<Item = Sight<'s>> + Clone) -> Result<()> {
        self.encode(sights, false);
        let began = Instant::now();
        let (request, out, spent_ms) = self.memory.request(self.targets[0].id, self.problem);
        self.backend.linearize(&request, out)?;
        *spent_ms += ms_since(began);
        Ok(())
    }

    /// Fills frames, warps and appearance; with `is_blurred` the template is blurred as the frame is, which is for full size.
    fn encode<'s>(&mut self, sights: impl Iterator<Item = Sight<'s>> + Clone, is_blurred: bool) {
        let Evaluation { frames, warps, appearance, .. } = &mut *self.memory;
        frames.clear();
        frames.extend(sights.clone().map(|s| s.frame));
        appearance.clear();
        appearance.extend(sights.clone().flat_map(|s| s.state.appearance.iter().copied().map(narrow)));
        let geometry = &self.problem.level.geometry;
        warps.resize_with(frames.len() * geometry.len(), TriangleWarp::idle);
        let (targets, image_level) = (self.targets, self.problem.image_level);
        let of_sight = |(sight, warps): (Sight<'_>, &mut [TriangleWarp])| {
            let camera = targets[sight.frame].camera.at_level(image_level);
            let projection = projection(&camera, &sight.state.pose);
            for (t, (warp, geometry)) in warps.iter_mut().zip(geometry).enumerate() {
                let geometry = geometry.as_ref().filter(|_| sight.visibility[t] > 0.0);
                *warp = geometry.map_or_else(TriangleWarp::idle, |g| {
                    let light = sight.light.get(t).copied().unwrap_or_default();
                    rendered(projection * g.object_from_chart, g, light, is_blurred)
                });
            }
        };
        let per_sight = geometry.len().max(1);
        if targets.len() == 1 {
            sights.zip(warps.chunks_exact_mut(per_sight)).for_each(of_sight);
        } else {
            let sights: Vec<_> = sights.collect();
            sights.into_par_iter().zip(warps.par_chunks_exact_mut(per_sight)).for_each(of_sight);
        }
    }

    /// The first-order sums of a state.
    pub(super) fn rows(&self, item: usize) -> Rows<'_> {
        self.all_rows()(item)
    }

    /// The same for many threads.
    pub(super) fn all_rows<'e>(&'e self) -> impl Fn(usize) -> Rows<'e> + Sync {
        let (sums, row_len) = (&self.memory.out.sums, Sums::row_len(self.problem.modes()));
        move |item| Rows { data: sums.item(item), row_len }
    }

    /// The second-order sums of a state, after [`Self::linearize`].
    pub(super) fn seconds(&self, item: usize) -> SecondRows<'_> {
        let row_len = Linearization::row_len(self.problem.modes());
        SecondRows { data: self.memory.out.item(item), row_len }
    }
}

/// The device works in f32.
#[expect(clippy::cast_possible_truncation, reason = "the device works in f32")]
pub(super) fn narrow(x: f64) -> f32 {
    x as f32
}

pub(super) fn ms_since(began: Instant) -> f64 {
    began.elapsed().as_secs_f64() * 1e3
}
