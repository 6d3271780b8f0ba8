//! Exact points give the exact pose in every arrangement; what cannot work is named.

use proptest::prelude::*;

use super::super::Distortion;
use super::*;

fn camera() -> Camera {
    let distortion = Distortion { k1: -0.2, k2: 0.05, p1: 0.001, p2: -0.0005, k3: 0.0 };
    Camera { distortion, ..Camera::pinhole(800.0, 790.0, 319.5, 239.5, 640, 480) }
}

fn pixels(pose: &Pose, points: &[Point3<f64>]) -> Vec<Point2<f64>> {
    points.iter().map(|p| camera().project(&pose.transform_point(p)).expect("in front")).collect()
}

/// The corners of a box without one, off the origin.
fn corners() -> Vec<Point3<f64>> {
    let bit = |k: usize, b: usize| (k >> b & 1) as f64;
    (0..7)
        .map(|k| Point3::new(0.3 + 0.16 * bit(k, 0), -0.1 + 0.07 * bit(k, 1), 0.2 + 0.08 * bit(k, 2)))
        .collect()
}

fn square() -> Vec<Point3<f64>> {
    [[0.0, 0.0], [0.1, 0.0], [0.1, 0.07], [0.0, 0.07]].map(|[x, y]| Point3::new(x, y, 0.05)).to_vec()
}

/// Points whose heights are a small share of their extent, like the relief's.
fn relief() -> Vec<Point3<f64>> {
    let place =
        |k: usize| Point3::new(0.03 * (k % 5) as f64, 0.03 * (k / 5) as f64, 0.004 * (k * k % 5) as f64);
    (0..25).map(place).collect()
}

fn look(points: &[Point3<f64>], turn: Vector3<f64>, t: Vector3<f64>) -> Pose {
    let r = Rotation3::new(turn);
    Pose::new(r, t - r * centroid(points).coords)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn exact_points_give_the_exact_pose(
        x in -1.0..1.0f64, y in -1.0..1.0f64, roll in -3.0..3.0f64, z in 0.4..1.0f64, which in 0..3usize,
    ) {
        let points = [corners(), square(), relief()][which].clone();
        let pose = look(&points, Vector3::new(x, y, 0.0), Vector3::new(0.03 * x, 0.02, z));
        let rolled = look(&points, Vector3::zeros(), Vector3::zeros());
        let rolled = pose.compose(&rolled.inverse()).compose(&Pose::new(
            Rotation3::new(Vector3::new(0.0, 0.0, roll)), Vector3::zeros())).compose(&rolled);
        let found = solve(&camera(), &points, &pixels(&rolled, &points)).unwrap();
        prop_assert!(found.rms_px < 1e-6, "{} px", found.rms_px);
        let off = (found.camera_from_object.matrix() - rolled.matrix()).norm();
        prop_assert!(off < 1e-6, "set {which}: {off}");
    }
}

#[test]
fn one_wrong_pixel_shows_in_its_distance() {
    let points = relief();
    let pose = look(&points, Vector3::new(0.4, 0.3, 0.1), Vector3::new(0.0, 0.0, 0.6));
    let mut pixels = pixels(&pose, &points);
    pixels[7].x += 6.0;
    let found = solve(&camera(), &points, &pixels).unwrap();
    let worst = (0..25).fold(0, |w, k| if found.distances_px[k] > found.distances_px[w] { k } else { w });
    assert_eq!(worst, 7, "{:?}", found.distances_px);
    assert!((found.rms_px - 6.0 / 5.0).abs() < 0.15, "rms over the points: {}", found.rms_px);
}

#[test]
fn what_cannot_work_is_named() {
    let pose = look(&corners(), Vector3::new(0.4, 0.3, 0.1), Vector3::new(0.0, 0.0, 0.6));
    let seen = |points: &[Point3<f64>]| {
        solve(&camera(), points, &pixels(&pose, points)).expect_err("refused").to_string()
    };
    let (six, flat) = (corners(), corners()[..4].to_vec());
    assert!(seen(&flat[..3]).contains("3 points are too few; give at least 6 points, or 4"), "three");
    assert!(seen(&six[..5]).contains("5 points that are not in one plane"), "five with depth");
    let line: Vec<_> = (0..8).map(|k| Point3::new(0.3 + 0.01 * f64::from(k), 0.0, 0.2)).collect();
    assert!(seen(&line).contains("on one line"), "a line");
    // Three of four on one line.
    let mut open = flat.clone();
    open[2] = nalgebra::center(&open[0], &open[1]);
    assert!(seen(&open).contains("leave the pose open"), "three on one line");
    let text = solve(&camera(), &six, &pixels(&pose, &six)[1..]).expect_err("refused").to_string();
    assert!(text.contains("7 points, but 6 pixels"), "{text}");
    let mut bad = pixels(&pose, &six);
    bad[4].x = f64::NAN;
    assert!(solve(&camera(), &six, &bad).expect_err("NaN").to_string().contains("pixel 4"), "a pixel");
    let mut bad = six.clone();
    bad[2].x = f64::INFINITY;
    let text = solve(&camera(), &bad, &pixels(&pose, &six)).expect_err("infinite").to_string();
    assert!(text.contains("point 2"), "{text}");
}
