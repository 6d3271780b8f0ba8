//! Runs the `accumulate` stage for many states of one level.

use super::Target;
use super::levenberg_marquardt::State;
use super::normal_equations::{LevelProblem, Rows};
use crate::backend::{Backend, Request, Sums, TriangleWarp};
use crate::error::Result;
use crate::geometry::Pose;
use crate::geometry::raster::{facing, visible_shares};
use crate::geometry::warp::homography;

/// Triangles seen more obliquely than this cosine are left out.
const MIN_COSINE: f64 = 0.06;
/// Visibility is judged on an image of this pyramid level.
const VISIBILITY_LEVEL: usize = 2;
/// Triangles with less than this share free of occlusion by the object itself are left out.
const MIN_VISIBLE: f64 = 0.5;

/// Share of every triangle that can be seen: 0 for backs, grazing triangles and those mostly hidden.
pub(super) fn visibility(target: &Target<'_>, pose: &Pose) -> Vec<f64> {
    let mesh = &target.model.shape.mesh;
    let shares = visible_shares(mesh, &target.camera.at_level(VISIBILITY_LEVEL), pose);
    let keep = |(t, share): (usize, f64)| {
        let seen = share >= MIN_VISIBLE && facing(&mesh.corners(t), pose) >= MIN_COSINE;
        if seen { share } else { 0.0 }
    };
    shares.into_iter().enumerate().map(keep).collect()
}

/// The backend, with the level it works on.
pub(super) struct Evaluator<'a> {
    pub(super) backend: &'a mut dyn Backend,
    pub(super) target: &'a Target<'a>,
    pub(super) level: usize,
    pub(super) problem: &'a LevelProblem<'a>,
    pub(super) sums: Sums,
}

impl Evaluator<'_> {
    /// Evaluates states; triangles without visibility are left out.
    pub(super) fn evaluate<'s>(
        &mut self,
        states: impl Iterator<Item = (&'s State, &'s Vec<f64>)>,
    ) -> Result<()> {
        let (mut warps, mut appearance, mut items) = (Vec::new(), Vec::new(), 0);
        for (state, visibility) in states {
            items += 1;
            #[expect(clippy::cast_possible_truncation, reason = "the device works in f32")]
            appearance.extend(state.appearance.iter().map(|a| *a as f32));
            for (geometry, visible) in self.problem.level.geometry.iter().zip(visibility) {
                let geometry = geometry.as_ref().filter(|_| *visible > 0.0);
                warps.push(geometry.map_or(
                    TriangleWarp { image_from_chart: nalgebra::Matrix3::zeros(), active: false },
                    |g| TriangleWarp {
                        image_from_chart: homography(&self.problem.camera, &state.pose, &g.object_from_chart),
                        active: true,
                    },
                ));
            }
        }
        let request = Request {
            model: self.target.id,
            level: self.level,
            items,
            warps: &warps,
            appearance: &appearance,
        };
        self.backend.accumulate(&request, &mut self.sums)
    }

    /// Sums of the k-th state of the last evaluation.
    pub(super) fn rows(&self, item: usize) -> Rows<'_> {
        let row_len = Sums::row_len(self.target.model.modes());
        Rows { data: self.sums.item(item), row_len }
    }
}
