//! The evaluation of a sequence: what is reported, and how it is summed up.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::errors::{self, EvalObject};
use super::frames::{Estimate, FrameErrors, PoseErrors, frame_errors};
use super::robot::{RobotCell, RobotErrors, robot_errors};
use super::statistics::{PerAxis, maximum, mean, median, percentile, rms};
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose};

/// How well a tracker did. The names are those of the JSON report; what is unknown is `None` (null).
///
/// Statistics of errors are over the tracked frames, that is all but the lost ones; time and iterations are over
/// all judged estimates that state them, because a lost frame costs time too.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Evaluation {
    /// Judged estimates, plus frames of the truth without an estimate.
    pub frames: usize,
    /// How many of `frames` are lost: beyond 5 cm or 5 degrees, given up by the tracker, or without an estimate.
    pub lost: usize,
    /// Frames of the truth without an estimate; they count as lost.
    pub missing: usize,
    /// Estimates for frames without truth; they are not judged.
    pub without_truth: usize,
    /// Root mean square length of the translation error, millimetres.
    pub rms_t_mm: Option<f64>,
    /// Root mean square angle of the rotation error, degrees.
    pub rms_r_deg: Option<f64>,
    /// Translation error of the object's centre per camera axis, millimetres.
    pub translation_mm: PerAxis,
    /// Rotation error per camera axis, degrees.
    pub rotation_deg: PerAxis,
    /// ADD, millimetres.
    pub add_mm: Typical,
    /// Reprojection error of the bounding box's corners, pixels.
    pub corner_px: TypicalAndMax,
    /// Error of the motion since the first tracked frame.
    pub relative: Relative,
    /// Noise from frame to frame.
    pub jitter: Jitter,
    /// Time per estimate, milliseconds.
    pub ms_per_frame: Typical,
    /// Mean number of iterations per estimate.
    pub iterations_mean: Option<f64>,
    /// Motion of the end-effector against the robot; only with robot poses and a hand-eye transform.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<RobotErrors>,
}

/// Median and 95th percentile.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Typical {
    /// Half of the values are below.
    pub median: Option<f64>,
    /// 95 % of the values are below.
    pub p95: Option<f64>,
}

/// Median, 95th percentile, and the largest value.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TypicalAndMax {
    /// Half of the values are below.
    pub median: Option<f64>,
    /// 95 % of the values are below.
    pub p95: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
}

/// Error of the object's motion relative to the first tracked frame. A constant difference between the object
/// frames of estimate and truth cancels, see [`super::errors::motion_error`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Relative {
    /// Median, millimetres of the object's centre.
    pub t_mm_median: Option<f64>,
    /// Median, degrees.
    pub r_deg_median: Option<f64>,
}

/// Root mean square change of the error vector between successive frames, divided by the square root of 2: for
/// errors independent from frame to frame this is their standard deviation, and a constant error gives 0.
/// Taken where both of two successive frames of the truth are tracked and have one estimate each.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Jitter {
    /// Translation, millimetres.
    pub t_mm: Option<f64>,
    /// Rotation, degrees.
    pub r_deg: Option<f64>,
}

impl Typical {
    fn of(values: &[f64]) -> Self {
        Self { median: median(values), p95: percentile(values, 95.0) }
    }
}

/// Judges estimates against the truth (both `camera_from_object`, metres, by frame id). `cameras` may lack
/// frames; those give no error in pixels.
///
/// # Errors
/// [`Error::Invalid`] if there is no truth, or if there are estimates and none is of a frame of the truth.
pub fn evaluate(
    estimates: &[Estimate],
    truth: &BTreeMap<u32, Pose>,
    object: &EvalObject,
    cameras: &BTreeMap<u32, Camera>,
) -> Result<Evaluation> {
    if truth.is_empty() {
        return Err(Error::invalid("truth", "it has no poses", "give the known poses of the sequence"));
    }
    let without_truth = estimates.iter().filter(|e| !truth.contains_key(&e.frame)).count();
    if without_truth > 0 && without_truth == estimates.len() {
        let problem = format!("none of the {without_truth} is of a frame of the truth");
        return Err(Error::invalid("estimates", problem, "give results and truth of the same scene"));
    }
    let frames = frame_errors(estimates, truth, object, cameras);
    Ok(Evaluation { without_truth, jitter: jitter(&frames), ..summary(&frames) })
}

