//! Pinhole camera with Brown-Conrady distortion. Pixel centres are at integers, the camera looks along +z, y is down.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Brown-Conrady lens distortion in OpenCV's order k1, k2, p1, p2, k3.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial, r^2.
    pub k1: f64,
    /// Radial, r^4.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// Radial, r^6.
    pub k3: f64,
}

impl Distortion {
    /// True if every coefficient is zero.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Distorts normalised coordinates (x/z, y/z).
    pub fn apply(&self, p: Point2<f64>) -> Point2<f64> {
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        Point2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Derivative of [`Self::apply`] by the normalised coordinates.
    pub fn jacobian(&self, p: Point2<f64>) -> Matrix2<f64> {
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let slope = self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3);
        let mixed = 2.0 * x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
        Matrix2::new(
            radial + 2.0 * x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            mixed,
            mixed,
            radial + 2.0 * y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )
    }

    /// Inverts [`Self::apply`] by Newton's method; `None` where the lens model has no inverse.
    pub fn remove(&self, distorted: Point2<f64>) -> Option<Point2<f64>> {
        if self.is_none() {
            return Some(distorted);
        }
        let mut p = distorted;
        for _ in 0..30 {
            let error = self.apply(p) - distorted;
            let step = self.jacobian(p).try_inverse()? * error;
            p -= step;
            if step.norm() < 1e-14 {
                break;
            }
        }
        // Beyond the radius where the polynomial folds back, Newton lands elsewhere or nowhere.
        let folded = self.jacobian(p).determinant() <= 0.0;
        (!folded && (self.apply(p) - distorted).norm() < 1e-9).then_some(p)
    }
}

/// Calibrated camera: focal lengths and principal point in pixels, image size, lens distortion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Focal length along u, pixels.
    pub fx: f64,
    /// Focal length along v, pixels.
    pub fy: f64,
    /// Principal point u, pixels.
    pub cx: f64,
    /// Principal point v, pixels.
    pub cy: f64,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Lens distortion.
    pub distortion: Distortion,
}

impl Camera {
    /// A camera without distortion.
    pub fn pinhole(fx: f64, fy: f64, cx: f64, cy: f64, width: u32, height: u32) -> Self {
        Self { fx, fy, cx, cy, width, height, distortion: Distortion::default() }
    }

    /// Checks that the numbers describe a camera.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first value that is not finite or not positive.
    pub fn validate(&self) -> Result<()> {
        let d = &self.distortion;
        let all = [self.fx, self.fy, self.cx, self.cy, d.k1, d.k2, d.p1, d.p2, d.k3];
        if all.iter().any(|v| !v.is_finite()) {
            return Err(Error::invalid(
                "camera",
                "a parameter is not a finite number",
                "check the calibration",
            ));
        }
        if self.fx <= 0.0 || self.fy <= 0.0 {
            return Err(Error::invalid(
                "camera",
                format!("focal lengths must be positive, got {} and {}", self.fx, self.fy),
                "give them in pixels",
            ));
        }
        if self.width < 16 || self.height < 16 {
            return Err(Error::invalid(
                "camera",
                format!("image size {}x{} is below 16x16", self.width, self.height),
                "give the image size in pixels",
            ));
        }
        Ok(())
    }

    /// Intrinsic matrix K.
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// Inverse of K.
    pub fn inverse_matrix(&self) -> Matrix3<f64> {
        let (a, b) = (1.0 / self.fx, 1.0 / self.fy);
        Matrix3::new(a, 0.0, -self.cx * a, 0.0, b, -self.cy * b, 0.0, 0.0, 1.0)
    }

    /// The same camera without distortion: what a rectified frame was taken with.
    pub fn rectified(&self) -> Self {
        Self { distortion: Distortion::default(), ..*self }
    }

    /// The camera of pyramid level `level`: halved per level with pixel centres at integers,
    /// so cx becomes (cx + 0.5)/2 - 0.5.
    pub fn at_level(&self, level: usize) -> Self {
        (0..level).fold(*self, |c, _| Self {
            fx: c.fx / 2.0,
            fy: c.fy / 2.0,
            cx: (c.cx + 0.5) / 2.0 - 0.5,
            cy: (c.cy + 0.5) / 2.0 - 0.5,
            width: c.width / 2,
            height: c.height / 2,
            distortion: c.distortion,
        })
    }

