//! Simulated motions with exact truth: is noise taken out, at rest and in motion, is the covariance true, and is a sudden motion
//! followed at once?

use nalgebra::{Matrix6, Point3, UnitQuaternion, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::align::PoseEstimate;
use crate::track::Status;

const FPS: f64 = 30.0;
const CENTRE: Point3<f64> = Point3::new(0.02, -0.01, 0.03);
const RADIUS: f64 = 0.1;
/// Standard deviations of the measured poses in object axes: metres, radians.
const SIGMA: [f64; 6] = [1e-4, 1e-4, 4e-4, 2e-3, 2e-3, 5e-4];

fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random_range(-0.5..0.5)).sum()
}

fn still(_: f64) -> Pose {
    swinging(0.0)
}

/// A hand that moves the object to and fro by 12 cm and 40 degrees.
fn swinging(t: f64) -> Pose {
    let turn = Vector3::new(0.3, 0.7 * (1.7 * t).sin(), 0.4 * (1.1 * t).cos());
    let r = UnitQuaternion::from_scaled_axis(turn);
    let c = Vector3::new(0.12 * (2.0 * t).sin(), 0.05 * (1.3 * t).cos(), 0.6 + 0.1 * (0.9 * t).sin());
    Pose::from_quaternion(r, c - r * CENTRE.coords)
}

/// At rest for 4 seconds, then moving on at 0.3 m/s at once.
fn pushed(t: f64) -> Pose {
    let shift = Vector3::x() * 0.3 * (t - 4.0).max(0.0);
    Pose::new(nalgebra::Rotation3::identity(), shift).compose(&still(t))
}

fn covariance() -> Matrix6<f64> {
    Matrix6::from_diagonal(&Vector6::from(SIGMA.map(|s| s * s)))
}

fn seen(pose: &Pose, rng: &mut ChaCha8Rng) -> Tracked {
    let error = Vector6::from(SIGMA.map(|s| s * gauss(rng)));
    let camera_from_object = pose.compose(&Pose::increment(&error, &CENTRE));
    let estimate = PoseEstimate { camera_from_object, covariance: covariance(), ..PoseEstimate::default() };
    Tracked { status: Status::Tracking, estimate, ..Tracked::default() }
}

/// Error in object axes about the centre.
fn error(truth: &Pose, pose: &Pose) -> Vector6<f64> {
    let d = truth.inverse().compose(pose);
    let (t, r) = (d.transform_point(&CENTRE) - CENTRE, d.rotation_vector());
    Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z)
}

/// Mean squared error of raw and smoothed poses in units of the raw covariance (6 expected of raw ones), and of the smoothed
/// ones in units of theirs, after the first second.
fn figures(motion: fn(f64) -> Pose, lag: usize, frames: u32) -> [f64; 3] {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut smoother = Smoother::about(CENTRE, RADIUS, lag);
    let raw_information = covariance().try_inverse().expect("a covariance");
    let (mut sums, mut count) = ([0.0; 3], [0.0; 2]);
    let mut out = Vec::new();
    for k in 0..frames {
        let t = f64::from(k) / FPS;
        let tracked = seen(&motion(t), &mut rng);
        let e = error(&motion(t), &tracked.estimate.camera_from_object);
        if t > 1.0 {
            sums[0] += (e.transpose() * raw_information * e)[0];
            count[0] += 1.0;
        }
        out.extend(smoother.push(t, &tracked).expect("in order"));
    }
    out.extend(smoother.finish());
    assert_eq!(out.len(), frames as usize, "every frame once");
    for (k, smoothed) in out.iter().enumerate() {
        assert_eq!(smoothed.time_s, k as f64 / FPS, "in order");
        if smoothed.time_s > 1.0 {
            let e = error(&motion(smoothed.time_s), &smoothed.camera_from_object);
            let own = smoothed.covariance.try_inverse().expect("a covariance");
            sums[1] += (e.transpose() * raw_information * e)[0];
            sums[2] += (e.transpose() * own * e)[0];
            count[1] += 1.0;
        }
    }
    [sums[0] / count[0], sums[1] / count[1], sums[2] / count[1]]
}

