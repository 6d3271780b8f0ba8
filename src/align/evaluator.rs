//! What the methods share: checks of the starts, visibility, calls of the backend, and the estimate at the end.

use std::time::Instant;

use nalgebra::Matrix3;

use super::covariance::covariance;
use super::derivative::{SecondRows, image_from_chart, projected_corners};
use super::levenberg_marquardt::State;
use super::normal_equations::{LevelProblem, NormalEquations, Rows};
use super::score::Score;
use super::workspace::Scratch;
use super::{PoseEstimate, Start, Target};
use crate::backend::{Backend, Linearization, Request, Sums, TriangleWarp};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::geometry::raster::{ZBuffer, facing};
use crate::geometry::warp::projection;
use crate::model::{Grouping, Model};

/// Triangles seen more obliquely than this cosine are left out.
const MIN_COSINE: f64 = 0.06;
/// Triangles whose chart the image shows more compressed in one direction than in the other by this factor are left out:
/// their chart keeps its distance from the border of the face in pixels of the chart, which in the image is then less
/// than the width of a pixel that mixes the face with what lies behind.
const MIN_ASPECT: f64 = 0.25;
/// Visibility is judged on an image of this pyramid level.
const VISIBILITY_LEVEL: usize = 2;
/// Triangles with less than this share free of occlusion by the object itself are left out.
const MIN_VISIBLE: f64 = 0.5;

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

/// A triangle that is left out.
pub(super) const IDLE: TriangleWarp = TriangleWarp {
    image_from_chart: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    active: false,
};

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
    pub(super) state: &'a State,
    pub(super) visibility: &'a [f64],
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
    target: &Target<'_>,
    ends: impl Iterator<Item = End<'a>> + Clone,
    evaluation: &mut Evaluation,
    scratch: &mut Scratch,
    estimates: &mut Vec<PoseEstimate>,
) -> Result<()> {
    estimates.resize_with(ends.clone().count(), PoseEstimate::default);
    for (estimate, end) in estimates.iter_mut().zip(ends.clone()) {
        estimate.covariance = covariance(end.equations, end.response, &mut scratch.solver);
        estimate.hessian = end.equations.pose_hessian(&mut scratch.solver);
        estimate.rms = if end.equations.cost.is_finite() { end.equations.cost.max(0.0).sqrt() } else { 0.0 };
        estimate.camera_from_object = end.state.pose;
        estimate.appearance.clone_from(&end.state.appearance);
        (estimate.iterations, estimate.converged) = (end.iterations, end.converged);
    }
    let states = ends.map(|end| (end.state, end.visibility));
    scores(backend, target, states, evaluation, &mut scratch.values, |k, score| estimates[k].score = score)
}

/// The scores of states by their number, the same measure for every method.
pub(super) fn scores<'s>(
    backend: &mut dyn Backend,
    target: &Target<'_>,
    states: impl Iterator<Item = (&'s State, &'s [f64])> + Clone,
    evaluation: &mut Evaluation,
    values: &mut Vec<f64>,
    mut scored: impl FnMut(usize, Score),
) -> Result<()> {
    let level = SCORE_LEVEL.min(target.model.levels.len() - 1);
    let problem = LevelProblem::new(target, level, Grouping::FaceAndView);
    let mut evaluator = Evaluator::new(backend, target, &problem, evaluation);
    evaluator.evaluate(states.clone())?;
    for (k, (state, visibility)) in states.enumerate() {
        scored(k, Score::new(problem.level, &evaluator.rows(k), visibility, &state.appearance, values));
    }
    Ok(())
}

/// The score of a single state.
pub(super) fn score(
    backend: &mut dyn Backend,
    target: &Target<'_>,
    state: &State,
    visibility: &[f64],
) -> Result<Score> {
    let (mut evaluation, mut values, mut found) = (Evaluation::default(), Vec::new(), Score::default());
    let states = std::iter::once((state, visibility));
    scores(backend, target, states, &mut evaluation, &mut values, |_, score| found = score)?;
    Ok(found)
}

/// Share of every triangle that can be seen: 0 for backs, grazing triangles and those mostly hidden or much
/// compressed.
pub(super) fn visibility(target: &Target<'_>, pose: &Pose) -> Vec<f64> {
    let mut visibility = Vec::new();
    look_at(target, pose, &mut ZBuffer::default(), &mut visibility);
    visibility
}

/// [`visibility`] in the memory of earlier calls.
pub(super) fn look_at(target: &Target<'_>, pose: &Pose, zbuffer: &mut ZBuffer, visibility: &mut Vec<f64>) {
    let mesh = &target.model.shape.mesh;
    zbuffer.visible_shares(mesh, &target.camera.at_level(VISIBILITY_LEVEL), pose, visibility);
    for (t, share) in visibility.iter_mut().enumerate() {
        let is_seen = *share >= MIN_VISIBLE && facing(&mesh.corners(t), pose) >= MIN_COSINE;
        *share = if is_seen && is_open(target, pose, t) { *share } else { 0.0 };
    }
}

