//! Pose of a camera from points of known position and their pixels (perspective-n-point).
//!
//! First guesses are the homography of the points' best plane (Zhang, PAMI 2000), the same plane mirrored about the
//! line of sight (the second minimum of nearly flat objects; Schweighofer and Pinz, PAMI 2006), and the direct linear
//! transform where the points have depth. Each is refined by least squares in pixels; the best one wins.

use nalgebra::{DMatrix, DVector, Matrix3, Point2, Point3, Rotation3, Vector3};

use super::least_squares::{Fit, minimise};
use super::rigid_fit::{centroid, nearest_rotation};
use super::{Camera, Pose};
use crate::error::{Error, Result};

/// Points count as coplanar if they are flatter than this share of their extent.
const FLAT: f64 = 1e-3;
/// Points count as collinear if they are narrower than this share of their extent.
const NARROW: f64 = 1e-3;
/// A pose whose normal equations, scaled to a unit diagonal, have a smaller eigenvalue is not determined.
const DEGENERATE: f64 = 1e-10;
/// What is needed.
const REMEDY: &str = "give at least 6 points, or 4 of a plane with no three on one line";

/// A pose from points.
#[derive(Debug, Clone, PartialEq)]
pub struct PnpSolution {
    /// The pose, metres.
    pub camera_from_object: Pose,
    /// Root mean square distance between pixels and reprojected points, pixels.
    pub rms_px: f64,
    /// That distance of every point, pixels.
    pub distances_px: Vec<f64>,
}

impl PnpSolution {
    /// A pose, and how well the points fit with it; those behind the camera are infinitely far off.
    pub fn of(pose: Pose, camera: &Camera, points: &[Point3<f64>], pixels: &[Point2<f64>]) -> Self {
        let distance = |(x, seen): (&Point3<f64>, &Point2<f64>)| {
            camera.project(&pose.transform_point(x)).map_or(f64::INFINITY, |p| (p - seen).norm())
        };
        let distances_px: Vec<f64> = points.iter().zip(pixels).map(distance).collect();
        #[expect(clippy::cast_precision_loss, reason = "point counts are far below 2^52")]
        let rms_px = (distances_px.iter().map(|d| d * d).sum::<f64>() / points.len() as f64).sqrt();
        Self { camera_from_object: pose, rms_px, distances_px }
    }
}

/// Finds the pose from points (object frame, metres) and their pixels in the image of `camera`, lens distortion
/// included.
///
/// # Errors
/// [`Error::Invalid`] for unequal counts, numbers that are not finite, too few points (6, or 4 of a plane), points on
/// one line, and sets that leave the pose open.
pub fn solve(camera: &Camera, points: &[Point3<f64>], pixels: &[Point2<f64>]) -> Result<PnpSolution> {
    let set = PointSet::new(camera, points, pixels)?;
    let mut starts = set.planar_starts();
    if !set.flat && points.len() >= 6 {
        starts.extend(set.linear_start());
    }
    let fits = starts.into_iter().filter_map(|start| refine(camera, points, pixels, start));
    let best = fits.min_by(|a, b| a.residuals.norm_squared().total_cmp(&b.residuals.norm_squared()));
    let Some(fit) = best.filter(|fit| is_determined(&fit.normal)) else {
        return Err(refused("these points leave the pose open", REMEDY));
    };
    Ok(PnpSolution::of(fit.state, camera, points, pixels))
}

fn refused(problem: impl Into<String>, remedy: &str) -> Error {
    Error::invalid("pose from points", problem, remedy)
}

/// The pose nearest to a first guess in which points are seen best at their pixels, least squares; `None` if it has points
/// behind the camera or no unique minimum.
pub(crate) fn refined(
    camera: &Camera,
    points: &[Point3<f64>],
    pixels: &[Point2<f64>],
    start: Pose,
) -> Option<Pose> {
    let fit = refine(camera, points, pixels, start)?;
    (is_determined(&fit.normal) && fit.state.is_finite()).then_some(fit.state)
}

/// Least squares in pixels from a first guess; `None` if it has points behind the camera or no unique minimum.
pub(super) fn refine(
    camera: &Camera,
    points: &[Point3<f64>],
    pixels: &[Point2<f64>],
    start: Pose,
) -> Option<Fit<Pose>> {
    let centre = centroid(points);
    let residuals = |pose: &Pose| {
        let mut r = Vec::with_capacity(2 * points.len());
        for (x, seen) in points.iter().zip(pixels) {
            let off = camera.project(&pose.transform_point(x))? - seen;
            r.extend([off.x, off.y]);
        }
        Some(DVector::from_vec(r))
    };
    let retract = |pose: &Pose, d: &DVector<f64>| {
        let (t, r) = (Vector3::new(d[0], d[1], d[2]), Vector3::new(d[3], d[4], d[5]));
        pose.compose(&Pose::about(r, t, &centre))
    };
    minimise(start, 6, retract, residuals)
}

fn is_determined(normal: &DMatrix<f64>) -> bool {
    let scale = normal.diagonal().map(|d| 1.0 / d.sqrt());
    let scaled = DMatrix::from_fn(6, 6, |i, j| normal[(i, j)] * scale[i] * scale[j]);
    scaled.iter().all(|v| v.is_finite()) && scaled.symmetric_eigenvalues().min() > DEGENERATE
}

/// The correspondences in principal axes of the points.
struct PointSet {
    /// Normalised image coordinates (x, y) of every point.
    rays: Vec<Point2<f64>>,
    /// Coordinates along the principal axes, scaled to unit extent.
    local: Vec<Point3<f64>>,
    /// Principal axes as columns, right-handed; the last one is the normal of the best plane.
    axes: Matrix3<f64>,
    centre: Point3<f64>,
    extent: f64,
    flat: bool,
}

