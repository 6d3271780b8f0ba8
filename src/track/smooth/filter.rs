//! Kalman filter of a pose that moves on with constant velocity.
//!
//! Errors are those of the centre, the rotation (on the left), and their velocities, all in the axes of the camera:
//! `[dc dtheta dv domega]`, metres, radians, seconds.

use nalgebra::{Matrix3, Matrix6, Point3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};

use crate::geometry::Pose;
use crate::geometry::pose::skew;

pub(super) type Error12 = SVector<f64, 12>;
pub(super) type Matrix12 = SMatrix<f64, 12, 12>;

/// Where the object is, how it moves, and how certain that is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Belief {
    /// Of the object, camera frame.
    pub(super) centre: Point3<f64>,
    pub(super) rotation: UnitQuaternion<f64>,
    /// Of the centre, and of the rotation, camera frame.
    pub(super) velocity: Vector3<f64>,
    pub(super) turning: Vector3<f64>,
    pub(super) covariance: Matrix12,
}

/// A pose and its covariance `[centre, rotation]`, axes of the camera.
#[derive(Debug, Clone)]
pub(super) struct Measurement {
    pub(super) centre: Point3<f64>,
    pub(super) rotation: UnitQuaternion<f64>,
    pub(super) covariance: Matrix6<f64>,
}

impl Measurement {
    /// From a pose and its covariance in object axes about `centre`.
    pub(super) fn new(pose: &Pose, covariance: &Matrix6<f64>, centre: &Point3<f64>) -> Self {
        let turn = both(&pose.rotation());
        let covariance = turn * covariance * turn.transpose();
        Self { centre: pose.transform_point(centre), rotation: pose.quaternion(), covariance }
    }
}

impl Belief {
    /// At a first measurement; nothing is known of the motion but its scale.
    pub(super) fn first(seen: &Measurement, speed: f64, radius: f64) -> Self {
        let mut covariance = Matrix12::zeros();
        covariance.fixed_view_mut::<6, 6>(0, 0).copy_from(&seen.covariance);
        for k in 0..3 {
            covariance[(6 + k, 6 + k)] = speed * speed;
            covariance[(9 + k, 9 + k)] = (speed / radius).powi(2);
        }
        let rest = Vector3::zeros();
        Self { centre: seen.centre, rotation: seen.rotation, velocity: rest, turning: rest, covariance }
    }

    /// After `dt` seconds, and the transition of the error. `density` is that of the white acceleration of the centre, m^2/s^3; that
    /// of the rotation moves a point `radius` away as much.
    pub(super) fn predicted(&self, dt: f64, density: f64, radius: f64) -> (Self, Matrix12) {
        let step = self.turning * dt;
        let turn = UnitQuaternion::from_scaled_axis(step);
        let mut f = Matrix12::identity();
        f.fixed_view_mut::<3, 3>(0, 6).fill_diagonal(dt);
        f.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.to_rotation_matrix().matrix());
        // Left Jacobian of the rotation, to first order.
        let jacobian = (Matrix3::identity() + skew(&step) / 2.0) * dt;
        f.fixed_view_mut::<3, 3>(3, 9).copy_from(&jacobian);
        let mut covariance = f * self.covariance * f.transpose();
        for k in 0..6 {
            let s = if k < 3 { density } else { density / (radius * radius) };
            covariance[(k, k)] += s * dt.powi(3) / 3.0;
            covariance[(k, k + 6)] += s * dt * dt / 2.0;
            covariance[(k + 6, k)] += s * dt * dt / 2.0;
            covariance[(k + 6, k + 6)] += s * dt;
        }
        let rotation = UnitQuaternion::new_normalize((turn * self.rotation).into_inner());
        (Self { centre: self.centre + self.velocity * dt, rotation, covariance, ..self.clone() }, f)
    }

    /// With a measurement, and the squared innovation in units of its covariance (6 expected); `None` if that cannot be
    /// inverted.
    pub(super) fn updated(&self, seen: &Measurement) -> Option<(Self, f64)> {
        let turn = (seen.rotation * self.rotation.inverse()).scaled_axis();
        let moved = seen.centre - self.centre;
        let innovation = Vector6::new(moved.x, moved.y, moved.z, turn.x, turn.y, turn.z);
        let of_pose = self.covariance.fixed_columns::<6>(0);
        let spread = self.covariance.fixed_view::<6, 6>(0, 0) + seen.covariance;
        let inverse = scaled_inverse(&spread)?;
        let gain = of_pose * inverse;
        let mut next = self.moved_by(&(gain * innovation));
        // Joseph's form stays positive under rounding.
        let mut keep = Matrix12::identity();
        keep.fixed_columns_mut::<6>(0).zip_apply(&gain, |k, g| *k -= g);
        next.covariance =
            keep * self.covariance * keep.transpose() + gain * seen.covariance * gain.transpose();
        Some((next, (innovation.transpose() * inverse * innovation)[0]))
    }

    /// With what later frames say (Rauch, Tung and Striebel): `predicted` is what followed from this with `transition`, `later` what it
    /// became. `None` if the prediction's covariance cannot be inverted.
    pub(super) fn hindsight(&self, transition: &Matrix12, predicted: &Self, later: &Self) -> Option<Self> {
        let gain = self.covariance * transition.transpose() * scaled_inverse(&predicted.covariance)?;
        let mut better = self.moved_by(&(gain * later.difference(predicted)));
        better.covariance += gain * (later.covariance - predicted.covariance) * gain.transpose();
        Some(better)
    }

    fn difference(&self, from: &Self) -> Error12 {
        let turn = (self.rotation * from.rotation.inverse()).scaled_axis();
        let parts =
            [self.centre - from.centre, turn, self.velocity - from.velocity, self.turning - from.turning];
        Error12::from_iterator(parts.iter().flat_map(|part| part.iter().copied()))
    }

    fn moved_by(&self, error: &Error12) -> Self {
        let part = |k: usize| Vector3::new(error[k], error[k + 1], error[k + 2]);
        let turn = UnitQuaternion::from_scaled_axis(part(3));
        Self {
            centre: self.centre + part(0),
            rotation: UnitQuaternion::new_normalize((turn * self.rotation).into_inner()),
            velocity: self.velocity + part(6),
            turning: self.turning + part(9),
            covariance: self.covariance,
        }
    }

    /// The pose of an object whose centre of rotation is `centre`, object frame.
    pub(super) fn pose(&self, centre: &Point3<f64>) -> Pose {
        Pose::from_quaternion(self.rotation, self.centre.coords - self.rotation * centre.coords)
    }

    /// Covariance of the pose in object axes about the centre.
    pub(super) fn pose_covariance(&self) -> Matrix6<f64> {
        let turn = both(&self.rotation.inverse().to_rotation_matrix().into_inner());
        turn * self.covariance.fixed_view::<6, 6>(0, 0) * turn.transpose()
    }
}

/// The rotation of translations and of rotation vectors.
fn both(rotation: &Matrix3<f64>) -> Matrix6<f64> {
    let mut both = Matrix6::zeros();
    both.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation);
    both.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation);
    both
}

/// Inverse of a covariance whose entries have units of their own: variances are scaled to 1 before.
fn scaled_inverse<const N: usize>(covariance: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, N, N>> {
    let scale = covariance.diagonal().map(|v| 1.0 / v.sqrt());
    let scale = SMatrix::<f64, N, N>::from_diagonal(&scale);
    let inverse = (scale * covariance * scale).cholesky()?.inverse();
    Some(scale * inverse * scale)
}
