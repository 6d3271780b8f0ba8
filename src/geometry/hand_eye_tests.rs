//! Exact motions give the exact calibration, noise a small error, bad sets a name.

use nalgebra::Rotation3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

fn pose(rotation: [f64; 3], translation: [f64; 3]) -> Pose {
    Pose::new(Rotation3::new(rotation.into()), translation.into())
}

fn truth() -> (Pose, Pose) {
    (pose([0.02, -0.03, 1.57], [0.06, -0.03, -0.04]), pose([3.1, 0.05, 0.02], [0.4, -0.07, 0.09]))
}

/// Robot poses about the object and what the camera sees from them.
fn cell(n: u32, turn: impl Fn(f64) -> [f64; 3]) -> (Vec<Pose>, Vec<Pose>) {
    let (x, y) = truth();
    let effector = |k: u32| {
        let k = f64::from(k);
        pose(turn(k), [0.4 + 0.02 * k.sin(), -0.1 + 0.03 * (2.0 * k).cos(), 0.5 + 0.01 * k])
    };
    let robot: Vec<Pose> = (0..n).map(effector).collect();
    let seen = robot.iter().map(|e| x.inverse().compose(&e.inverse()).compose(&y)).collect();
    (robot, seen)
}

fn wobble(k: f64) -> [f64; 3] {
    [3.0 + 0.3 * k.sin(), 0.3 * (1.7 * k).cos(), 0.4 * (0.6 * k).sin()]
}

fn off(found: &Pose, truth: &Pose) -> (f64, f64) {
    let r = (found.quaternion() * truth.quaternion().inverse()).angle();
    ((found.translation() - truth.translation()).norm(), r)
}

#[test]
fn exact_motions_give_the_exact_transforms() {
    let (robot, seen) = cell(8, wobble);
    let (x, y) = truth();
    for found in [closed_form(&robot, &seen).unwrap(), calibrate(&robot, &seen).unwrap()] {
        for (got, expected) in [(found.effector_from_camera, x), (found.base_from_object, y)] {
            let (t, r) = off(&got, &expected);
            assert!(t < 1e-8 && r < 1e-8, "{t} m, {r} rad");
        }
        assert!(found.residuals.iter().all(|r| r.translation.norm() < 1e-8), "{:?}", found.residuals);
    }
}

/// Uniform noise of 1 mm and 0.1 degrees on the robot: the refinement is no worse than the closed form, and the error
/// goes down with the number of frames.
#[test]
fn noise_averages_out() {
    let error = |n: u32, refined: bool| {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut uniform =
            |size: f64| size * (f64::from(rng.next_u32()) / f64::from(u32::MAX) - 0.5) * 12_f64.sqrt();
        let mut sum = 0.0;
        for _ in 0..20 {
            let (mut robot, seen) = cell(n, wobble);
            for e in &mut robot {
                let r = [uniform(0.0017), uniform(0.0017), uniform(0.0017)];
                *e = e.compose(&pose(r, [uniform(0.001), uniform(0.001), uniform(0.001)]));
            }
            let found = if refined { calibrate(&robot, &seen) } else { closed_form(&robot, &seen) }.unwrap();
            sum += off(&found.effector_from_camera, &truth().0).0 / 20.0;
        }
        sum
    };
    let (few, many, closed) = (error(8, true), error(60, true), error(60, false));
    assert!(few < 4e-3 && many < 0.6 * few, "{few} m with 8 frames, {many} m with 60");
    assert!(many < 1.1 * closed, "{many} m refined, {closed} m in closed form");
}

#[test]
fn bad_sets_are_named() {
    let (robot, seen) = cell(8, wobble);
    let refuse = |robot: &[Pose], seen: &[Pose]| calibrate(robot, seen).expect_err("refused").to_string();
    assert!(refuse(&robot, &seen[1..]).contains("8 robot poses, but 7 object poses"), "counts");
    assert!(refuse(&robot[..3], &seen[..3]).contains("2 motions; give at least 4 poses"), "too few");
    let (flat, flat_seen) = cell(8, |k| [0.0, 0.0, 0.3 * k]);
    let text = refuse(&flat, &flat_seen);
    assert!(text.contains("parallel axes") && text.contains("two axes"), "{text}");
    let (still, still_seen) = cell(8, |_| [3.0, 0.1, 0.0]);
    assert!(refuse(&still, &still_seen).contains("parallel axes"), "no rotation at all");
    let mut bad = seen.clone();
    bad[5] = pose([0.0; 3], [f64::NAN, 0.0, 0.0]);
    assert!(refuse(&robot, &bad).contains("pose 5"), "NaN");
}
