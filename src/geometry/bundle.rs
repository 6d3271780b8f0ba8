//! Bundle adjustment: points that are known with a covariance, and poses of images that show all of them, together.
//!
//! Minimises over poses `P_i` and points `X_k` the squared deviations, each in units of its standard deviation:
//!
//! ```text
//! E = sum_ik |W_ik (project(P_i X_k) - u_ik)|^2 + sum_k (X_k - X0_k)^T C_k^-1 (X_k - X0_k)
//! ```
//!
//! with pixels `u_ik`, their covariance `(W^T W)^-1` (square pixels) and the prior `X0_k`, `C_k` (metres, square metres).
//! The unknowns of a point are `w` in `X = X0 + L w`, `L L^T = C`: its prior is `|w|^2`, and an exact point (`C = 0`)
//! stays. The poses are free; the object frame is where the prior likes it best. Levenberg-Marquardt; the points are
//! eliminated (Schur complement), so the system has 6 unknowns per image.

mod equations;

use nalgebra::{Matrix2, Matrix3, Matrix6, Matrix6x3, Point2, Point3, SMatrix, Vector3, Vector6};

use super::pose::skew;
use super::rigid_fit::centroid;
use super::{Camera, Pose};
use crate::error::{Error, Result};
use equations::{Equations, Step};

const MAX_STEPS: usize = 100;
const FIRST_DAMPING: f64 = 1e-3;
const LARGEST_DAMPING: f64 = 1e10;
/// A step that lowers the cost by a smaller share than this is the last.
const CONVERGED: f64 = 1e-12;

/// A point as it is known before the images are looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Position, metres.
    pub position: Point3<f64>,
    /// Covariance, square metres; zero: exact.
    pub covariance: Matrix3<f64>,
}

/// Where a point was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Pixel in the image as taken.
    pub pixel: Point2<f64>,
    /// `W`, `W^T W` being the inverse of the pixel's covariance: 1/pixels; zero where the point was not seen.
    pub whitening: Matrix2<f64>,
}

impl Mark {
    /// A pixel with the same standard deviation in both coordinates, pixels.
    pub fn new(pixel: Point2<f64>, sigma_px: f64) -> Self {
        Self { pixel, whitening: Matrix2::identity() / sigma_px }
    }

    /// Of a point that was not seen.
    pub fn unseen() -> Self {
        Self { pixel: Point2::origin(), whitening: Matrix2::zeros() }
    }

    fn is_finite(&self) -> bool {
        self.pixel.iter().chain(&self.whitening).all(|v| v.is_finite())
    }
}

/// An image of the points.
#[derive(Debug, Clone, PartialEq)]
pub struct Sighting {
    /// The camera, with its lens.
    pub camera: Camera,
    /// First guess of the pose.
    pub camera_from_object: Pose,
    /// One per point.
    pub marks: Vec<Mark>,
}

/// Points and poses that fit together.
#[derive(Debug, Clone, PartialEq)]
pub struct Bundle {
    /// The points with what is left of their covariance.
    pub points: Vec<Prior>,
    /// `camera_from_object` of every image.
    pub poses: Vec<Pose>,
}

/// Refines points and poses together.
///
/// # Errors
/// [`Error::Invalid`] for no image, fewer than 4 points, unequal counts, numbers that are not finite, a matrix that is
/// no covariance, points behind a camera, and images whose pose is left open.
pub fn refine(points: &[Prior], sightings: &[Sighting]) -> Result<Bundle> {
    let problem = Problem::new(points, sightings)?;
    let mut state = State {
        w: vec![Vector3::zeros(); points.len()],
        poses: sightings.iter().map(|s| s.camera_from_object).collect(),
    };
    let Some(mut cost) = problem.cost(&state) else {
        return Err(refused("a point is behind the camera", "check the first poses"));
    };
    let mut damping = FIRST_DAMPING;
    for _ in 0..MAX_STEPS {
        let equations = problem.linearise(&state);
        let mut gain = 0.0;
        while gain == 0.0 && damping < LARGEST_DAMPING {
            let next = equations.step(damping).map(|step| problem.moved(&state, &step));
            match next.and_then(|n| Some((problem.cost(&n)?, n))).filter(|(c, _)| *c < cost) {
                Some((lower, next)) => {
                    gain = (cost - lower) / cost;
                    (cost, state) = (lower, next);
                    damping = (damping / 10.0).max(1e-12);
                }
                None => damping *= 10.0,
            }
        }
        if gain < CONVERGED {
            break;
        }
    }
    problem.finish(state)
}

fn refused(problem: impl Into<String>, remedy: &str) -> Error {
    Error::invalid("bundle adjustment", problem, remedy)
}

struct Problem<'a> {
    points: &'a [Prior],
    sightings: &'a [Sighting],
    /// `L` of every point, metres.
    roots: Vec<Matrix3<f64>>,
    /// Rotations are about this point.
    centre: Point3<f64>,
}

struct State {
    w: Vec<Vector3<f64>>,
    poses: Vec<Pose>,
}

