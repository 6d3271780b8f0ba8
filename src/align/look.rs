//! What one camera says about a state: what is visible, triangle weights, light and equations.

use super::Target;
use super::derivative::Derivative;
use super::levenberg_marquardt::{Settings, State};
use super::normal_equations::{LevelProblem, NormalEquations, Rows};
use super::rendering::Light;
use super::robust::triangle_weights;
use super::visibility::look_at;
use super::workspace::Scratch;
use crate::geometry::Pose;
use crate::geometry::distance::rms_px;
use crate::geometry::raster::ZBuffer;

/// What is visible is not judged anew where the corners of the object have moved by less (rms, pixels of full size).
const SAME_VIEW_PX: f64 = 2.0;

/// What one camera says about a state.
#[derive(Debug, Default)]
pub(super) struct Look {
    /// Sums at the state.
    pub(super) rows: Vec<f64>,
    /// Share of each triangle that nothing hides, as [`Self::see`] judged it last.
    pub(super) visibility: Vec<f64>,
    /// The pose at which it did, if it did in this frame.
    seen_from: Option<Pose>,
    pub(super) weights: Vec<f64>,
    /// Light on every triangle at the last look at this frame; empty before the first.
    pub(super) light: Vec<Light>,
    pub(super) equations: NormalEquations,
}

impl Look {
    /// A new frame: nothing is known of what is visible.
    pub(super) fn begin(&mut self) {
        self.seen_from = None;
        self.light.clear();
    }

    /// Judges what is visible at the pose where a level starts, unless it is where that was judged before.
    pub(super) fn see(&mut self, target: &Target<'_>, pose: &Pose, zbuffer: &mut ZBuffer) {
        let corners = &target.model.shape.corners;
        let moved = |from: &Pose| rms_px(&target.camera, corners, from, pose);
        if self.seen_from.as_ref().and_then(moved).is_some_and(|px| px < SAME_VIEW_PX) {
            return;
        }
        look_at(target, pose, zbuffer, &mut self.visibility);
        self.seen_from = Some(*pose);
    }

    /// Weights and equations at a state, whose sums and visibility are known.
    pub(super) fn take(
        &mut self,
        problem: &LevelProblem<'_>,
        settings: &Settings,
        state: &State,
        rows: Rows<'_>,
        scratch: &mut Scratch,
    ) {
        self.rows.clear();
        self.rows.extend(rows.data);
        let Self { visibility, weights, equations, light, .. } = self;
        triangle_weights(problem, &rows, visibility, settings.redescent, scratch, weights);
        equations.assemble(problem, state, &rows, weights, Derivative::Template, scratch);
        Light::of_triangles(problem.groups, &scratch.solutions, light);
    }
}
