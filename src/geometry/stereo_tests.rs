//! Exact pairs come back, noise gives the predicted covariance, bad pairs are named.

use nalgebra::Rotation3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::super::Distortion;
use super::*;

fn rig() -> StereoRig {
    let lens = Distortion { k1: -0.2, k2: 0.05, p1: 0.001, p2: -0.0005, k3: 0.0 };
    let left = Camera { distortion: lens, ..Camera::pinhole(800.0, 790.0, 319.5, 239.5, 640, 480) };
    let right = Camera::pinhole(806.0, 806.0, 317.2, 243.1, 640, 480);
    let pose = Pose::new(Rotation3::new(Vector3::new(0.01, 0.3, -0.02)), Vector3::new(-0.2, 0.003, 0.03));
    StereoRig::new(left, right, pose).expect("a rig")
}

fn pair(rig: &StereoRig, x: &Point3<f64>) -> ClickPair {
    ClickPair {
        name: "corner".into(),
        left: rig.left.project(x).expect("in front"),
        right: rig.right.project(&rig.right_from_left.transform_point(x)).expect("in front"),
    }
}

/// Sum of twelve uniform numbers: close enough to a normal one.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.next_u32()).map(|v| f64::from(v) / f64::from(u32::MAX)).sum::<f64>() - 6.0
}

#[test]
fn exact_clicks_give_the_point() {
    let rig = rig();
    for x in [Point3::new(0.05, -0.04, 0.6), Point3::new(-0.1, 0.07, 0.5), Point3::new(0.0, 0.0, 2.0)] {
        let pair = pair(&rig, &x);
        assert!(rig.epipolar_px(&pair).expect("in the lens") < 1e-6, "on its line");
        let point = rig.triangulate(&pair, 0.3).expect("a point");
        assert!((point.position - x).norm() < 1e-8, "{} is not {x}", point.position);
        assert!(point.rms_px < 1e-6, "{}", point.rms_px);
    }
}

/// The mean squared Mahalanobis distance of a three-dimensional error is 3.
#[test]
fn noise_has_the_predicted_covariance() {
    let (rig, x, sigma) = (rig(), Point3::new(0.05, -0.04, 0.6), 0.3);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut sum, mut depth, n) = (0.0, 0.0, 3000);
    let mut predicted = 0.0;
    for _ in 0..n {
        let mut noisy = pair(&rig, &x);
        for click in [&mut noisy.left, &mut noisy.right] {
            *click += Vector2::new(normal(&mut rng), normal(&mut rng)) * sigma;
        }
        let point = rig.triangulate(&noisy, sigma).expect("a point");
        let e = point.position - x;
        sum += e.dot(&(point.covariance.try_inverse().expect("regular") * e));
        depth += e.z * e.z;
        predicted = point.covariance[(2, 2)];
    }
    let (chi, depth) = (sum / f64::from(n), (depth / f64::from(n)).sqrt());
    assert!((chi - 3.0).abs() < 0.15, "mean squared Mahalanobis distance {chi}");
    assert!((depth / predicted.sqrt() - 1.0).abs() < 0.05, "{depth} m, {} m", predicted.sqrt());
}

#[test]
fn the_epipolar_distance_is_in_pixels() {
    let rig = StereoRig::new(
        Camera::pinhole(800.0, 800.0, 320.0, 240.0, 640, 480),
        Camera::pinhole(800.0, 800.0, 320.0, 240.0, 640, 480),
        Pose::new(Rotation3::identity(), Vector3::new(-0.1, 0.0, 0.0)),
    )
    .expect("a rig");
    let mut pair = pair(&rig, &Point3::new(0.05, -0.04, 0.6));
    pair.right += Vector2::new(4.0, 3.0);
    let distance = rig.epipolar_px(&pair).expect("pinholes");
    assert!((distance - 3.0).abs() < 1e-9, "along the line does not count: {distance}");
}

#[test]
fn bad_pairs_are_named() {
    let rig = rig();
    let points = [Point3::new(0.05, -0.04, 0.6), Point3::new(-0.1, 0.07, 0.5), Point3::new(0.0, 0.0, 0.7)];
    let mut pairs: Vec<ClickPair> = points.iter().map(|x| pair(&rig, x)).collect();
    assert!(rig.triangulate_all(&pairs, &ClickOptions::default()).is_ok(), "good pairs");
    pairs[1].name = "bolt".into();
    pairs[1].right.y += 9.0;
    let text = rig.triangulate_all(&pairs, &ClickOptions::default()).expect_err("a bad pair").to_string();
    for word in ["1 of 3", "1 \"bolt\"", "px", "than 2 px"] {
        assert!(text.contains(word), "{word} is missing in: {text}");
    }
    pairs[1].right = Point2::new(f64::NAN, 0.0);
    assert!(rig.triangulate_all(&pairs, &ClickOptions::default()).is_err(), "NaN");
    // Lines of sight that part in front of the cameras meet behind them.
    let mut apart = pair(&rig, &points[0]);
    apart.right.x += 900.0;
    let text = rig.triangulate(&apart, 0.3).expect_err("behind").to_string();
    assert!(text.contains("corner") && text.contains("in front"), "{text}");
    let same = StereoRig::new(rig.left, rig.right, Pose::identity());
    assert!(same.expect_err("no baseline").to_string().contains("same place"), "no baseline");
}
