//! Estimates set against known poses, frame by frame.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::errors::{self, EvalObject};
use crate::dataset::ResultRow;
use crate::geometry::{Camera, Pose};

/// One estimated pose, by any tracker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Frame the pose is of. A frame may occur several times, as when it was aligned from several starts.
    pub frame: u32,
    /// `camera_from_object`, metres.
    pub pose: Pose,
    /// Confidence; 0 or less means that the tracker says it lost the object.
    pub score: f64,
    /// Time the estimate took, seconds; `None` where unknown.
    pub time_s: Option<f64>,
    /// Iterations it took; `None` where unknown.
    pub iterations: Option<f64>,
}

impl From<&ResultRow> for Estimate {
    fn from(row: &ResultRow) -> Self {
        Self { frame: row.im_id, pose: row.pose, score: row.score, time_s: row.time_s, iterations: None }
    }
}

/// The errors of one estimate, or a frame of the truth without an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameErrors {
    /// Frame id.
    pub frame: u32,
    /// True by the rule of [`errors::is_lost`], and for frames without an estimate.
    pub lost: bool,
    /// The errors; `None` without an estimate.
    pub errors: Option<PoseErrors>,
    /// Time the estimate took, seconds.
    pub time_s: Option<f64>,
    /// Iterations it took.
    pub iterations: Option<f64>,
}

/// All errors of one pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseErrors {
    /// [`errors::translation_error_mm`], camera axes.
    pub translation_mm: Vector3<f64>,
    /// [`errors::rotation_error_deg`], camera axes.
    pub rotation_deg: Vector3<f64>,
    /// [`errors::add_mm`].
    pub add_mm: f64,
    /// [`errors::corner_error_px`]; `None` without a camera for this frame or with a corner behind it.
    pub corner_px: Option<f64>,
    /// [`errors::motion_error`] since the first tracked frame, mm and degrees; `None` for lost frames and for
    /// the first tracked frame itself.
    pub motion: Option<(f64, f64)>,
}

/// The errors of every estimate for a frame of the truth, and one entry for every frame of the truth without
/// one; by ascending frame, estimates of one frame in the order given. `cameras` is needed for pixels alone.
pub fn frame_errors(
    estimates: &[Estimate],
    truth: &BTreeMap<u32, Pose>,
    object: &EvalObject,
    cameras: &BTreeMap<u32, Camera>,
) -> Vec<FrameErrors> {
    let mut judged: Vec<(&Estimate, FrameErrors)> = estimates
        .iter()
        .filter_map(|e| Some((e, judge(e, truth.get(&e.frame)?, object, cameras.get(&e.frame)))))
        .collect();
    judged.sort_by_key(|(e, _)| e.frame);
    add_motion(&mut judged, truth, object);
    let seen: BTreeSet<u32> = judged.iter().map(|(e, _)| e.frame).collect();
    let missing = truth.keys().filter(|frame| !seen.contains(frame)).map(|&frame| FrameErrors {
        frame,
        lost: true,
        errors: None,
        time_s: None,
        iterations: None,
    });
    let mut frames: Vec<FrameErrors> = judged.into_iter().map(|(_, f)| f).chain(missing).collect();
    frames.sort_by_key(|f| f.frame);
    frames
}

fn judge(estimate: &Estimate, truth: &Pose, object: &EvalObject, camera: Option<&Camera>) -> FrameErrors {
    let pose = &estimate.pose;
    let translation_mm = errors::translation_error_mm(pose, truth, &object.centre());
    let rotation_deg = errors::rotation_error_deg(pose, truth);
    let errors = PoseErrors {
        translation_mm,
        rotation_deg,
        add_mm: errors::add_mm(pose, truth, object.vertices()),
        corner_px: camera.and_then(|c| errors::corner_error_px(pose, truth, &object.corners(), c)),
        motion: None,
    };
    FrameErrors {
        frame: estimate.frame,
        lost: errors::is_lost(translation_mm.norm(), rotation_deg.norm(), estimate.score),
        errors: Some(errors),
        time_s: estimate.time_s,
        iterations: estimate.iterations,
    }
}

/// Fills in the error of the motion since the first tracked frame.
fn add_motion(judged: &mut [(&Estimate, FrameErrors)], truth: &BTreeMap<u32, Pose>, object: &EvalObject) {
    let mut tracked = judged.iter_mut().filter(|(_, f)| !f.lost);
    let Some((first, _)) = tracked.next() else { return };
    for (later, frame) in tracked.filter(|(later, _)| later.frame != first.frame) {
        if let Some(errors) = &mut frame.errors {
            let known = (&truth[&first.frame], &truth[&later.frame]);
            let motion = errors::motion_error((&first.pose, &later.pose), known, &object.centre());
            errors.motion = Some(motion);
        }
    }
}