impl<'a> Problem<'a> {
    fn new(points: &'a [Prior], sightings: &'a [Sighting]) -> Result<Self> {
        if sightings.is_empty() || points.len() < 4 {
            let problem = format!("{} points in {} images", points.len(), sightings.len());
            return Err(refused(problem, "give at least 4 points and one image"));
        }
        for (i, sighting) in sightings.iter().enumerate() {
            let finite =
                sighting.marks.iter().all(Mark::is_finite) && sighting.camera_from_object.is_finite();
            let count = sighting.marks.len();
            if count != points.len() || !finite {
                let problem = if finite { "the counts differ" } else { "a mark or the pose is not finite" };
                let problem = format!("image {i}: {} points, {count} marks: {problem}", points.len());
                let remedy =
                    "give a finite pose and per point one finite pixel with a standard deviation above 0";
                return Err(refused(problem, remedy));
            }
        }
        let roots: Option<Vec<Matrix3<f64>>> = points.iter().map(|p| root(&p.covariance)).collect();
        let finite = points.iter().all(|p| p.position.iter().all(|v| v.is_finite()));
        let Some(roots) = roots.filter(|_| finite) else {
            let problem = "a position is not finite or a matrix is no covariance";
            return Err(refused(problem, "give finite positions and symmetric, non-negative matrices"));
        };
        let centre = centroid(&points.iter().map(|p| p.position).collect::<Vec<_>>());
        Ok(Self { points, sightings, roots, centre })
    }

    fn point(&self, state: &State, k: usize) -> Point3<f64> {
        self.points[k].position + self.roots[k] * state.w[k]
    }

    /// `E`; `None` if a point is behind a camera.
    fn cost(&self, state: &State) -> Option<f64> {
        let mut cost: f64 = state.w.iter().map(Vector3::norm_squared).sum();
        for k in 0..self.points.len() {
            let x = self.point(state, k);
            for (sighting, pose) in self.sightings.iter().zip(&state.poses) {
                let mark = &sighting.marks[k];
                let off = sighting.camera.project(&pose.transform_point(&x))? - mark.pixel;
                cost += (mark.whitening * off).norm_squared();
            }
        }
        cost.is_finite().then_some(cost)
    }

    fn linearise(&self, state: &State) -> Equations {
        let (images, points) = (self.sightings.len(), self.points.len());
        let mut e = Equations {
            pose: vec![Matrix6::zeros(); images],
            pose_gradient: vec![Vector6::zeros(); images],
            point: vec![Matrix3::identity(); points],
            point_gradient: state.w.clone(),
            mixed: vec![vec![Matrix6x3::zeros(); points]; images],
        };
        for k in 0..points {
            let x = self.point(state, k);
            // P (c + R(r) (X - c) + t) by t, r and w.
            let lever = -skew(&(x - self.centre));
            for (i, (sighting, pose)) in self.sightings.iter().zip(&state.poses).enumerate() {
                let seen = pose.transform_point(&x);
                let Some(pixel) = sighting.camera.project(&seen) else { continue };
                let Mark { pixel: seen_at, whitening } = sighting.marks[k];
                let residual = whitening * (pixel - seen_at);
                let by_x = whitening * sighting.camera.project_jacobian(&seen) * pose.rotation();
                let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
                by_pose.fixed_columns_mut::<3>(0).copy_from(&by_x);
                by_pose.fixed_columns_mut::<3>(3).copy_from(&(by_x * lever));
                let by_w = by_x * self.roots[k];
                e.pose[i] += by_pose.tr_mul(&by_pose);
                e.pose_gradient[i] += by_pose.tr_mul(&residual);
                e.point[k] += by_w.tr_mul(&by_w);
                e.point_gradient[k] += by_w.tr_mul(&residual);
                e.mixed[i][k] = by_pose.tr_mul(&by_w);
            }
        }
        e
    }

    fn moved(&self, state: &State, step: &Step) -> State {
        let pose = |(pose, d): (&Pose, &Vector6<f64>)| {
            pose.compose(&Pose::about(d.fixed_rows::<3>(3).into(), d.fixed_rows::<3>(0).into(), &self.centre))
        };
        State {
            w: state.w.iter().zip(&step.w).map(|(w, d)| w + d).collect(),
            poses: state.poses.iter().zip(&step.poses).map(pose).collect(),
        }
    }

    fn finish(&self, state: State) -> Result<Bundle> {
        let Some(left) = self.linearise(&state).covariances() else {
            return Err(refused("the points leave a pose open", "give points that are not on one line"));
        };
        let covariance = |k: usize| self.roots[k] * left[k] * self.roots[k].transpose();
        let point = |k| Prior { position: self.point(&state, k), covariance: covariance(k) };
        Ok(Bundle { points: (0..left.len()).map(point).collect(), poses: state.poses })
    }
}

/// `L` with `L L^T = C`; `None` if the matrix is no covariance.
fn root(covariance: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let size = covariance.abs().max();
    let symmetric = (covariance - covariance.transpose()).abs().max() <= 1e-6 * size;
    if !size.is_finite() || !symmetric {
        return None;
    }
    let eigen = ((covariance + covariance.transpose()) / 2.0).symmetric_eigen();
    let valid = eigen.eigenvalues.min() >= -1e-6 * size;
    let roots = eigen.eigenvalues.map(|v| v.max(0.0).sqrt());
    valid.then(|| eigen.eigenvectors * Matrix3::from_diagonal(&roots))
}

#[cfg(test)]
#[path = "bundle/tests.rs"]
mod tests;
