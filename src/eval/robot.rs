//! The paper's error measure: motion of the end-effector since a first frame, by the tracker and by the robot.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::errors;
use super::statistics::{PerAxis, rms};
use crate::geometry::Pose;

/// What the robot knows.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotCell {
    /// End-effector in the base by frame, metres, from the direct kinematics.
    pub base_from_effector: BTreeMap<u32, Pose>,
    /// The hand-eye transform, metres.
    pub effector_from_camera: Pose,
}

/// Errors of the end-effector's motion per degree of freedom, eqs. (19) and (20), over the tracked frames after the
/// first. The axes are those of the end-effector.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct RobotErrors {
    /// The frame that motions are relative to: the first that is tracked and has a robot pose.
    pub reference_frame: Option<u32>,
    /// Number of motions judged.
    pub frames: usize,
    /// Root mean square length of the translation error, millimetres.
    pub rms_t_mm: Option<f64>,
    /// Root mean square angle of the rotation error, degrees.
    pub rms_r_deg: Option<f64>,
    /// Translation error per axis, millimetres.
    pub translation_mm: PerAxis,
    /// Rotation error per axis, degrees.
    pub rotation_deg: PerAxis,
}

/// Eq. (19): motion of the end-effector by the robot, `later_from_first`.
pub fn robot_motion(base_from_first: &Pose, base_from_later: &Pose) -> Pose {
    base_from_later.inverse().compose(base_from_first)
}

/// Eq. (20): the same motion by the poses of a stationary object, `camera_from_object` in both frames.
pub fn estimated_motion(effector_from_camera: &Pose, first: &Pose, later: &Pose) -> Pose {
    let effector_from_object = |pose: &Pose| effector_from_camera.compose(pose);
    effector_from_object(later).compose(&effector_from_object(first).inverse())
}

/// Judges poses (`camera_from_object`, by ascending frame) of tracked frames; frames without a robot pose are left out.
pub fn robot_errors(tracked: &[(u32, Pose)], cell: &RobotCell) -> RobotErrors {
    let known: Vec<(u32, &Pose, &Pose)> = tracked
        .iter()
        .filter_map(|(frame, pose)| Some((*frame, pose, cell.base_from_effector.get(frame)?)))
        .collect();
    let Some(&(reference, first, base_from_first)) = known.first() else { return RobotErrors::default() };
    let (mut translations, mut rotations) = (Vec::new(), Vec::new());
    for (_, pose, base_from_later) in known.iter().filter(|(frame, ..)| *frame != reference) {
        let estimate = estimated_motion(&cell.effector_from_camera, first, pose);
        let robot = robot_motion(base_from_first, base_from_later);
        translations.push((estimate.translation() - robot.translation()) * 1000.0);
        rotations.push(errors::rotation_error_deg(&estimate, &robot));
    }
    let length = |v: &[Vector3<f64>]| rms(&v.iter().map(Vector3::norm).collect::<Vec<_>>());
    RobotErrors {
        reference_frame: Some(reference),
        frames: translations.len(),
        rms_t_mm: length(&translations),
        rms_r_deg: length(&rotations),
        translation_mm: PerAxis::of(&translations),
        rotation_deg: PerAxis::of(&rotations),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    fn pose(r: [f64; 3], t: [f64; 3]) -> Pose {
        Pose::new(Rotation3::new(r.into()), t.into())
    }

    fn cell() -> (RobotCell, Vec<(u32, Pose)>) {
        let x = pose([0.1, -0.2, 1.5], [0.05, -0.03, -0.04]);
        let object = pose([3.0, 0.1, 0.0], [0.4, 0.0, 0.1]);
        let effector = |k: u32| pose([3.0 + 0.1 * f64::from(k), 0.2, 0.1], [0.4, 0.02 * f64::from(k), 0.6]);
        let base_from_effector: BTreeMap<u32, Pose> = (0..4).map(|k| (k, effector(k))).collect();
        let see = |e: &Pose| x.inverse().compose(&e.inverse()).compose(&object);
        let tracked = base_from_effector.iter().map(|(&k, e)| (k, see(e))).collect();
        (RobotCell { base_from_effector, effector_from_camera: x }, tracked)
    }

    #[test]
    fn perfect_poses_have_no_error_and_missing_frames_are_left_out() {
        let (mut cell, tracked) = cell();
        let errors = robot_errors(&tracked, &cell);
        assert_eq!((errors.reference_frame, errors.frames), (Some(0), 3), "{errors:?}");
        assert!(errors.rms_t_mm.unwrap() < 1e-9 && errors.rms_r_deg.unwrap() < 1e-9, "{errors:?}");
        cell.base_from_effector.remove(&0);
        assert_eq!(robot_errors(&tracked, &cell).reference_frame, Some(1), "no robot pose for frame 0");
        assert_eq!(robot_errors(&[], &cell), RobotErrors::default(), "nothing tracked");
    }

    /// A wrong pose in one frame shows at the end-effector: the object's 2 degrees become millimetres there.
    #[test]
    fn errors_are_of_the_effector() {
        let (cell, mut tracked) = cell();
        let wrong = pose([0.0, 2_f64.to_radians(), 0.0], [0.0; 3]);
        tracked[2].1 = tracked[2].1.compose(&wrong);
        let errors = robot_errors(&tracked, &cell);
        let rotation = errors.rms_r_deg.unwrap() * 3_f64.sqrt();
        assert!((rotation - 2.0).abs() < 1e-9, "one of three motions: {rotation}");
        // The end-effector of frame 0 as the object sees it moves on a circle about the object's y axis.
        let at = tracked[0].1.inverse().compose(&cell.effector_from_camera.inverse()).translation();
        let lever = (at.x * at.x + at.z * at.z).sqrt() * 1000.0;
        let t = errors.rms_t_mm.unwrap() * 3_f64.sqrt();
        assert!((t - 2.0 * 1_f64.to_radians().sin() * lever).abs() < 1e-6, "{t} mm");
    }

    /// Eq. (20) keeps no object frame: a constant difference between those of tracker and truth cancels.
    #[test]
    fn the_object_frame_does_not_matter() {
        let (cell, tracked) = cell();
        let other = pose([0.3, 0.0, 0.2], [0.02, 0.01, 0.0]);
        let shifted: Vec<(u32, Pose)> = tracked.iter().map(|(k, p)| (*k, p.compose(&other))).collect();
        assert!(robot_errors(&shifted, &cell).rms_t_mm.unwrap() < 1e-9, "another object frame");
    }
}
