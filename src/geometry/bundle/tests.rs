//! Exact data comes back, noise shrinks as predicted, the prior counts by its covariance, what cannot work is refused.

use nalgebra::Rotation3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::geometry::Distortion;
use crate::geometry::rigid_fit::rigid_fit;

fn camera() -> Camera {
    let distortion = Distortion { k1: -0.2, k2: 0.05, p1: 0.001, p2: -0.0005, k3: 0.0 };
    Camera { distortion, ..Camera::pinhole(800.0, 790.0, 319.5, 239.5, 640, 480) }
}

/// Sum of twelve uniform numbers: close enough to a normal one.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.next_u32()).map(|v| f64::from(v) / f64::from(u32::MAX)).sum::<f64>() - 6.0
}

fn shape() -> Vec<Point3<f64>> {
    let place = |k: usize| {
        Point3::new(0.03 * (k % 7) as f64, 0.03 * (k / 7) as f64, 0.3 + 0.004 * (k * k % 5) as f64)
    };
    (0..49).map(place).collect()
}

/// Views from all around, tilted by 0.5 rad.
fn views(count: usize) -> Vec<Pose> {
    let middle = centroid(&shape());
    let view = |k: usize| {
        let around = k as f64 * 2.399;
        let turn = Rotation3::new(Vector3::new(0.5 * around.cos(), 0.5 * around.sin(), 0.1));
        Pose::new(turn, Vector3::new(0.0, 0.0, 0.6) - turn * middle.coords)
    };
    (0..count).map(view).collect()
}

/// Truth seen with noise (pixels); poses start a little off.
fn sightings(poses: &[Pose], sigma: f64, rng: &mut ChaCha8Rng) -> Vec<Sighting> {
    let off = Pose::new(Rotation3::new(Vector3::new(0.01, -0.02, 0.01)), Vector3::new(0.003, 0.002, -0.01));
    let mut noise = || Vector3::new(normal(rng), normal(rng), 0.0).xy() * sigma;
    let mut see = |pose: &Pose| Sighting {
        camera: camera(),
        camera_from_object: off.compose(pose),
        marks: shape()
            .iter()
            .map(|x| camera().project(&pose.transform_point(x)).expect("in front") + noise())
            .map(|pixel| Mark::new(pixel, 0.3))
            .collect(),
    };
    poses.iter().map(&mut see).collect()
}

/// The same sightings, believed by another standard deviation.
fn with_noise(seen: &[Sighting], sigma: f64) -> Vec<Sighting> {
    let marks = |s: &Sighting| s.marks.iter().map(|m| Mark::new(m.pixel, sigma)).collect();
    seen.iter().map(|s| Sighting { marks: marks(s), ..s.clone() }).collect()
}

/// Priors drawn from their covariance: 0.15 mm across, 0.9 mm deep.
fn priors(rng: &mut ChaCha8Rng) -> Vec<Prior> {
    let sigma = Vector3::new(1.5e-4, 1.5e-4, 9e-4);
    let covariance = Matrix3::from_diagonal(&sigma.component_mul(&sigma));
    let mut draw = |x: Point3<f64>| {
        let noise = Vector3::new(normal(rng), normal(rng), normal(rng));
        Prior { position: x + noise.component_mul(&sigma), covariance }
    };
    shape().into_iter().map(&mut draw).collect()
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|v| v * v).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn exact_data_gives_the_truth() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let exact: Vec<Prior> = shape()
        .into_iter()
        .map(|position| Prior { position, covariance: Matrix3::identity() * 1e-6 })
        .collect();
    let poses = views(5);
    let bundle = refine(&exact, &sightings(&poses, 0.0, &mut rng)).expect("a bundle");
    for (found, known) in bundle.points.iter().zip(shape()) {
        assert!((found.position - known).norm() < 1e-8, "{} is not {known}", found.position);
    }
    for (found, known) in bundle.poses.iter().zip(&poses) {
        let off = (found.matrix() - known.matrix()).norm();
        assert!(off < 1e-7, "{off}");
    }
}

