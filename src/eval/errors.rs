//! The errors of one pose: pure functions, poses and points in metres, results in the unit of the name.

use nalgebra::{Point3, Vector3};

use crate::error::Result;
use crate::geometry::distance::rms_px;
use crate::geometry::{Camera, Pose, TriangleMesh};

/// Beyond this distance of the object's centre the object counts as lost, millimetres.
pub const LOST_MM: f64 = 50.0;

/// Beyond this angle the object counts as lost, degrees.
pub const LOST_DEG: f64 = 5.0;

/// What the errors need to know of the object.
#[derive(Debug, Clone, PartialEq)]
pub struct EvalObject {
    vertices: Vec<Point3<f64>>,
    lower: Point3<f64>,
    upper: Point3<f64>,
}

impl EvalObject {
    /// From a mesh in metres.
    ///
    /// # Errors
    /// As [`TriangleMesh::validate`].
    pub fn new(mesh: &TriangleMesh) -> Result<Self> {
        mesh.validate()?;
        let (lower, upper) = mesh.bounds();
        Ok(Self { vertices: mesh.vertices.clone(), lower, upper })
    }

    /// Vertices of the mesh, object frame, metres.
    pub fn vertices(&self) -> &[Point3<f64>] {
        &self.vertices
    }

    /// The reference point: centre of the bounding box, object frame, metres.
    pub fn centre(&self) -> Point3<f64> {
        nalgebra::center(&self.lower, &self.upper)
    }

    /// The eight corners of the bounding box, object frame, metres.
    pub fn corners(&self) -> [Point3<f64>; 8] {
        let (lo, hi) = (&self.lower, &self.upper);
        std::array::from_fn(|k| {
            let pick = |axis: usize| if k >> axis & 1 == 0 { lo[axis] } else { hi[axis] };
            Point3::new(pick(0), pick(1), pick(2))
        })
    }
}

/// Position of the object's reference point, estimate minus truth, camera axes, millimetres. Unlike the
/// difference of the translations it does not depend on where the object frame has its origin.
pub fn translation_error_mm(estimate: &Pose, truth: &Pose, centre: &Point3<f64>) -> Vector3<f64> {
    (estimate.transform_point(centre) - truth.transform_point(centre)) * 1000.0
}

/// Rotation vector of `R_estimate R_truth^T`, camera axes, degrees.
pub fn rotation_error_deg(estimate: &Pose, truth: &Pose) -> Vector3<f64> {
    (estimate.quaternion() * truth.quaternion().inverse()).scaled_axis().map(f64::to_degrees)
}

/// ADD: mean distance of the mesh's vertices at the two poses, millimetres
/// (Hinterstoisser et al., "Model based training, detection and pose estimation", ACCV 2012).
pub fn add_mm(estimate: &Pose, truth: &Pose, vertices: &[Point3<f64>]) -> f64 {
    let distances = vertices.iter().map(|v| translation_error_mm(estimate, truth, v).norm());
    let count = u32::try_from(vertices.len()).unwrap_or(u32::MAX);
    distances.sum::<f64>() / f64::from(count)
}

/// Root mean square distance of the projected corners at the two poses, pixels; `None` if a corner is behind
/// the camera. Lens distortion is left out: corners outside the image may be beyond what its polynomial covers.
pub fn corner_error_px(
    estimate: &Pose,
    truth: &Pose,
    corners: &[Point3<f64>; 8],
    camera: &Camera,
) -> Option<f64> {
    rms_px(camera, corners, estimate, truth)
}

/// Error of a motion between two frames: millimetres of the reference point, degrees. `(first, later)` poses of
/// the estimate and of the truth. The motion is taken in camera axes, `T_later T_first^-1`, so a constant
/// difference between the object frames of estimate and truth cancels.
pub fn motion_error(estimate: (&Pose, &Pose), truth: (&Pose, &Pose), centre: &Point3<f64>) -> (f64, f64) {
    let motion = |(first, later): (&Pose, &Pose)| later.compose(&first.inverse());
    let (estimated, true_motion) = (motion(estimate), motion(truth));
    let start = truth.0.transform_point(centre);
    let translation = translation_error_mm(&estimated, &true_motion, &start).norm();
    (translation, rotation_error_deg(&estimated, &true_motion).norm())
}

