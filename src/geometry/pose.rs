//! Rigid poses (SE(3)), `camera_from_object` unless a name says otherwise. Metres, radians.

use nalgebra::{
    Isometry3, Matrix3, Matrix4, Point3, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6,
};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// How far a rotation matrix read from a file may be from orthonormal before it is refused.
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

/// A rigid transform. The rotation is a unit quaternion, so products stay on SE(3) up to rounding.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    transform: Isometry3<f64>,
}

impl Default for Pose {
    fn default() -> Self {
        Self::identity()
    }
}

impl Pose {
    /// No motion.
    pub fn identity() -> Self {
        Self { transform: Isometry3::identity() }
    }

    /// From a rotation and a translation (metres).
    pub fn new(rotation: Rotation3<f64>, translation: Vector3<f64>) -> Self {
        let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
        Self { transform: Isometry3::from_parts(Translation3::from(translation), rotation) }
    }

    /// From a unit quaternion and a translation (metres).
    pub fn from_quaternion(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self { transform: Isometry3::from_parts(Translation3::from(translation), rotation) }
    }

    /// From a 3x3 matrix that claims to be a rotation and a translation in metres.
    ///
    /// # Errors
    /// [`Error::Invalid`] if a number is not finite or the matrix is not a rotation within 1e-3.
    pub fn from_matrix(rotation: &Matrix3<f64>, translation: Vector3<f64>) -> Result<Self> {
        if rotation.iter().chain(translation.iter()).any(|v| !v.is_finite()) {
            return Err(Error::invalid("pose", "a number is not finite", "write finite numbers"));
        }
        let off = (rotation.transpose() * rotation - Matrix3::identity()).abs().max();
        if off > ORTHONORMAL_TOLERANCE || rotation.determinant() < 0.0 {
            let problem = format!(
                "the rotation is not orthonormal (|R^T R - I| = {off:.2e}, det = {:.4})",
                rotation.determinant()
            );
            return Err(Error::invalid("pose", problem, "give a rotation matrix, row-major, right-handed"));
        }
        let rotation = UnitQuaternion::from_matrix_eps(rotation, 1e-15, 100, UnitQuaternion::identity());
        Ok(Self::from_quaternion(rotation, translation))
    }

    /// Eq. (8): R = Rx(ax) Ry(ay) Rz(az) with `[tx ty tz ax ay az]`, metres and radians.
    pub fn from_params(params: &Vector6<f64>) -> Self {
        Self::new(euler_xyz(params[3], params[4], params[5]), params.fixed_rows::<3>(0).into_owned())
    }

    /// Inverse of [`Self::from_params`]; ay in [-pi/2, pi/2].
    pub fn to_params(&self) -> Vector6<f64> {
        let r = self.rotation();
        let ay = r[(0, 2)].clamp(-1.0, 1.0).asin();
        let ax = (-r[(1, 2)]).atan2(r[(2, 2)]);
        let az = (-r[(0, 1)]).atan2(r[(0, 0)]);
        let t = self.translation();
        Vector6::new(t.x, t.y, t.z, ax, ay, az)
    }

    /// The increment of the tracker: X -> c + R(d_r)(X - c) + d_t, R of eq. (8), about the point `centre`.
    pub fn increment(params: &Vector6<f64>, centre: &Point3<f64>) -> Self {
        let r = euler_xyz(params[3], params[4], params[5]);
        let t = centre.coords - r * centre.coords + params.fixed_rows::<3>(0);
        Self::new(r, t)
    }

    /// Rotation by a rotation vector (axis times angle) and a translation, about the point `centre`.
    pub fn about(rotation_vector: Vector3<f64>, translation: Vector3<f64>, centre: &Point3<f64>) -> Self {
        let r = Rotation3::new(rotation_vector);
        Self::new(r, centre.coords - r * centre.coords + translation)
    }

    /// Product: `a_from_b.compose(&b_from_c)` is `a_from_c`. Re-normalises the rotation.
    pub fn compose(&self, right: &Self) -> Self {
        Self { transform: self.transform * right.transform }.renormalised()
    }

    /// Inverse transform.
    pub fn inverse(&self) -> Self {
        Self { transform: self.transform.inverse() }
    }

    /// The same pose with the quaternion scaled back to unit length.
    pub fn renormalised(mut self) -> Self {
        self.transform.rotation.renormalize();
        self
    }

    /// Rotation as a matrix.
    pub fn rotation(&self) -> Matrix3<f64> {
        self.transform.rotation.to_rotation_matrix().into_inner()
    }

    /// Rotation as a unit quaternion.
    pub fn quaternion(&self) -> UnitQuaternion<f64> {
        self.transform.rotation
    }

    /// Translation, metres.
    pub fn translation(&self) -> Vector3<f64> {
        self.transform.translation.vector
    }

    /// Rotation vector (axis times angle), radians, angle in [0, pi].
    pub fn rotation_vector(&self) -> Vector3<f64> {
        self.transform.rotation.scaled_axis()
    }