/// Name, motion, lag, and what may be left of the squared noise.
type Case = (&'static str, fn(f64) -> Pose, usize, f64);

#[test]
fn noise_is_taken_out_at_rest_and_in_motion() {
    let cases: [Case; 6] = [
        ("at rest", still, 0, 0.15),
        ("at rest", still, 3, 0.09),
        ("swinging", swinging, 0, 1.0),
        ("swinging", swinging, 3, 0.5),
        ("pushed", pushed, 0, 0.2),
        ("pushed", pushed, 3, 0.12),
    ];
    for (name, motion, lag, most) in cases {
        let [raw, smoothed, own] = figures(motion, lag, 3000);
        assert!((5.7..6.3).contains(&raw), "the noise is not what was asked for: {raw}");
        assert!(smoothed < most * raw, "{name}, lag {lag}: {smoothed} of {raw} is left");
        assert!((4.0..7.0).contains(&own), "{name}, lag {lag}: {own} in its own covariance, 6 expected");
    }
}

/// Distance of the centre, metres.
fn distance(a: &Pose, b: &Pose) -> f64 {
    (a.transform_point(&CENTRE) - b.transform_point(&CENTRE)).norm()
}

/// No frame is farther off than a raw one may be; the mean of the last frames is by ten times as much.
#[test]
fn a_sudden_motion_is_followed_at_once() {
    for lag in [0, 3] {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut smoother = Smoother::about(CENTRE, RADIUS, lag);
        let (mut worst, mut worst_raw, mut worst_mean) = (0.0, 0.0, 0.0);
        let mut last: VecDeque<Vector3<f64>> = VecDeque::new();
        for k in 0..240 {
            let t = f64::from(k) / FPS;
            let tracked = seen(&pushed(t), &mut rng);
            let raw = tracked.estimate.camera_from_object;
            last.push_back(raw.transform_point(&CENTRE).coords);
            last.truncate(7);
            let mean = last.iter().sum::<Vector3<f64>>() / last.len() as f64;
            if last.len() == 7 {
                last.pop_front();
            }
            worst_raw = f64::max(worst_raw, distance(&pushed(t), &raw));
            worst_mean = f64::max(worst_mean, (mean - pushed(t).transform_point(&CENTRE).coords).norm());
            for s in smoother.push(t, &tracked).expect("in order") {
                worst = f64::max(worst, distance(&pushed(s.time_s), &s.camera_from_object));
            }
        }
        assert!(worst < worst_raw, "{worst} m off, raw poses at most {worst_raw}");
        assert!(worst_mean > 10.0 * worst_raw, "a mean does as well: {worst_mean}");
    }
}

#[test]
fn a_gap_ends_what_waits_and_times_must_grow() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut smoother = Smoother::about(CENTRE, RADIUS, 2);
    let mut push = |k: u32, tracked: &Tracked| smoother.push(f64::from(k) / FPS, tracked);
    let pose = |t: f64, rng: &mut ChaCha8Rng| seen(&swinging(t), rng);
    assert!(push(0, &pose(0.0, &mut rng)).expect("the first").is_empty(), "two more are waited for");
    assert!(push(1, &pose(0.03, &mut rng)).expect("in order").is_empty());
    let ended = push(2, &Tracked::default()).expect("in order");
    assert_eq!(ended.iter().map(|s| s.time_s).collect::<Vec<_>>(), [0.0, 1.0 / FPS], "all that waited");
    // Far away after the gap: no motion is made up between.
    let far = pose(1.5, &mut rng);
    assert!(push(3, &far).expect("in order").is_empty());
    let refused = push(3, &far).expect_err("the same time again");
    assert!(refused.to_string().contains("order"), "{refused}");
    assert!(push(4, &far).expect("usable after an error").is_empty());
    let last = smoother.finish();
    assert_eq!(last.len(), 2, "{last:?}");
    assert!(distance(&last[0].camera_from_object, &far.estimate.camera_from_object) < 1e-3, "{last:?}");
    assert!(smoother.finish().is_empty(), "given once");
}