    /// Pixel of a point in the camera frame; `None` behind the camera.
    pub fn project(&self, point: &Point3<f64>) -> Option<Point2<f64>> {
        (point.z > 0.0).then(|| {
            let p = self.distortion.apply(Point2::new(point.x / point.z, point.y / point.z));
            Point2::new(self.fx * p.x + self.cx, self.fy * p.y + self.cy)
        })
    }

    /// Derivative (2x3, pixels per metre) of [`Self::project`] by the point; the point must be in front.
    pub fn project_jacobian(&self, point: &Point3<f64>) -> Matrix2x3<f64> {
        let z1 = 1.0 / point.z;
        let p = Point2::new(point.x * z1, point.y * z1);
        let normalise = Matrix2x3::new(z1, 0.0, -p.x * z1, 0.0, z1, -p.y * z1);
        Matrix2::new(self.fx, 0.0, 0.0, self.fy) * self.distortion.jacobian(p) * normalise
    }

    /// Ray (x, y, 1) in the camera frame through a pixel; `None` where the lens model has no inverse.
    pub fn ray(&self, pixel: &Point2<f64>) -> Option<Vector3<f64>> {
        let distorted = Point2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        self.distortion.remove(distorted).map(|p| Vector3::new(p.x, p.y, 1.0))
    }

    /// True if the pixel lies at least `margin` pixels inside the image.
    pub fn contains(&self, pixel: &Point2<f64>, margin: f64) -> bool {
        pixel.x >= margin
            && pixel.y >= margin
            && pixel.x <= f64::from(self.width) - 1.0 - margin
            && pixel.y <= f64::from(self.height) - 1.0 - margin
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lens() -> Camera {
        let distortion = Distortion { k1: -0.28, k2: 0.09, p1: 0.001, p2: -0.0007, k3: 0.01 };
        Camera { distortion, ..Camera::pinhole(800.0, 790.0, 319.5, 239.5, 640, 480) }
    }

    proptest! {
        #[test]
        fn ray_inverts_project(u in 0.0..639.0f64, v in 0.0..479.0f64, z in 0.1..3.0f64) {
            let camera = lens();
            let ray = camera.ray(&Point2::new(u, v)).expect("inside the lens model");
            let pixel = camera.project(&Point3::from(ray * z)).expect("in front");
            prop_assert!((pixel - Point2::new(u, v)).norm() < 1e-8, "{pixel} is not ({u}, {v})");
        }

        #[test]
        fn jacobian_equals_central_differences(x in -0.2..0.2f64, y in -0.15..0.15f64, z in 0.3..1.0f64) {
            let camera = lens();
            let p = Point3::new(x, y, z);
            let analytic = camera.project_jacobian(&p);
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = 1e-6;
                let ahead = camera.project(&(p + step)).expect("in front");
                let behind = camera.project(&(p - step)).expect("in front");
                let numeric = (ahead - behind) / 2e-6;
                let error = (analytic.column(axis) - numeric).norm();
                prop_assert!(error < 1e-5 * (1.0 + numeric.norm()), "axis {axis}: {error}");
            }
        }
    }

    #[test]
    fn level_keeps_rays() {
        let camera = Camera::pinhole(800.0, 800.0, 319.5, 239.5, 640, 480);
        let point = Point3::new(0.05, -0.03, 0.6);
        let full = camera.project(&point).expect("in front");
        let half = camera.at_level(1).project(&point).expect("in front");
        assert!((half.x - ((full.x + 0.5) / 2.0 - 0.5)).abs() < 1e-12, "u {} from {}", half.x, full.x);
        assert!((half.y - ((full.y + 0.5) / 2.0 - 0.5)).abs() < 1e-12, "v {} from {}", half.y, full.y);
    }

    #[test]
    fn bad_numbers_are_named() {
        let bad = Camera::pinhole(f64::NAN, 800.0, 0.0, 0.0, 640, 480);
        assert!(bad.validate().is_err(), "a NaN focal length must be refused");
        assert!(
            Camera::pinhole(-1.0, 800.0, 0.0, 0.0, 640, 480).validate().is_err(),
            "negative focal length"
        );
        assert!(lens().validate().is_ok(), "the lens is fine");
    }
}
