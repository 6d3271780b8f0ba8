//! How far apart two poses are, in the image.

use nalgebra::Point3;

use super::{Camera, Pose};

/// Root mean square distance of projected points at two poses, pixels; `None` if a point is behind the camera, or if there
/// is none. Lens distortion is left out: points outside the image may be beyond what its polynomial covers.
pub fn rms_px(camera: &Camera, points: &[Point3<f64>], a: &Pose, b: &Pose) -> Option<f64> {
    let pinhole = camera.rectified();
    let mut sum = 0.0;
    for x in points {
        let at = |pose: &Pose| pinhole.project(&pose.transform_point(x));
        sum += (at(a)? - at(b)?).norm_squared();
    }
    #[expect(clippy::cast_precision_loss, reason = "point counts are far below 2^52")]
    let count = points.len() as f64;
    (count > 0.0).then(|| (sum / count).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Vector3};

    #[test]
    fn a_shift_is_seen_by_its_depth() {
        let camera = Camera::pinhole(800.0, 800.0, 320.0, 240.0, 640, 480);
        let at = |x: f64, z: f64| Pose::new(Rotation3::identity(), Vector3::new(x, 0.0, z));
        let points = [Point3::origin(), Point3::new(0.05, 0.02, 0.0)];
        let px = rms_px(&camera, &points, &at(0.0, 0.5), &at(0.01, 0.5));
        assert!(px.is_some_and(|px| (px - 16.0).abs() < 1e-9), "800 * 0.01 / 0.5, not {px:?}");
        assert_eq!(rms_px(&camera, &points, &at(0.0, 0.5), &at(0.0, -0.5)), None, "behind the camera");
        assert_eq!(rms_px(&camera, &[], &at(0.0, 0.5), &at(0.0, 0.5)), None, "no point");
    }
}
