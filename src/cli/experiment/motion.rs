//! The six coefficients of the end-effector's motion since the first tracked frame (eqs. 19 and 20), and their errors.

use super::record::Coefficients;
use crate::eval::robot::{estimated_motion, robot_errors, robot_motion};
use crate::eval::{ErrorStatistics, Estimate, RobotCell};
use crate::geometry::Pose;

/// x y z in millimetres and rx ry rz in degrees (eq. 8) of a motion.
fn coefficients(frame: u32, motion: &Pose) -> Coefficients {
    let p = motion.to_params();
    let values = std::array::from_fn(|k| if k < 3 { p[k] * 1000.0 } else { p[k].to_degrees() });
    Coefficients { frame, values }
}

/// The coefficients of the robot's own motion since frame `first`.
pub(super) fn of_robot(cell: &RobotCell, first: u32) -> Vec<Coefficients> {
    let Some(then) = cell.base_from_effector.get(&first) else { return Vec::new() };
    cell.base_from_effector
        .iter()
        .map(|(&frame, now)| coefficients(frame, &robot_motion(then, now)))
        .collect()
}

/// The tracked frames.
fn tracked<'a>(estimates: &'a [Estimate], lost: &'a [u32]) -> impl Iterator<Item = (u32, Pose)> + 'a {
    estimates.iter().filter(|e| !lost.contains(&e.frame)).map(|e| (e.frame, e.pose))
}

/// The coefficients of the estimated motion since frame `first`, tracked frames only. Where `first` itself was lost,
/// the motion up to the first tracked frame is the robot's, so that plots start where they belong.
pub(super) fn of_estimates(
    estimates: &[Estimate],
    lost: &[u32],
    cell: &RobotCell,
    first: u32,
) -> Vec<Coefficients> {
    let Some((reference, then)) = tracked(estimates, lost).next() else { return Vec::new() };
    let robot = &cell.base_from_effector;
    let before = match (robot.get(&first), robot.get(&reference)) {
        (Some(a), Some(b)) => robot_motion(a, b),
        _ => Pose::identity(),
    };
    let motion = |now: &Pose| estimated_motion(&cell.effector_from_camera, &then, now).compose(&before);
    tracked(estimates, lost).map(|(frame, now)| coefficients(frame, &motion(&now))).collect()
}

/// Errors of the motion since the first tracked frame: x y z in millimetres, rotations in degrees.
pub(super) fn errors(estimates: &[Estimate], lost: &[u32], cell: &RobotCell) -> [ErrorStatistics; 6] {
    let poses: Vec<(u32, Pose)> = tracked(estimates, lost).collect();
    let e = robot_errors(&poses, cell);
    let (t, r) = (e.translation_mm, e.rotation_deg);
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;

    fn pose(x: f64, rz: f64) -> Pose {
        Pose::from_params(&Vector6::new(x, 0.02, 0.6, 0.1, -0.2, rz))
    }

    /// Estimates without error, and the cell that they belong to.
    fn exact() -> (Vec<Estimate>, RobotCell) {
        let truth = [(3, pose(0.0, 0.0)), (4, pose(0.01, 0.3)), (5, pose(0.02, 0.6))];
        let estimate = |&(frame, pose): &(u32, Pose)| Estimate {
            frame,
            pose,
            score: 1.0,
            time_s: None,
            iterations: None,
        };
        let base_from_effector = truth.iter().map(|(f, p)| (*f, p.inverse())).collect();
        let cell = RobotCell { base_from_effector, effector_from_camera: Pose::identity() };
        (truth.iter().map(estimate).collect(), cell)
    }

    #[test]
    fn a_shift_of_the_camera_is_found_and_lost_frames_are_left_out() {
        let (mut estimates, cell) = exact();
        let clean = errors(&estimates, &[], &cell);
        assert!(clean.iter().all(|e| e.max.expect("three frames") < 1e-9), "{clean:?}");
        let shift = Pose::from_params(&Vector6::new(0.002, 0.0, 0.0, 0.0, 0.0, 0.0));
        estimates[2].pose = shift.compose(&estimates[2].pose);
        let shifted = errors(&estimates, &[], &cell);
        assert!((shifted[0].max.expect("three frames") - 2.0).abs() < 1e-9, "{shifted:?}");
        let kept = errors(&estimates, &[5], &cell);
        assert!(kept[0].max.expect("two frames") < 1e-9, "{kept:?}");
    }

    #[test]
    fn coefficients_follow_the_robot_even_if_the_first_frame_is_lost() {
        let (estimates, cell) = exact();
        let robot = of_robot(&cell, 3);
        assert_eq!(robot[0].values.map(|v| v.abs() < 1e-9), [true; 6], "no motion at first: {robot:?}");
        let estimated = of_estimates(&estimates, &[3], &cell, 3);
        assert_eq!(estimated.len(), 2, "{estimated:?}");
        for (a, b) in estimated.iter().zip(&robot[1..]) {
            let close = a.values.iter().zip(&b.values).all(|(x, y)| (x - y).abs() < 1e-9);
            assert!(a.frame == b.frame && close, "{a:?} {b:?}");
        }
    }
}