/// As [`evaluate`], and the motion of the end-effector against the robot, [`robot_errors`]. Of a frame with several
/// estimates the first counts.
///
/// # Errors
/// As [`evaluate`], and [`Error::Invalid`] if no tracked frame has a robot pose.
pub fn evaluate_in_cell(
    estimates: &[Estimate],
    truth: &BTreeMap<u32, Pose>,
    object: &EvalObject,
    cameras: &BTreeMap<u32, Camera>,
    cell: &RobotCell,
) -> Result<Evaluation> {
    let evaluation = evaluate(estimates, truth, object, cameras)?;
    let is_tracked = |e: &Estimate, truth: &Pose| {
        let t = errors::translation_error_mm(&e.pose, truth, &object.centre()).norm();
        !errors::is_lost(t, errors::rotation_error_deg(&e.pose, truth).norm(), e.score)
    };
    let mut tracked: BTreeMap<u32, Pose> = BTreeMap::new();
    for e in estimates.iter().filter(|e| truth.get(&e.frame).is_some_and(|t| is_tracked(e, t))) {
        tracked.entry(e.frame).or_insert(e.pose);
    }
    let robot = robot_errors(&tracked.into_iter().collect::<Vec<_>>(), cell);
    if robot.reference_frame.is_none() && evaluation.lost < evaluation.frames {
        let problem = "it has no pose for any tracked frame";
        return Err(Error::invalid("robot", problem, "give scene_robot.json of the same scene"));
    }
    Ok(Evaluation { robot: Some(robot), ..evaluation })
}

/// Everything that does not depend on which frames follow each other.
fn summary(frames: &[FrameErrors]) -> Evaluation {
    let tracked: Vec<PoseErrors> = frames.iter().filter(|f| !f.lost).filter_map(|f| f.errors).collect();
    let translations: Vec<Vector3<f64>> = tracked.iter().map(|e| e.translation_mm).collect();
    let rotations: Vec<Vector3<f64>> = tracked.iter().map(|e| e.rotation_deg).collect();
    let add: Vec<f64> = tracked.iter().map(|e| e.add_mm).collect();
    let corners: Vec<f64> = tracked.iter().filter_map(|e| e.corner_px).collect();
    let (motion_mm, motion_deg): (Vec<f64>, Vec<f64>) = tracked.iter().filter_map(|e| e.motion).unzip();
    let times: Vec<f64> = frames.iter().filter_map(|f| f.time_s).map(|s| s * 1000.0).collect();
    let iterations: Vec<f64> = frames.iter().filter_map(|f| f.iterations).collect();
    let Typical { median: corner_median, p95 } = Typical::of(&corners);
    Evaluation {
        frames: frames.len(),
        lost: frames.iter().filter(|f| f.lost).count(),
        missing: frames.iter().filter(|f| f.errors.is_none()).count(),
        rms_t_mm: rms_length(&translations),
        rms_r_deg: rms_length(&rotations),
        translation_mm: PerAxis::of(&translations),
        rotation_deg: PerAxis::of(&rotations),
        add_mm: Typical::of(&add),
        corner_px: TypicalAndMax { median: corner_median, p95, max: maximum(&corners) },
        relative: Relative { t_mm_median: median(&motion_mm), r_deg_median: median(&motion_deg) },
        ms_per_frame: Typical::of(&times),
        iterations_mean: mean(&iterations),
        ..Evaluation::default()
    }
}

fn rms_length(vectors: &[Vector3<f64>]) -> Option<f64> {
    rms(&vectors.iter().map(Vector3::norm).collect::<Vec<_>>())
}

/// `frames` hold every frame of the truth, so successive entries are successive frames.
fn jitter(frames: &[FrameErrors]) -> Jitter {
    let mut seen = BTreeSet::new();
    let repeated: BTreeSet<u32> = frames.iter().map(|f| f.frame).filter(|&f| !seen.insert(f)).collect();
    let usable = |f: &FrameErrors| f.errors.filter(|_| !f.lost && !repeated.contains(&f.frame));
    let pairs = || frames.windows(2).filter_map(|pair| Some((usable(&pair[0])?, usable(&pair[1])?)));
    let t: Vec<_> = pairs().map(|(a, b)| b.translation_mm - a.translation_mm).collect();
    let r: Vec<_> = pairs().map(|(a, b)| b.rotation_deg - a.rotation_deg).collect();
    let noise = |changes: &[Vector3<f64>]| rms_length(changes).map(|v| v / 2.0_f64.sqrt());
    Jitter { t_mm: noise(&t), r_deg: noise(&r) }
}

#[cfg(test)]
#[path = "report_tests.rs"]
mod tests;