/// Depth noise of 0.9 mm shrinks to what sixteen tilted views leave, and the covariance says so. The shape is compared
/// after a rigid fit: the frame is the prior's.
#[test]
fn noise_shrinks_as_predicted() {
    let (mut before, mut after, mut predicted) = (Vec::new(), Vec::new(), Vec::new());
    let mut distance = 0.0;
    for seed in 0..8 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let prior = priors(&mut rng);
        let seen = sightings(&views(16), 0.3, &mut rng);
        let bundle = refine(&prior, &seen).expect("a bundle");
        let depths = |points: &[Prior]| -> Vec<f64> {
            let points: Vec<_> = points.iter().map(|p| p.position).collect();
            let (fit, _) = rigid_fit(&points, &shape()).expect("a fit");
            points.iter().zip(shape()).map(|(a, b)| fit.transform_point(a).z - b.z).collect()
        };
        before.extend(depths(&prior));
        after.extend(depths(&bundle.points));
        predicted.extend(bundle.points.iter().map(|p| p.covariance[(2, 2)].sqrt()));
        for (point, known) in bundle.points.iter().zip(shape()) {
            let inverse = point.covariance.try_inverse().expect("a covariance");
            let off = point.position - known;
            distance += (off.transpose() * inverse * off)[(0, 0)] / (8.0 * 49.0);
        }
    }
    let (before, after) = (rms(before.into_iter()), rms(after.into_iter()));
    let predicted = rms(predicted.into_iter());
    assert!(before > 7e-4 && after < before / 4.0, "{before} to {after} m");
    assert!(after < 1.1 * predicted, "{after} m, predicted {predicted}");
    assert!((distance - 3.0).abs() < 0.7, "mean squared Mahalanobis distance {distance}");
}

/// A point known exactly stays; the shift of a whole frame, which no image sees, is that of the prior.
#[test]
fn the_prior_counts_by_its_covariance() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut prior = priors(&mut rng);
    prior[7].covariance = Matrix3::zeros();
    let seen = sightings(&views(6), 0.3, &mut rng);
    let found = refine(&prior, &seen).expect("a bundle");
    assert_eq!(found.points[7], prior[7], "exact");
    let shift = Vector3::new(0.2, -0.1, 0.4);
    let moved: Vec<Prior> = prior.iter().map(|p| Prior { position: p.position + shift, ..*p }).collect();
    let back = Pose::new(Rotation3::identity(), -shift);
    let seen_there: Vec<Sighting> = seen
        .iter()
        .map(|s| Sighting { camera_from_object: s.camera_from_object.compose(&back), ..s.clone() })
        .collect();
    let there = refine(&moved, &seen_there).expect("a bundle");
    for (a, b) in found.points.iter().zip(&there.points) {
        assert!((a.position + shift - b.position).norm() < 1e-7, "the frame is the prior's");
    }
    let far = |sigma: f64| {
        let points = refine(&prior, &with_noise(&seen, sigma)).expect("a bundle").points;
        rms(points.iter().zip(&prior).map(|(a, b)| (a.position - b.position).norm()))
    };
    let (trusted, doubted) = (far(0.03), far(300.0));
    assert!(doubted < 1e-2 * trusted, "pixels of no worth leave the points: {doubted} and {trusted} m");
}

#[test]
fn what_cannot_work_is_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (prior, seen) = (priors(&mut rng), sightings(&views(2), 0.3, &mut rng));
    let text = |prior: &[Prior], seen: &[Sighting]| refine(prior, seen).expect_err("refused").to_string();
    assert!(text(&prior, &[]).contains("0 images"), "no image");
    assert!(text(&prior[..3], &seen).contains("3 points"), "few points");
    assert!(text(&prior[..40], &seen).contains("40 points, 49 marks"), "unequal counts");
    assert!(text(&prior, &with_noise(&seen, 0.0)).contains("image 0"), "no noise");
    let mut bad = prior.clone();
    bad[3].covariance[(0, 0)] = -1e-6;
    assert!(text(&bad, &seen).contains("covariance"), "a negative variance");
    let mut bad = seen.clone();
    bad[1].marks[0].pixel.x = f64::NAN;
    assert!(text(&prior, &bad).contains("image 1"), "NaN");
    bad[1] = seen[1].clone();
    bad[1].camera_from_object = Pose::identity()
        .inverse()
        .compose(&Pose::new(Rotation3::new(Vector3::new(3.0, 0.0, 0.0)), Vector3::zeros()));
    assert!(text(&prior, &bad).contains("behind"), "behind the camera");
    let line: Vec<Prior> = (0..49)
        .map(|k| Prior {
            position: Point3::new(0.004 * f64::from(k), 0.0, 0.3),
            covariance: Matrix3::zeros(),
        })
        .collect();
    assert!(text(&line, &seen).contains("open"), "a line can be turned about itself");
}
