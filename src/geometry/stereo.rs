//! A calibrated pair of cameras: corresponding clicks become points with covariance (section 3.1 of the paper).

use nalgebra::{DVector, Matrix3, Point2, Point3, SMatrix, SVector, Vector2, Vector3};

use super::bundle::Mark;
use super::least_squares::minimise;
use super::pose::skew;
use super::{Camera, Pose};
use crate::error::{Error, Result};

/// Two cameras and how they look at each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoRig {
    /// The left camera; triangulated points are in its frame.
    pub left: Camera,
    /// The right camera.
    pub right: Camera,
    /// `X_right = right_from_left X_left`, metres.
    pub right_from_left: Pose,
}

/// The same surface point, named by a person (or a corner finder) in both images.
#[derive(Debug, Clone, PartialEq)]
pub struct ClickPair {
    /// What the landmark is called.
    pub name: String,
    /// Pixel in the left image.
    pub left: Point2<f64>,
    /// Pixel in the right image.
    pub right: Point2<f64>,
}

/// A triangulated point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoPoint {
    /// Position in the left camera's frame, metres.
    pub position: Point3<f64>,
    /// Covariance of the position that follows from the noise of the clicks, square metres.
    pub covariance: Matrix3<f64>,
    /// Root mean square distance of the reprojected point from the two clicks, pixels.
    pub rms_px: f64,
}

/// What clicks are believed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClickOptions {
    /// Standard deviation of a click, pixels per coordinate.
    pub sigma_px: f64,
    /// Pairs further from their epipolar lines are refused, pixels.
    pub max_epipolar_px: f64,
}

impl Default for ClickOptions {
    fn default() -> Self {
        Self { sigma_px: 0.3, max_epipolar_px: 2.0 }
    }
}

impl StereoRig {
    /// A pair of cameras.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a camera that is none, or cameras at the same place.
    pub fn new(left: Camera, right: Camera, right_from_left: Pose) -> Result<Self> {
        left.validate()?;
        right.validate()?;
        if !right_from_left.is_finite() || right_from_left.translation().norm() < 1e-9 {
            let problem = "the two cameras are at the same place";
            return Err(Error::invalid("stereo", problem, "give right_from_left with the baseline"));
        }
        Ok(Self { left, right, right_from_left })
    }

    /// Distance between the cameras, metres.
    pub fn baseline(&self) -> f64 {
        self.right_from_left.translation().norm()
    }

    /// How far the clicks are from each other's epipolar lines, the larger of the two distances, in pixels of the
    /// undistorted images; `None` where a lens model has no inverse.
    ///
    /// With the essential matrix `E = [t]x R` the line in the right image is `E x_left`, in the left `E^T x_right`.
    pub fn epipolar_px(&self, pair: &ClickPair) -> Option<f64> {
        let (left, right) = (self.left.ray(&pair.left)?, self.right.ray(&pair.right)?);
        let essential = skew(&self.right_from_left.translation()) * self.right_from_left.rotation();
        let distance = |camera: &Camera, ray: &Vector3<f64>, line: &Vector3<f64>| {
            // A line of normalised coordinates has K^-T as its image in pixels.
            (line.dot(ray) / Vector3::new(line.x / camera.fx, line.y / camera.fy, 0.0).norm()).abs()
        };
        let at_right = distance(&self.right, &right, &(essential * left));
        let at_left = distance(&self.left, &left, &(essential.transpose() * right));
        Some(at_right.max(at_left))
    }

    /// The point whose projections are nearest to the two clicks (least squares in pixels), and its covariance
    /// `sigma^2 (J^T J)^-1`.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the pair if its lines of sight do not meet in front of both cameras.
    pub fn triangulate(&self, pair: &ClickPair, sigma_px: f64) -> Result<StereoPoint> {
        let marks = [pair.left, pair.right].map(|pixel| Mark::new(pixel, sigma_px));
        self.triangulate_marks(&pair.name, &marks)
    }

