//! The six coefficients of the camera's motion since the first tracked frame (eqs. 19 and 20), and their errors.

use std::collections::BTreeMap;

use super::record::Coefficients;
use crate::eval::{ErrorStatistics, Estimate};
use crate::geometry::Pose;

/// x y z in millimetres and rx ry rz in degrees (eq. 8) of `camera_now_from_camera_then`.
fn coefficients(then: &Pose, now: &Pose) -> [f64; 6] {
    let p = now.compose(&then.inverse()).to_params();
    std::array::from_fn(|k| if k < 3 { p[k] * 1000.0 } else { p[k].to_degrees() })
}

/// Difference of two sets of coefficients; angles the short way round.
fn difference(a: &[f64; 6], b: &[f64; 6]) -> [f64; 6] {
    std::array::from_fn(|k| {
        let d = a[k] - b[k];
        if k < 3 { d } else { d - 360.0 * (d / 360.0).round() }
    })
}

/// The coefficients of the true motion since frame `first`.
pub(super) fn of_truth(truth: &BTreeMap<u32, Pose>, first: u32) -> Vec<Coefficients> {
    let Some(then) = truth.get(&first) else { return Vec::new() };
    let entry = |(&frame, now): (&u32, &Pose)| Coefficients { frame, values: coefficients(then, now) };
    truth.iter().map(entry).collect()
}

/// The coefficients of the estimated motion, tracked frames only.
pub(super) fn of_estimates(estimates: &[Estimate], lost: &[u32]) -> Vec<Coefficients> {
    let mut tracked = estimates.iter().filter(|e| !lost.contains(&e.frame)).peekable();
    let Some(then) = tracked.peek().map(|e| e.pose) else { return Vec::new() };
    tracked.map(|e| Coefficients { frame: e.frame, values: coefficients(&then, &e.pose) }).collect()
}

/// Average, standard deviation and maximum of the error of each coefficient.
pub(super) fn errors(estimated: &[Coefficients], truth: &BTreeMap<u32, Pose>) -> [ErrorStatistics; 6] {
    let Some(first) = estimated.first() else { return Default::default() };
    let known: BTreeMap<u32, [f64; 6]> =
        of_truth(truth, first.frame).into_iter().map(|c| (c.frame, c.values)).collect();
    let all: Vec<[f64; 6]> =
        estimated.iter().filter_map(|c| Some(difference(&c.values, known.get(&c.frame)?))).collect();
    std::array::from_fn(|k| ErrorStatistics::of(all.iter().map(|d| d[k])))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector6;

    use super::*;

    fn pose(x: f64, rz: f64) -> Pose {
        Pose::from_params(&Vector6::new(x, 0.02, 0.6, 0.1, -0.2, rz))
    }

    fn estimate(frame: u32, pose: Pose) -> Estimate {
        Estimate { frame, pose, score: 1.0, time_s: None, iterations: None }
    }

    #[test]
    fn the_true_motion_has_no_error_and_a_shift_is_found() {
        let truth = BTreeMap::from([(3, pose(0.0, 0.0)), (4, pose(0.01, 0.3)), (5, pose(0.02, 0.6))]);
        let mut estimates: Vec<Estimate> = truth.iter().map(|(&f, &p)| estimate(f, p)).collect();
        let exact = errors(&of_estimates(&estimates, &[]), &truth);
        assert!(exact.iter().all(|e| e.max.expect("three frames") < 1e-9), "{exact:?}");
        let shift = Pose::from_params(&Vector6::new(0.002, 0.0, 0.0, 0.0, 0.0, 0.0));
        estimates[2].pose = shift.compose(&estimates[2].pose);
        let shifted = errors(&of_estimates(&estimates, &[]), &truth);
        assert!((shifted[0].max.expect("three frames") - 2.0).abs() < 1e-9, "{shifted:?}");
        assert!((shifted[0].avg.expect("three frames") - 2.0 / 3.0).abs() < 1e-9, "{shifted:?}");
        let kept = errors(&of_estimates(&estimates, &[5]), &truth);
        assert!(kept[0].max.expect("two frames") < 1e-9, "lost frames are left out: {kept:?}");
    }

    #[test]
    fn a_constant_difference_between_object_frames_cancels() {
        let truth = BTreeMap::from([(0, pose(0.0, 0.0)), (1, pose(0.03, 1.0))]);
        let other_frame = pose(0.1, 0.4);
        let estimates: Vec<Estimate> =
            truth.iter().map(|(&f, p)| estimate(f, p.compose(&other_frame))).collect();
        let errors = errors(&of_estimates(&estimates, &[]), &truth);
        assert!(errors.iter().all(|e| e.max.expect("two frames") < 1e-9), "{errors:?}");
    }

    #[test]
    fn angles_are_compared_the_short_way_round() {
        let (a, b) = ([0.0, 0.0, 0.0, 179.0, 0.0, 0.0], [0.0, 0.0, 0.0, -179.0, 0.0, 0.0]);
        assert!((difference(&a, &b)[3] + 2.0).abs() < 1e-12, "two degrees across the seam");
    }
}
