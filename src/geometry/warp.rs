//! Per-triangle warps from template pixels to image positions, and their derivatives.
//!
//! Two warps exist: the paper's [`affine`] of eq. (3), and the perspective-exact 3x3 `K [R|t] M`
//! with `M` of [`object_from_chart`]. `docs/maths.md` derives both.

use nalgebra::{Matrix2, Matrix2x3, Matrix2x6, Matrix3, Matrix3x4, Matrix4x3, Point2, Point3, Vector3};

use super::camera::Camera;
use super::pose::{Pose, skew};

/// Twice the signed area of a triangle in pixels (positive: clockwise on screen, v pointing down).
pub fn double_area(t: &[Point2<f64>; 3]) -> f64 {
    (t[1] - t[0]).perp(&(t[2] - t[0]))
}

/// Linear map of the barycentric coordinates: `b = rows * (u, v, 1)`; `None` for a triangle without area.
pub fn barycentric_rows(t: &[Point2<f64>; 3]) -> Option<Matrix3<f64>> {
    Matrix3::new(t[0].x, t[1].x, t[2].x, t[0].y, t[1].y, t[2].y, 1.0, 1.0, 1.0).try_inverse()
}

/// Eq. (3): the 2x3 affine that takes triangle `from` to triangle `to`; `None` if `from` has no area.
pub fn affine(from: &[Point2<f64>; 3], to: &[Point2<f64>; 3]) -> Option<Matrix2x3<f64>> {
    let corners = Matrix2x3::new(to[0].x, to[1].x, to[2].x, to[0].y, to[1].y, to[2].y);
    barycentric_rows(from).map(|rows| corners * rows)
}

/// The plane through three points: unit normal n and offset d with n.X = d; `None` for collinear points.
pub fn plane(t: &[Point3<f64>; 3]) -> Option<(Vector3<f64>, f64)> {
    let (e1, e2) = (t[1] - t[0], t[2] - t[0]);
    let n = e1.cross(&e2);
    let scale = e1.norm() * e2.norm();
    (n.norm() > 1e-9 * scale && scale > 0.0).then(|| {
        let n = n.normalize();
        (n, n.dot(&t[0].coords))
    })
}

/// M (4x3): takes a pixel (u, v, 1) of a reference view to the homogeneous object point on a plane given in
/// that view's camera frame (n.X = d).
///
/// `M = [ R^T (K^-1 d - t n^T K^-1) ; n^T K^-1 ]` with (R, t) the view's `camera_from_object`. The view must be
/// free of lens distortion.
pub fn object_from_chart(camera: &Camera, view: &Pose, plane: (Vector3<f64>, f64)) -> Matrix4x3<f64> {
    let (n, d) = plane;
    let inverse_k = camera.inverse_matrix();
    let depth_row = n.transpose() * inverse_k;
    let points = view.rotation().transpose() * (inverse_k * d - view.translation() * depth_row);
    let mut m = Matrix4x3::zeros();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&points);
    m.fixed_view_mut::<1, 3>(3, 0).copy_from(&depth_row);
    // The sign of w must be positive in front of the view: n.ray and d have the same sign there.
    if d < 0.0 { -m } else { m }
}

/// The perspective-exact warp `K [R|t] M`: chart pixel to homogeneous image position.
pub fn homography(camera: &Camera, pose: &Pose, object_from_chart: &Matrix4x3<f64>) -> Matrix3<f64> {
    projection(camera, pose) * object_from_chart
}

/// `K [R|t]` (3x4): homogeneous object point to homogeneous image position.
pub fn projection(camera: &Camera, pose: &Pose) -> Matrix3x4<f64> {
    camera.matrix() * pose.matrix().fixed_view::<3, 4>(0, 0)
}

/// Applies a 3x3 warp to a pixel; `None` at or behind the camera plane.
pub fn apply(warp: &Matrix3<f64>, pixel: &Point2<f64>) -> Option<Point2<f64>> {
    let p = warp * Vector3::new(pixel.x, pixel.y, 1.0);
    (p.z > 0.0).then(|| Point2::new(p.x / p.z, p.y / p.z))
}