impl PointSet {
    fn new(camera: &Camera, points: &[Point3<f64>], pixels: &[Point2<f64>]) -> Result<Self> {
        let n = points.len();
        if n != pixels.len() {
            let problem = format!("{n} points, but {} pixels", pixels.len());
            return Err(refused(problem, "give one pixel per point"));
        }
        if let Some(k) = points.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
            return Err(refused(format!("point {k} is not finite"), "give finite coordinates"));
        }
        if n < 4 {
            return Err(refused(format!("{n} points are too few"), REMEDY));
        }
        let mut rays = Vec::with_capacity(n);
        for (k, pixel) in pixels.iter().enumerate() {
            let ray = camera.ray(pixel).filter(|r| r.iter().all(|v| v.is_finite()));
            let Some(ray) = ray else {
                let problem = format!("pixel {k} is outside of what the lens model covers");
                return Err(refused(problem, "give pixels inside the image"));
            };
            rays.push(Point2::new(ray.x, ray.y));
        }
        let centre = centroid(points);
        let scatter =
            points.iter().fold(Matrix3::zeros(), |m, p| m + (p - centre) * (p - centre).transpose());
        let svd = scatter.svd(true, false);
        let sizes = svd.singular_values.map(f64::sqrt);
        let Some(mut axes) = svd.u.filter(|_| sizes[1] > NARROW * sizes[0]) else {
            return Err(refused("the points lie on one line", REMEDY));
        };
        if axes.determinant() < 0.0 {
            axes.set_column(2, &-axes.column(2));
        }
        let flat = sizes[2] <= FLAT * sizes[0];
        if !flat && n < 6 {
            return Err(refused(format!("{n} points that are not in one plane are too few"), REMEDY));
        }
        let local = points.iter().map(|p| Point3::from(axes.tr_mul(&(p - centre)) / sizes[0])).collect();
        Ok(Self { rays, local, axes, centre, extent: sizes[0], flat })
    }

    /// Undoes the change to principal axes: `rotation` and `translation` are `camera_from_local`, unit extent.
    fn pose(&self, rotation: Rotation3<f64>, translation: Vector3<f64>) -> Pose {
        let r = Rotation3::from_matrix_unchecked(rotation.matrix() * self.axes.transpose());
        Pose::new(r, translation * self.extent - r * self.centre.coords)
    }

    /// The pose from the homography of the best plane, and its mirror image about the line of sight.
    fn planar_starts(&self) -> Vec<Pose> {
        let Some(h) = null_vector(&self.equations(|p| vec![p.x, p.y, 1.0])) else { return Vec::new() };
        let mut h = Matrix3::from_row_slice(h.as_slice());
        h /= (h.column(0).norm() * h.column(1).norm()).sqrt();
        if h[(2, 2)] < 0.0 {
            h = -h;
        }
        let (a, b): (Vector3<f64>, Vector3<f64>) = (h.column(0).into(), h.column(1).into());
        let Some(rotation) = nearest_rotation(&Matrix3::from_columns(&[a, b, a.cross(&b)])) else {
            return Vec::new();
        };
        let t: Vector3<f64> = h.column(2).into();
        let (normal, sight) = (rotation * Vector3::z(), t.normalize());
        let mirrored = sight * (2.0 * normal.dot(&sight)) - normal;
        let turn = Rotation3::rotation_between(&normal, &mirrored).unwrap_or_default();
        [rotation, turn * rotation].into_iter().map(|r| self.pose(r, t)).collect()
    }

    /// The pose from the direct linear transform.
    fn linear_start(&self) -> Option<Pose> {
        let p = null_vector(&self.equations(|p| vec![p.x, p.y, p.z, 1.0]))?;
        let p = nalgebra::Matrix3x4::from_row_slice(p.as_slice());
        let left: Matrix3<f64> = p.fixed_columns::<3>(0).into();
        let scale = left.determinant().cbrt();
        let rotation = nearest_rotation(&(left / scale))?;
        Some(self.pose(rotation, p.column(3) / scale)).filter(Pose::is_finite)
    }

    /// Two homogeneous equations per point: `h1 . p = x h3 . p`, `h2 . p = y h3 . p`.
    fn equations(&self, homogeneous: impl Fn(&Point3<f64>) -> Vec<f64>) -> DMatrix<f64> {
        let width = homogeneous(&self.local[0]).len();
        let mut a = DMatrix::zeros(2 * self.rays.len(), 3 * width);
        for (k, (ray, point)) in self.rays.iter().zip(&self.local).enumerate() {
            for (j, v) in homogeneous(point).into_iter().enumerate() {
                for (axis, coordinate) in [ray.x, ray.y].into_iter().enumerate() {
                    a[(2 * k + axis, axis * width + j)] = v;
                    a[(2 * k + axis, 2 * width + j)] = -coordinate * v;
                }
            }
        }
        a
    }
}

/// The vector that the equations leave open; `None` if they leave open more than one.
fn null_vector(equations: &DMatrix<f64>) -> Option<DVector<f64>> {
    let eigen = equations.tr_mul(equations).symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let (second, largest) = (eigen.eigenvalues[order[1]], eigen.eigenvalues[order[order.len() - 1]]);
    (second > 1e-13 * largest).then(|| eigen.eigenvectors.column(order[0]).into_owned())
}

#[cfg(test)]
#[path = "pnp_tests.rs"]
mod tests;