/// What the stages are given and what they hand back.
#[derive(Debug, Default)]
pub(super) struct Evaluation {
    out: Linearization,
    warps: Vec<TriangleWarp>,
    appearance: Vec<f32>,
    /// Wall time spent in the backend, milliseconds.
    pub(super) spent_ms: f64,
}

/// Does the image show a triangle less compressed than [`MIN_ASPECT`] says? False without a chart or
/// behind the camera.
fn is_open(target: &Target<'_>, pose: &Pose, triangle: usize) -> bool {
    let affine = || {
        let geometry = target.model.levels[0].geometry[triangle].as_ref()?;
        Some(image_from_chart(&projected_corners(&target.camera, pose, geometry)?, geometry))
    };
    // With singular values s1 >= s2: |det A| = s1 s2 and |A|^2 = s1^2 + s2^2, and s1 s2 / (s1^2 + s2^2) grows with s2 / s1.
    let least = MIN_ASPECT / (1.0 + MIN_ASPECT * MIN_ASPECT);
    affine().is_some_and(|a| a.determinant().abs() >= least * a.norm_squared())
}

/// Runs the stages for many states of one level, with the perspective-exact warp.
pub(super) struct Evaluator<'a> {
    backend: &'a mut dyn Backend,
    target: &'a Target<'a>,
    problem: &'a LevelProblem<'a>,
    memory: &'a mut Evaluation,
}

impl<'a> Evaluator<'a> {
    pub(super) fn new(
        backend: &'a mut dyn Backend,
        target: &'a Target<'a>,
        problem: &'a LevelProblem<'a>,
        memory: &'a mut Evaluation,
    ) -> Self {
        Self { backend, target, problem, memory }
    }

    /// Stage `accumulate`; every state comes with its visibility.
    pub(super) fn evaluate<'s>(
        &mut self,
        states: impl Iterator<Item = (&'s State, &'s [f64])>,
    ) -> Result<()> {
        let items = self.encode(states);
        let began = Instant::now();
        let Evaluation { out, warps, appearance, spent_ms } = &mut *self.memory;
        let request = request(self.target, self.problem, items, warps, appearance);
        self.backend.accumulate(&request, &mut out.sums)?;
        *spent_ms += ms_since(began);
        Ok(())
    }

    /// Stage `linearize`.
    pub(super) fn linearize<'s>(
        &mut self,
        states: impl Iterator<Item = (&'s State, &'s [f64])>,
    ) -> Result<()> {
        let items = self.encode(states);
        let began = Instant::now();
        let Evaluation { out, warps, appearance, spent_ms } = &mut *self.memory;
        let request = request(self.target, self.problem, items, warps, appearance);
        self.backend.linearize(&request, out)?;
        *spent_ms += ms_since(began);
        Ok(())
    }

    /// Fills warps and appearance; returns the number of states.
    fn encode<'s>(&mut self, states: impl Iterator<Item = (&'s State, &'s [f64])>) -> usize {
        let Evaluation { warps, appearance, .. } = &mut *self.memory;
        warps.clear();
        appearance.clear();
        let mut items = 0;
        for (state, visibility) in states {
            items += 1;
            let projection = projection(&self.problem.camera, &state.pose);
            appearance.extend(state.appearance.iter().copied().map(narrow));
            for (geometry, visible) in self.problem.level.geometry.iter().zip(visibility) {
                let geometry = geometry.as_ref().filter(|_| *visible > 0.0);
                warps.push(geometry.map_or(IDLE, |g| TriangleWarp {
                    image_from_chart: projection * g.object_from_chart,
                    active: true,
                }));
            }
        }
        items
    }

    /// The first-order sums of a state.
    pub(super) fn rows(&self, item: usize) -> Rows<'_> {
        let row_len = Sums::row_len(self.target.model.modes());
        Rows { data: self.memory.out.sums.item(item), row_len }
    }

    /// The second-order sums of a state, after [`Self::linearize`].
    pub(super) fn seconds(&self, item: usize) -> SecondRows<'_> {
        let row_len = Linearization::row_len(self.target.model.modes());
        SecondRows { data: self.memory.out.item(item), row_len }
    }
}

fn request<'r>(
    target: &Target<'_>,
    problem: &LevelProblem<'_>,
    items: usize,
    warps: &'r [TriangleWarp],
    appearance: &'r [f32],
) -> Request<'r> {
    let LevelProblem { number: level, image_level, .. } = *problem;
    Request { model: target.id, level, image_level, items, warps, appearance }
}

/// The device works in f32.
#[expect(clippy::cast_possible_truncation, reason = "the device works in f32")]
pub(super) fn narrow(x: f64) -> f32 {
    x as f32
}

pub(super) fn ms_since(began: Instant) -> f64 {
    began.elapsed().as_secs_f64() * 1e3
}