    /// Homogeneous 4x4 matrix.
    pub fn matrix(&self) -> Matrix4<f64> {
        self.transform.to_homogeneous()
    }

    /// Transforms a point.
    pub fn transform_point(&self, point: &Point3<f64>) -> Point3<f64> {
        self.transform.transform_point(point)
    }

    /// Rotates a direction.
    pub fn rotate(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        self.transform.rotation * direction
    }

    /// True if every number is finite.
    pub fn is_finite(&self) -> bool {
        self.matrix().iter().all(|v| v.is_finite())
    }
}

/// Rx(ax) Ry(ay) Rz(az), the order of eq. (8).
pub fn euler_xyz(ax: f64, ay: f64, az: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::x_axis(), ax)
        * Rotation3::from_axis_angle(&Vector3::y_axis(), ay)
        * Rotation3::from_axis_angle(&Vector3::z_axis(), az)
}

/// Cross-product matrix: `skew(a) * b == a.cross(&b)`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Rotation matrix of the published test vector, `method.md`-style parameters (0.20, -0.35, 0.15).
    #[test]
    fn euler_order_is_xyz() {
        let r = euler_xyz(0.20, -0.35, 0.15).into_inner();
        #[rustfmt::skip]
        let expected = Matrix3::new(
            0.9288245699, -0.1403781039, -0.3428978075,
            0.0791009921, 0.9792417021, -0.1866245482,
            0.3619778328, 0.1462179090, 0.9206478000,
        );
        assert!((r - expected).abs().max() < 1e-10, "{r}");
    }

    #[test]
    fn increment_turns_about_the_centre() {
        let centre = Point3::new(0.0, 0.0, 565.0);
        let h = Pose::increment(&Vector6::new(12.0, -7.0, 30.0, 0.20, -0.35, 0.15), &centre);
        let expected = Vector3::new(205.7372612123, 98.4428697491, 74.8339930013);
        assert!((h.translation() - expected).norm() < 1e-9, "{}", h.translation());
    }

    #[test]
    fn right_composition_with_the_inverse_increment() {
        let centre = Point3::new(0.0, 0.0, 565.0);
        let h = Pose::increment(&Vector6::new(12.0, -7.0, 30.0, 0.20, -0.35, 0.15), &centre);
        let step = Pose::increment(&Vector6::new(0.5, -0.3, 1.2, 0.01, -0.02, 0.015), &centre);
        #[rustfmt::skip]
        let expected = Matrix4::new(
            0.93749701169, -0.12318205856, -0.32546203084, 195.77089874,
            0.068123380487, 0.98212195574, -0.17548694846, 92.621285116,
            0.34126024981, 0.14234691601, 0.92912797687, 68.799813447,
            0.0, 0.0, 0.0, 1.0,
        );
        let right = h.compose(&step.inverse()).matrix();
        assert!((right - expected).abs().max() < 1e-7, "{right}");
        let left = step.inverse().compose(&h).matrix();
        assert!((left - expected).abs().max() > 1.0, "the left order must differ");
    }

    #[test]
    fn matrices_that_are_no_rotations_are_refused() {
        let zero = Vector3::zeros();
        assert!(Pose::from_matrix(&(Matrix3::identity() * 1.01), zero).is_err(), "scaled");
        assert!(Pose::from_matrix(&-Matrix3::identity(), zero).is_err(), "mirrored");
        assert!(Pose::from_matrix(&Matrix3::from_element(f64::NAN), zero).is_err(), "NaN");
        assert!(Pose::from_matrix(&Matrix3::identity(), zero).is_ok(), "identity");
    }

    proptest! {
        #[test]
        fn params_round_trip(ax in -3.0..3.0f64, ay in -1.5..1.5f64, az in -3.0..3.0f64, tx in -1.0..1.0f64) {
            let params = Vector6::new(tx, 0.2, 0.6, ax, ay, az);
            let again = Pose::from_params(&params).to_params();
            prop_assert!((again - params).norm() < 1e-9, "{again}");
        }

        #[test]
        fn inverse_undoes(ax in -3.0..3.0f64, ay in -1.5..1.5f64, az in -3.0..3.0f64, tx in -1.0..1.0f64) {
            let pose = Pose::from_params(&Vector6::new(tx, 0.2, 0.6, ax, ay, az));
            let identity = pose.compose(&pose.inverse()).matrix();
            prop_assert!((identity - Matrix4::identity()).norm() < 1e-12, "{identity}");
        }

        #[test]
        fn a_matrix_round_trips(ax in -3.0..3.0f64, ay in -1.5..1.5f64, az in -3.0..3.0f64) {
            let pose = Pose::from_params(&Vector6::new(0.1, 0.2, 0.6, ax, ay, az));
            let again = Pose::from_matrix(&pose.rotation(), pose.translation()).expect("a rotation");
            prop_assert!((again.matrix() - pose.matrix()).norm() < 1e-12, "{}", again.matrix());
        }
    }
}