/// A = dW/dx (2x2) of a 3x3 warp at a chart pixel.
pub fn warp_jacobian(warp: &Matrix3<f64>, pixel: &Point2<f64>) -> Matrix2<f64> {
    let p = warp * Vector3::new(pixel.x, pixel.y, 1.0);
    let w1 = 1.0 / p.z;
    let (u, v) = (p.x * w1, p.y * w1);
    let row = |image: usize, value: f64, k: usize| (warp[(image, k)] - value * warp[(2, k)]) * w1;
    Matrix2::new(row(0, u, 0), row(0, u, 1), row(1, v, 0), row(1, v, 1))
}

/// D (2x6, pixels per metre and per radian): motion of the image of object point `x` when the pose is composed on
/// the right with an increment about `centre`, `[dpi/dX] R [ I | -[x - c]x ]`, order `[tx ty tz rx ry rz]`.
pub fn increment_jacobian(
    camera: &Camera,
    pose: &Pose,
    x: &Point3<f64>,
    centre: &Point3<f64>,
) -> Matrix2x6<f64> {
    increment_jacobian_at(camera, &pose.transform_point(x), &pose.rotation(), &(x - centre))
}

/// [`increment_jacobian`] of a point that is at `in_camera` in the camera frame and at `arm` from the centre of the
/// increment in the object frame, with the rotation matrix of the pose.
pub fn increment_jacobian_at(
    camera: &Camera,
    in_camera: &Point3<f64>,
    rotation: &Matrix3<f64>,
    arm: &Vector3<f64>,
) -> Matrix2x6<f64> {
    let moved = camera.project_jacobian(in_camera) * rotation;
    let mut d = Matrix2x6::zeros();
    d.fixed_view_mut::<2, 3>(0, 0).copy_from(&moved);
    d.fixed_view_mut::<2, 3>(0, 3).copy_from(&(-moved * skew(arm)));
    d
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{RowVector6, Vector2, Vector6};

    /// The published test vector: f = 800, one triangle, reference view = object frame, millimetres.
    struct Vectors {
        camera: Camera,
        triangle: [Point3<f64>; 3],
        centre: Point3<f64>,
        pose: Pose,
        pixel: Point2<f64>,
        gradient: Vector2<f64>,
    }

    fn vectors() -> Vectors {
        let centre = Point3::new(0.0, 0.0, 565.0);
        Vectors {
            camera: Camera::pinhole(800.0, 800.0, 319.5, 239.5, 640, 480),
            triangle: [
                Point3::new(-20.0, -10.0, 560.0),
                Point3::new(25.0, -12.0, 548.0),
                Point3::new(3.0, 22.0, 571.0),
            ],
            centre,
            pose: Pose::increment(&Vector6::new(12.0, -7.0, 30.0, 0.20, -0.35, 0.15), &centre),
            pixel: Point2::new(322.0, 236.0),
            gradient: Vector2::new(5.0, -3.0),
        }
    }

    impl Vectors {
        fn project(&self, pose: &Pose) -> [Point2<f64>; 3] {
            self.triangle.map(|x| self.camera.project(&pose.transform_point(&x)).expect("in front"))
        }

        fn chart(&self) -> Matrix4x3<f64> {
            object_from_chart(&self.camera, &Pose::identity(), plane(&self.triangle).expect("a plane"))
        }

        fn point(&self) -> Point3<f64> {
            let x = self.chart() * Vector3::new(self.pixel.x, self.pixel.y, 1.0);
            Point3::from(x.xyz() / x.w)
        }

        /// J row with the affine or exact A, method section 4.
        fn jacobian_row(&self, pose: &Pose) -> RowVector6<f64> {
            let d = increment_jacobian(&self.camera, pose, &self.point(), &self.centre);
            let a = warp_jacobian(&homography(&self.camera, pose, &self.chart()), &self.pixel);
            self.gradient.transpose() * a.try_inverse().expect("not edge-on") * d
        }
    }

    #[test]
    fn template_vertices_and_barycentric() {
        let v = vectors();
        let t = v.project(&Pose::identity());
        let expected =
            [(290.92857143, 225.21428571), (355.99635036, 221.98175182), (323.70315236, 270.32311734)];
        for (p, e) in t.iter().zip(expected) {
            assert!((p - Point2::new(e.0, e.1)).norm() < 1e-8, "{p} is not {e:?}");
        }
        let b = barycentric_rows(&t).expect("area") * Vector3::new(v.pixel.x, v.pixel.y, 1.0);
        let expected = Vector3::new(0.3915508089, 0.3446472323, 0.2638019589);
        assert!((b - expected).norm() < 1e-9, "{b}");
        assert!(double_area(&t) > 0.0, "clockwise on screen");
    }

    #[test]
    fn exact_and_affine_warp() {
        let v = vectors();
        assert!((v.point() - Point3::new(1.7456968216, -2.4439755502, 558.6229829081)).norm() < 1e-8, "X(x)");
        let exact = apply(&homography(&v.camera, &v.pose, &v.chart()), &v.pixel).expect("in front");
        assert!((exact - Point2::new(341.4220824902, 228.5532748853)).norm() < 1e-8, "{exact}");
        let a = affine(&v.project(&Pose::identity()), &v.project(&v.pose)).expect("area");
        let affine = a * Vector3::new(v.pixel.x, v.pixel.y, 1.0);
        assert!((affine - Vector2::new(341.0865289102, 228.4823463999)).norm() < 1e-8, "{affine}");
        let linear = Matrix2::new(0.9535829241, -0.3047173009, 0.1253914048, 0.8412183404);
        assert!((a.fixed_view::<2, 2>(0, 0) - linear).norm() < 1e-9, "{a}");
    }

    #[test]
    fn derivatives() {
        let v = vectors();
        let d = increment_jacobian(&v.camera, &v.pose, &v.point(), &v.centre);
        #[rustfmt::skip]
        let expected = Matrix2x6::new(
            1.2472343113, -0.1959741869, -0.4996589452, -0.0285764941, -7.0813814884, 2.7060986470,
            0.1140869680, 1.3318446258, -0.2362075304, 9.0704813718, -0.3151878101, 2.6038226906,
        );
        assert!((d - expected).norm() < 1e-8, "{d}");
        let a = warp_jacobian(&homography(&v.camera, &v.pose, &v.chart()), &v.pixel);
        let expected = Matrix2::new(0.9548487016, -0.3156048161, 0.1206510129, 0.8427042993);
        assert!((a - expected).norm() < 1e-9, "{a}");
        let at_pose = RowVector6::new(
            6.5974780454,
            -3.0972109683,
            -2.3522162355,
            -14.0022083141,
            -37.9659738530,
            10.7172836928,
        );
        assert!((v.jacobian_row(&v.pose) - at_pose).norm() < 1e-7, "{}", v.jacobian_row(&v.pose));
        let constant =
            RowVector6::new(7.1604644320, -4.2962786592, -0.0411726705, -27.296817441, -45.590529069, 10.0);
        let identity = v.jacobian_row(&Pose::identity());
        assert!((identity - constant).norm() < 1e-8, "{identity}");
    }

    #[test]
    fn a_view_that_looks_at_the_back_gives_the_same_points() {
        let v = vectors();
        let flipped = [v.triangle[0], v.triangle[2], v.triangle[1]];
        let m = object_from_chart(&v.camera, &Pose::identity(), plane(&flipped).expect("a plane"));
        let x = m * Vector3::new(v.pixel.x, v.pixel.y, 1.0);
        assert!(x.w > 0.0 && (Point3::from(x.xyz() / x.w) - v.point()).norm() < 1e-8, "{x}");
    }
}