    /// As [`Self::triangulate`] with a covariance of its own for each of the two pixels, left and right: least squares of
    /// the whitened distances.
    ///
    /// # Errors
    /// As [`Self::triangulate`].
    pub fn triangulate_marks(&self, name: &str, marks: &[Mark; 2]) -> Result<StereoPoint> {
        let refuse = |problem: &str| {
            let what = format!("landmark {name:?}");
            Err(Error::invalid(what, problem, "click the same point in both images"))
        };
        let [at_left, at_right] = marks.map(|m| m.pixel);
        let (Some(left), Some(right)) = (self.left.ray(&at_left), self.right.ray(&at_right)) else {
            return refuse("a click is outside of what the lens model covers");
        };
        let Some(start) = self.linear(&left, &right) else {
            return refuse("its lines of sight are parallel");
        };
        let distances = |x: &Point3<f64>| {
            let left = self.left.project(x)? - at_left;
            Some([left, self.right.project(&self.right_from_left.transform_point(x))? - at_right])
        };
        let residuals = |x: &Point3<f64>| {
            let [left, right] = distances(x)?;
            let (left, right) = (marks[0].whitening * left, marks[1].whitening * right);
            Some(DVector::from_vec(vec![left.x, left.y, right.x, right.y]))
        };
        let fit = minimise(start, 3, |x, d| x + Vector3::new(d[0], d[1], d[2]), residuals);
        let Some(fit) = fit else {
            return refuse("its lines of sight do not meet in front of both cameras");
        };
        let Some(inverse) = fit.normal.fixed_view::<3, 3>(0, 0).into_owned().try_inverse() else {
            return refuse("its lines of sight are parallel");
        };
        let squares = distances(&fit.state).map_or(f64::NAN, |d| d.iter().map(Vector2::norm_squared).sum());
        Ok(StereoPoint { position: fit.state, covariance: inverse, rms_px: (squares / 2.0).sqrt() })
    }

    /// Triangulates all pairs; they must agree with the calibration.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming every pair beyond `max_epipolar_px` with its distance, or the first that cannot be
    /// triangulated.
    pub fn triangulate_all(&self, pairs: &[ClickPair], options: &ClickOptions) -> Result<Vec<StereoPoint>> {
        let bad: Vec<String> = pairs
            .iter()
            .enumerate()
            .filter_map(|(k, pair)| {
                let distance = self.epipolar_px(pair).unwrap_or(f64::INFINITY);
                // Written so that NaN is bad too.
                let good = distance <= options.max_epipolar_px;
                (!good).then(|| format!("{k} {:?} ({distance:.2} px)", pair.name))
            })
            .collect();
        if !bad.is_empty() {
            let problem = format!(
                "{} of {} pairs are more than {} px from their epipolar lines: {}",
                bad.len(),
                pairs.len(),
                options.max_epipolar_px,
                bad.join(", ")
            );
            let remedy = "click these points again, check the stereo calibration, or allow a larger distance";
            return Err(Error::invalid("clicks", problem, remedy));
        }
        pairs.iter().map(|pair| self.triangulate(pair, options.sigma_px)).collect()
    }

    /// Linear triangulation: `x Z = X`, `y Z = Y` for both rays.
    fn linear(&self, left: &Vector3<f64>, right: &Vector3<f64>) -> Option<Point3<f64>> {
        let (r, t) = (self.right_from_left.rotation(), self.right_from_left.translation());
        let mut a = SMatrix::<f64, 4, 3>::zeros();
        let mut b = SVector::<f64, 4>::zeros();
        for k in 0..2 {
            a[(k, k)] = 1.0;
            a[(k, 2)] = -left[k];
            a.set_row(k + 2, &(r.row(k) - right[k] * r.row(2)));
            b[k + 2] = right[k] * t.z - t[k];
        }
        let normal = a.tr_mul(&a);
        Some(Point3::from(normal.try_inverse()? * a.tr_mul(&b))).filter(|x| x.iter().all(|v| v.is_finite()))
    }
}

#[cfg(test)]
#[path = "stereo_tests.rs"]
mod tests;