/// The rule for lost: a score of 0 or less, an error beyond [`LOST_MM`] or [`LOST_DEG`], or not a number.
pub fn is_lost(translation_mm: f64, rotation_deg: f64, score: f64) -> bool {
    let tracked = score > 0.0 && translation_mm <= LOST_MM && rotation_deg <= LOST_DEG;
    !tracked
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    /// A box of 20 x 40 x 60 mm with its origin at one corner; only its bounds and vertices matter.
    fn block() -> EvalObject {
        let vertices = vec![
            Point3::origin(),
            Point3::new(0.02, 0.0, 0.0),
            Point3::new(0.0, 0.04, 0.0),
            Point3::new(0.0, 0.0, 0.06),
        ];
        EvalObject::new(&TriangleMesh { vertices, triangles: vec![[0, 1, 2], [0, 2, 3]] }).unwrap()
    }

    fn pose(axis: Vector3<f64>, degrees: f64, t: [f64; 3]) -> Pose {
        Pose::new(Rotation3::new(axis * degrees.to_radians()), t.into())
    }

    #[test]
    fn the_block() {
        let block = block();
        assert!((block.centre() - Point3::new(0.01, 0.02, 0.03)).norm() < 1e-15, "{}", block.centre());
        assert_eq!(block.corners()[0], Point3::origin(), "lowest corner first");
        assert_eq!(block.corners()[5], Point3::new(0.02, 0.0, 0.06), "x changes fastest");
    }

    #[test]
    fn translation_is_of_the_centre_in_camera_axes() {
        let (centre, z) = (block().centre(), Vector3::z());
        let truth = pose(z, 90.0, [0.0, 0.0, 0.5]);
        let moved = pose(z, 90.0, [0.001, -0.002, 0.503]);
        let e = translation_error_mm(&moved, &truth, &centre);
        assert!((e - Vector3::new(1.0, -2.0, 3.0)).norm() < 1e-9, "{e}");
        // A turn by 180 deg about the optical axis takes the centre (10, 20) mm to (-10, -20) mm.
        let e = translation_error_mm(&pose(z, 180.0, [0.0; 3]), &Pose::identity(), &centre);
        assert!((e - Vector3::new(-20.0, -40.0, 0.0)).norm() < 1e-9, "{e}");
    }

    #[test]
    fn rotation_is_in_camera_axes() {
        let truth = pose(Vector3::z(), 90.0, [0.0; 3]);
        // Turned by 2 deg about the camera's x: R_est = Rx(2) R_truth.
        let estimate = pose(Vector3::x(), 2.0, [0.0; 3]).compose(&truth);
        let e = rotation_error_deg(&estimate, &truth);
        assert!((e - Vector3::new(2.0, 0.0, 0.0)).norm() < 1e-9, "{e}");
        let back = rotation_error_deg(&truth, &estimate);
        assert!((back + e).norm() < 1e-9, "the sign is estimate minus truth: {back}");
    }

    #[test]
    fn add_averages_distances() {
        let vertices = [Point3::origin(), Point3::new(0.1, 0.0, 0.0)];
        // Half a turn about z leaves the origin and moves the other vertex by 200 mm.
        let add = add_mm(&pose(Vector3::z(), 180.0, [0.0; 3]), &Pose::identity(), &vertices);
        assert!((add - 100.0).abs() < 1e-9, "{add}");
    }

    #[test]
    fn corners_in_pixels() {
        let camera = Camera::pinhole(500.0, 500.0, 320.0, 240.0, 640, 480);
        // A flat object at 0.5 m: 1 mm sideways is 1 px for every corner.
        let corners =
            std::array::from_fn(|k| Point3::new(0.01 * f64::from(u8::try_from(k).unwrap()), 0.0, 0.0));
        let (truth, moved) =
            (pose(Vector3::z(), 0.0, [0.0, 0.0, 0.5]), pose(Vector3::z(), 0.0, [0.001, 0.0, 0.5]));
        let e = corner_error_px(&moved, &truth, &corners, &camera).unwrap();
        assert!((e - 1.0).abs() < 1e-9, "{e}");
        let behind = pose(Vector3::z(), 0.0, [0.0, 0.0, -0.5]);
        assert_eq!(corner_error_px(&behind, &truth, &corners, &camera), None, "behind the camera");
    }

    #[test]
    fn motion_ignores_a_constant_object_frame() {
        let (first, later) =
            (pose(Vector3::x(), 10.0, [0.0, 0.1, 0.5]), pose(Vector3::y(), 25.0, [0.1, 0.0, 0.6]));
        let offset = pose(Vector3::z(), 3.0, [0.004, 0.0, 0.002]);
        let shifted = (first.compose(&offset), later.compose(&offset));
        let (t, r) = motion_error((&shifted.0, &shifted.1), (&first, &later), &block().centre());
        assert!(t < 1e-9 && r < 1e-9, "{t} mm, {r} deg");
        // 2 mm more of depth in the later frame alone.
        let further =
            Pose::from_quaternion(later.quaternion(), later.translation() + Vector3::new(0.0, 0.0, 0.002));
        let (t, r) = motion_error((&first, &further), (&first, &later), &block().centre());
        assert!((t - 2.0).abs() < 1e-9 && r < 1e-9, "{t} mm, {r} deg");
    }

    #[test]
    fn lost() {
        assert!(!is_lost(50.0, 5.0, 0.1), "on the limit");
        assert!(is_lost(50.1, 0.0, 1.0), "too far");
        assert!(is_lost(0.0, 5.1, 1.0), "turned too much");
        assert!(is_lost(0.0, 0.0, 0.0), "given up");
        assert!(
            is_lost(f64::NAN, 0.0, 1.0) && is_lost(0.0, f64::NAN, 1.0) && is_lost(0.0, 0.0, f64::NAN),
            "NaN"
        );
    }
}
