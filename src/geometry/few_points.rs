//! Pose from as few as four points of any arrangement: from many orientations the nearest minimum, the best of which
//! wins. [`super::pnp`] needs six points unless they lie in a plane.

use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};

use super::pnp::{self, PnpSolution, refine};
use super::rigid_fit::centroid;
use super::{Camera, Pose};
use crate::error::{Error, Result};

/// Orientations per turn about each of three axes.
const STEPS: u32 = 6;
/// Points this narrow (share of their extent) lie on one line.
const NARROW: f64 = 1e-3;

/// Finds the pose from at least four points (object frame, metres) and their pixels in the image of `camera`, lens
/// distortion included.
///
/// # Errors
/// [`Error::Invalid`] for unequal counts, fewer than four points, numbers that are not finite, points on one line,
/// and points that no pose in front of the camera explains.
pub fn solve(camera: &Camera, points: &[Point3<f64>], pixels: &[Point2<f64>]) -> Result<PnpSolution> {
    let refuse = |problem: String, remedy: &str| Err(Error::invalid("pose from points", problem, remedy));
    if points.len() != pixels.len() || points.len() < 4 {
        let problem = format!("{} points and {} pixels", points.len(), pixels.len());
        return refuse(problem, "give four or more of both");
    }
    let numbers = points.iter().flat_map(|p| p.iter()).chain(pixels.iter().flat_map(|p| p.iter()));
    if numbers.into_iter().any(|x| !x.is_finite()) {
        return refuse("a number is not finite".into(), "give finite coordinates");
    }
    let centre = centroid(points);
    let spread = points.iter().map(|p| (p - centre).norm()).fold(0.0, f64::max);
    let across =
        |axis: &Vector3<f64>| points.iter().map(|p| (p - centre).cross(axis).norm()).fold(0.0, f64::max);
    let farthest = points.iter().map(|p| p - centre).max_by(|a, b| a.norm().total_cmp(&b.norm()));
    let axis = farthest.and_then(|a| a.try_normalize(0.0));
    if axis.is_none_or(|axis| across(&axis) <= NARROW * spread) {
        return refuse("the points lie on one line".into(), "click points that span the object");
    }
    if let Ok(solution) = pnp::solve(camera, points, pixels) {
        return Ok(solution);
    }
    let starts = orientations().filter_map(|q| start(camera, points, pixels, &centre, q));
    let fits = starts.filter_map(|start| refine(camera, points, pixels, start));
    let best = fits.min_by(|a, b| a.residuals.norm_squared().total_cmp(&b.residuals.norm_squared()));
    match best {
        Some(fit) if fit.state.is_finite() => Ok(PnpSolution::of(fit.state, camera, points, pixels)),
        _ => refuse(
            "no pose in front of the camera explains them".into(),
            "check the order of the points and their units (millimetres)",
        ),
    }
}

/// Orientations over the whole sphere and all rolls.
fn orientations() -> impl Iterator<Item = UnitQuaternion<f64>> {
    let angle = |k: u32| std::f64::consts::TAU * (f64::from(k) + 0.3) / f64::from(STEPS);
    (0..STEPS).flat_map(move |a| {
        (0..STEPS).flat_map(move |b| {
            (0..STEPS / 2).map(move |c| UnitQuaternion::from_euler_angles(angle(a), angle(c) / 2.0, angle(b)))
        })
    })
}

/// The pose of an orientation whose points have the right middle and size in the image.
fn start(
    camera: &Camera,
    points: &[Point3<f64>],
    pixels: &[Point2<f64>],
    centre: &Point3<f64>,
    rotation: UnitQuaternion<f64>,
) -> Option<Pose> {
    let rays: Vec<Vector3<f64>> = pixels.iter().map(|p| camera.ray(p)).collect::<Option<_>>()?;
    #[expect(clippy::cast_precision_loss, reason = "point counts are small")]
    let middle = rays.iter().sum::<Vector3<f64>>() / rays.len() as f64;
    let seen: f64 = rays.iter().map(|r| (r - middle).norm_squared()).sum();
    let turned = points.iter().map(|p| rotation * (p - centre));
    let size: f64 = turned.map(|p| p.xy().norm_squared()).sum();
    let depth = (size / seen).sqrt();
    let translation = middle * depth - rotation * centre.coords;
    (depth.is_finite() && depth > 0.0).then(|| Pose::from_quaternion(rotation, translation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    const POINTS: [[f64; 3]; 4] =
        [[0.0, 0.0, 0.0], [0.1, 0.0, 0.01], [0.02, 0.08, 0.03], [-0.05, 0.04, 0.06]];

    #[test]
    fn four_points_of_any_arrangement() {
        let camera = Camera::pinhole(800.0, 800.0, 319.5, 239.5, 640, 480);
        let points = POINTS.map(Point3::from);
        for k in 0..12 {
            let a = f64::from(k);
            let truth = Pose::from_params(&Vector6::new(0.03, -0.02, 0.6, 0.5 * a, 0.9 * a.sin(), 0.7 * a));
            let pixels = points.map(|x| camera.project(&truth.transform_point(&x)).expect("in front"));
            let found = solve(&camera, &points, &pixels).expect("a pose");
            assert!(found.rms_px < 1e-6, "{k}: {} px", found.rms_px);
            let off = (found.camera_from_object.translation() - truth.translation()).norm();
            assert!(off < 1e-6, "{k}: {off} m");
        }
    }

    #[test]
    fn what_says_nothing_is_refused() {
        let camera = Camera::pinhole(800.0, 800.0, 319.5, 239.5, 640, 480);
        let line = [0.0, 1.0, 2.0, 3.0].map(|x| Point3::new(0.01 * x, 0.0, 0.0));
        let pixels = [0.0, 1.0, 2.0, 3.0].map(|x| Point2::new(100.0 + 10.0 * x, 50.0));
        let text = solve(&camera, &line, &pixels).unwrap_err().to_string();
        assert!(text.contains("one line"), "{text}");
        let text = solve(&camera, &line[..3], &pixels[..3]).unwrap_err().to_string();
        assert!(text.contains("3 points"), "{text}");
    }
}
