//! Covariance of the estimated pose.

use nalgebra::{Matrix3, Matrix6, Point3};

use super::PoseEstimate;
use super::normal_equations::NormalEquations;
use super::workspace::{Solver, copy_matrix, scale_both_sides};
use crate::geometry::pose::skew;
use crate::geometry::warp::increment_jacobian;
use crate::geometry::{Camera, Pose};
use crate::model::Shape;

/// Share of the scatter that is taken to have the shape of the hessian: a few dozen triangles say little about its
/// weakest directions.
const SHRINKAGE: f64 = 0.3;

/// Cluster-robust covariance: `H^-1 G H^-1` with `G = sum_i g_i g_i^T` and `g_i` the part of triangle i in the gradient, H
/// scaled by the `response` of the gradient to the pose. Residuals of neighbouring pixels are correlated (interpolation,
/// light, model errors) and stronger where the contrast is; both show in the sums of whole triangles, while the textbook
/// `s^2 H^-1` takes every pixel for an independent witness. A share of G is replaced by H of the same size. Zero where
/// the pose is not determined. Object axes about the centre of rotation, `[tx ty tz rx ry rz]`, metres and radians.
pub(super) fn covariance(equations: &NormalEquations, response: f64, solver: &mut Solver) -> Matrix6<f64> {
    let (n, p) = (equations.triangles, equations.gradient.len());
    if n <= p {
        return Matrix6::zeros();
    }
    let Some(factor) = solver.factor(&equations.hessian, 0.0) else { return Matrix6::zeros() };
    let Solver { scatter, scale, .. } = solver;
    copy_matrix(scatter, &equations.scatter);
    scale_both_sides(scatter, scale);
    factor.solve_mut(scatter);
    #[expect(clippy::cast_precision_loss, reason = "triangle counts are small")]
    let (few_clusters, size) = (n as f64 / (n - p) as f64, scatter.trace() / p as f64);
    let mixed = |(g, h): (&f64, &f64)| (1.0 - SHRINKAGE) * g + SHRINKAGE * size * h;
    for (to, mixed) in scatter.iter_mut().zip(equations.scatter.iter().zip(&equations.hessian).map(mixed)) {
        *to = mixed;
    }
    scale_both_sides(scatter, scale);
    // H^-1 G, then H^-1 (H^-1 G)^T.
    factor.solve_mut(scatter);
    scatter.transpose_mut();
    factor.solve_mut(scatter);
    scale_both_sides(scatter, scale);
    solver.system = factor.unpack_dirty();
    solver.scatter.fixed_view::<6, 6>(0, 0) * (few_clusters / (response * response))
}

impl PoseEstimate {
    /// How far the image leaves open where the object is: rms standard deviation of the corners of the object's box in the
    /// image, pixels; infinite where the pose is not determined. Right poses have a tenth of a pixel, bad images half
    /// a one. An end at which the template fits only somewhat has several, however well it correlates: its triangles
    /// pull in different directions.
    pub fn spread_px(&self, camera: &Camera, shape: &Shape) -> f64 {
        let covariance = if self.covariance == Matrix6::zeros() {
            // Too few triangles to see how they scatter: what independent residuals would leave open.
            let Some(inverse) = self.hessian.try_inverse() else { return f64::INFINITY };
            inverse * (self.rms * self.rms)
        } else {
            self.covariance
        };
        let pose = &self.camera_from_object;
        let (pinhole, mut sum, mut seen) = (camera.rectified(), 0.0, 0.0);
        for corner in shape.corners.iter().filter(|x| pose.transform_point(x).z > 0.0) {
            let d = increment_jacobian(&pinhole, pose, corner, &shape.centre);
            sum += (d * covariance * d.transpose()).trace();
            seen += 1.0;
        }
        // Written so that NaN is no pose.
        let variance = sum / seen;
        if variance >= 0.0 { variance.sqrt() } else { f64::INFINITY }
    }
}

/// The hessian that belongs to a covariance made of it and a residual variance; zero where that is not known.
pub(super) fn hessian_of(covariance: &Matrix6<f64>, variance: f64) -> Matrix6<f64> {
    covariance.try_inverse().map_or_else(Matrix6::zeros, |inverse| inverse * variance)
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
