//! Covariance of the estimated pose.

use nalgebra::{DMatrix, Matrix3, Matrix6, Point3};

use super::normal_equations::NormalEquations;
use crate::geometry::Pose;
use crate::geometry::pose::skew;

/// Inverse of the hessian's pose block after the appearance parameters, times the residual variance; zero where the
/// pose is not determined. Object axes about the centre of rotation, `[tx ty tz rx ry rz]`, metres and radians.
pub(super) fn covariance(equations: &NormalEquations) -> Matrix6<f64> {
    // Columns differ by orders of magnitude (metres, radians): normalise before inverting.
    let scale = equations.hessian.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 0.0 });
    let scale = DMatrix::from_diagonal(&scale);
    let normalised = &scale * &equations.hessian * &scale;
    normalised.cholesky().map_or_else(Matrix6::zeros, |c| {
        let inverse = &scale * c.inverse() * &scale;
        inverse.fixed_view::<6, 6>(0, 0) * equations.cost
    })
}

/// The covariance of an increment on the left about the camera's origin, `[tx ty tz rx ry rz]` in the axes of the
/// camera, turned into that of one on the right about `centre` in object axes, which [`to_ros_order`] takes.
pub(super) fn from_reference_axes(
    covariance: &Matrix6<f64>,
    camera_from_object: &Pose,
    centre: &Point3<f64>,
) -> Matrix6<f64> {
    // The centre moves by t + w x c = t - [c]x w in the camera; seen in object axes that is R^T times it.
    let r: Matrix3<f64> = camera_from_object.rotation().transpose();
    let c = camera_from_object.transform_point(centre);
    let mut j = Matrix6::zeros();
    j.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
    j.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-r * skew(&c.coords)));
    j.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
    j * covariance * j.transpose()
}

/// The covariance in ROS order `x y z rotX rotY rotZ` (metres, radians, fixed axes of the camera frame): errors of
/// the object's origin and of its orientation, from the tracker's covariance in object axes about `centre`.
pub fn to_ros_order(
    covariance: &Matrix6<f64>,
    camera_from_object: &Pose,
    centre: &Point3<f64>,
) -> Matrix6<f64> {
    // An increment (dt, dr) about the centre moves the origin by dt - dr x centre = dt + [centre]x dr.
    let r: Matrix3<f64> = camera_from_object.rotation();
    let mut j = Matrix6::zeros();
    j.fixed_view_mut::<3, 3>(0, 0).copy_from(&r);
    j.fixed_view_mut::<3, 3>(0, 3).copy_from(&(r * skew(&centre.coords)));
    j.fixed_view_mut::<3, 3>(3, 3).copy_from(&r);
    j * covariance * j.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector3, Vector6};

    /// The linear map must agree with what a small increment does to origin and orientation.
    #[test]
    fn ros_order_follows_the_increment() {
        let pose = Pose::from_params(&Vector6::new(0.1, -0.2, 0.6, 0.3, -0.5, 0.2));
        let centre = Point3::new(0.05, 0.02, -0.04);
        for axis in 0..6 {
            let mut d = Vector6::zeros();
            d[axis] = 1e-6;
            let moved = pose.compose(&Pose::increment(&d, &centre));
            let origin = moved.translation() - pose.translation();
            let turn: Vector3<f64> = moved.compose(&pose.inverse()).rotation_vector();
            let mut expected = Vector6::zeros();
            expected.fixed_rows_mut::<3>(0).copy_from(&origin);
            expected.fixed_rows_mut::<3>(3).copy_from(&turn);
            let ros = to_ros_order(&(d * d.transpose()), &pose, &centre);
            let outer = expected * expected.transpose();
            assert!((ros - outer).norm() < 1e-4 * outer.norm(), "axis {axis}: {ros} against {outer}");
        }
    }
}
