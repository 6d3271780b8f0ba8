//! What the methods share: checks of the starts, visibility, calls of the backend, and the estimate at the end.

use nalgebra::Matrix3;

use super::covariance::covariance;
use super::derivative::SecondRows;
use super::levenberg_marquardt::State;
use super::normal_equations::{LevelProblem, NormalEquations, Rows};
use super::photometric::Grouping;
use super::score::Score;
use super::{PoseEstimate, Start, Target};
use crate::backend::{Backend, Linearization, Request, Sums, TriangleWarp};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::geometry::raster::{facing, visible_shares};
use crate::geometry::warp::{affine, homography};
use crate::model::Model;

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

/// Where the descents start.
pub(super) fn states_of(starts: &[Start]) -> Vec<State> {
    let state =
        |s: &Start| State { pose: s.camera_from_object.renormalised(), appearance: s.appearance.clone() };
    starts.iter().map(state).collect()
}

/// Where a descent ended.
#[derive(Debug)]
pub(super) struct End {
    pub(super) state: State,
    pub(super) visibility: Vec<f64>,
    /// Those at full size, within a step below the stop threshold of the state.
    pub(super) equations: NormalEquations,
    /// Steps over all levels.
    pub(super) iterations: usize,
    /// False if any level did not converge.
    pub(super) converged: bool,
}

/// The estimates of ends.
pub(super) fn finish(
    backend: &mut dyn Backend,
    target: &Target<'_>,
    ends: Vec<End>,
) -> Result<Vec<PoseEstimate>> {
    let scores = scores(backend, target, ends.iter().map(|e| (&e.state, &e.visibility)))?;
    let estimate = |(end, score): (End, Score)| PoseEstimate {
        score,
        covariance: covariance(&end.equations),
        hessian: end.equations.pose_hessian(),
        rms: if end.equations.cost.is_finite() { end.equations.cost.max(0.0).sqrt() } else { 0.0 },
        camera_from_object: end.state.pose,
        appearance: end.state.appearance,
        iterations: end.iterations,
        converged: end.converged,
    };
    Ok(ends.into_iter().zip(scores).map(estimate).collect())
}

/// The scores of states, the same measure for every method.
pub(super) fn scores<'s>(
    backend: &mut dyn Backend,
    target: &Target<'_>,
    states: impl Iterator<Item = (&'s State, &'s Vec<f64>)> + Clone,
) -> Result<Vec<Score>> {
    let level = SCORE_LEVEL.min(target.model.levels.len() - 1);
    let problem = LevelProblem::new(target, level, Grouping::FaceAndView);
    let mut evaluator = Evaluator::new(backend, target, &problem);
    evaluator.evaluate(states.clone())?;
    let score = |(k, (state, visibility)): (usize, (&State, &Vec<f64>))| {
        Score::new(problem.level, &evaluator.rows(k), visibility, &state.appearance)
    };
    Ok(states.enumerate().map(score).collect())
}

/// Share of every triangle that can be seen: 0 for backs, grazing triangles and those mostly hidden or much
/// compressed.
pub(super) fn visibility(target: &Target<'_>, pose: &Pose) -> Vec<f64> {
    let mesh = &target.model.shape.mesh;
    let shares = visible_shares(mesh, &target.camera.at_level(VISIBILITY_LEVEL), pose);
    let keep = |(t, share): (usize, f64)| {
        let seen = share >= MIN_VISIBLE && facing(&mesh.corners(t), pose) >= MIN_COSINE;
        if seen && aspect(target, pose, t) >= MIN_ASPECT { share } else { 0.0 }
    };
    shares.into_iter().enumerate().map(keep).collect()
}

/// Scale of the warp from a triangle's chart to the image in its worst direction, in units of that in its best one (0..1);
/// 0 without a chart or behind the camera.
fn aspect(target: &Target<'_>, pose: &Pose, triangle: usize) -> f64 {
    let affine = || {
        let geometry = target.model.levels[0].geometry[triangle].as_ref()?;
        let mut projected = geometry.corners;
        for (corner, x) in projected.iter_mut().zip(&geometry.points) {
            *corner = target.camera.project(&pose.transform_point(x))?;
        }
        affine(&geometry.corners, &projected)
    };
    affine().map_or(0.0, |a| {
        let scales = a.fixed_view::<2, 2>(0, 0).singular_values();
        scales.min() / scales.max()
    })
}

/// Runs the stages for many states of one level, with the perspective-exact warp.
pub(super) struct Evaluator<'a> {
    backend: &'a mut dyn Backend,
    target: &'a Target<'a>,
    problem: &'a LevelProblem<'a>,
    out: Linearization,
    warps: Vec<TriangleWarp>,
    appearance: Vec<f32>,
}

impl<'a> Evaluator<'a> {
    pub(super) fn new(
        backend: &'a mut dyn Backend,
        target: &'a Target<'a>,
        problem: &'a LevelProblem<'a>,
    ) -> Self {
        let (warps, appearance) = (Vec::new(), Vec::new());
        Self { backend, target, problem, out: Linearization::default(), warps, appearance }
    }

    /// Stage `accumulate`; every state comes with its visibility.
    pub(super) fn evaluate<'s>(
        &mut self,
        states: impl Iterator<Item = (&'s State, &'s Vec<f64>)>,
    ) -> Result<()> {
        let items = self.encode(states);
        self.backend.accumulate(
            &request(self.target, self.problem, items, &self.warps, &self.appearance),
            &mut self.out.sums,
        )
    }

    /// Stage `linearize`.
    pub(super) fn linearize<'s>(
        &mut self,
        states: impl Iterator<Item = (&'s State, &'s Vec<f64>)>,
    ) -> Result<()> {
        let items = self.encode(states);
        self.backend.linearize(
            &request(self.target, self.problem, items, &self.warps, &self.appearance),
            &mut self.out,
        )
    }

    /// Fills warps and appearance; returns the number of states.
    fn encode<'s>(&mut self, states: impl Iterator<Item = (&'s State, &'s Vec<f64>)>) -> usize {
        self.warps.clear();
        self.appearance.clear();
        let mut items = 0;
        for (state, visibility) in states {
            items += 1;
            self.appearance.extend(state.appearance.iter().copied().map(narrow));
            for (geometry, visible) in self.problem.level.geometry.iter().zip(visibility) {
                let geometry = geometry.as_ref().filter(|_| *visible > 0.0);
                self.warps.push(geometry.map_or(IDLE, |g| TriangleWarp {
                    image_from_chart: homography(&self.problem.camera, &state.pose, &g.object_from_chart),
                    active: true,
                }));
            }
        }
        items
    }

    /// The first-order sums of a state.
    pub(super) fn rows(&self, item: usize) -> Rows<'_> {
        let row_len = Sums::row_len(self.target.model.modes());
        Rows { data: self.out.sums.item(item), row_len }
    }

    /// The second-order sums of a state, after [`Self::linearize`].
    pub(super) fn seconds(&self, item: usize) -> SecondRows<'_> {
        let row_len = Linearization::row_len(self.target.model.modes());
        SecondRows { data: self.out.item(item), row_len }
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
