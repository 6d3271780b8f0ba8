//! Hand-eye calibration: where the camera sits on the end-effector, from robot poses and object poses.
//!
//! Between two frames the end-effector moves by A, the camera by B, and `A X = X B` with X = `effector_from_camera`.
//! Rotation first, in closed form (Park and Martin, IEEE Trans. Robotics and Automation 10, 1994), then the
//! translation by linear least squares, then all frames together by nonlinear least squares.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::Pose;
use super::least_squares::minimise;
use super::rigid_fit::nearest_rotation;
use crate::error::{Error, Result};

/// Fewest poses: three motions between successive ones.
const MIN_POSES: usize = 4;
/// The motions must turn about a second axis by at least this much (rms), radians.
const MIN_SECOND_TURN: f64 = 1.0 * std::f64::consts::PI / 180.0;
/// They must turn about it by at least this share of the turn about the first.
const MIN_SECOND_SHARE: f64 = 0.03;

/// A calibrated hand-eye transform.
#[derive(Debug, Clone, PartialEq)]
pub struct HandEye {
    /// Camera on the end-effector, metres; the paper's eHc, eq. (20).
    pub effector_from_camera: Pose,
    /// The stationary object in the robot's base, metres.
    pub base_from_object: Pose,
    /// Per frame, what robot and camera disagree about.
    pub residuals: Vec<Residual>,
}

/// Pose seen by the camera against the pose that robot and calibration give.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// Position of the object, camera axes, metres.
    pub translation: Vector3<f64>,
    /// Rotation vector of `R_seen R_predicted^T`, camera axes, radians.
    pub rotation: Vector3<f64>,
}

/// Closed form followed by the refinement; `base_from_effector` and `camera_from_object` hold the same frames in the
/// same order.
///
/// # Errors
/// [`Error::Invalid`] for unequal counts, fewer than three motions, or rotations about (nearly) parallel axes, which
/// leave the camera's position along the axis open.
pub fn calibrate(base_from_effector: &[Pose], camera_from_object: &[Pose]) -> Result<HandEye> {
    let start = closed_form(base_from_effector, camera_from_object)?;
    refine(base_from_effector, camera_from_object, &start)
}

/// Park and Martin's solution over all pairs of frames; the object's place is the mean over the frames.
///
/// # Errors
/// As [`calibrate`].
pub fn closed_form(base_from_effector: &[Pose], camera_from_object: &[Pose]) -> Result<HandEye> {
    check(base_from_effector, camera_from_object)?;
    let motions = motions(base_from_effector, camera_from_object);
    check_axes(&motions)?;
    // R log(B) = log(A), least squares over all motions.
    let m = motions
        .iter()
        .fold(Matrix3::zeros(), |m, (a, b)| m + a.rotation_vector() * b.rotation_vector().transpose());
    let open = || refused("the rotations leave the camera's orientation open", AXES_REMEDY);
    let rotation = nearest_rotation(&m).ok_or_else(open)?;
    // (R_A - I) t = R t_B - t_A.
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (a, b) in &motions {
        let left = a.rotation() - Matrix3::identity();
        normal += left.tr_mul(&left);
        right += left.tr_mul(&(rotation * b.translation() - a.translation()));
    }
    let translation = normal.try_inverse().ok_or_else(open)? * right;
    let effector_from_camera = Pose::new(rotation, translation);
    let base_from_object = mean(&predicted(base_from_effector, camera_from_object, &effector_from_camera));
    Ok(hand_eye(base_from_effector, camera_from_object, effector_from_camera, base_from_object))
}

const AXES_REMEDY: &str =
    "turn the end-effector about two axes that are not parallel, by 10 degrees or more about each";

fn refused(problem: impl Into<String>, remedy: &str) -> Error {
    Error::invalid("hand-eye calibration", problem, remedy)
}

fn check(base_from_effector: &[Pose], camera_from_object: &[Pose]) -> Result<()> {
    let (n, m) = (base_from_effector.len(), camera_from_object.len());
    if n != m {
        let problem = format!("{n} robot poses, but {m} object poses");
        return Err(refused(problem, "give one of each per frame"));
    }
    if n < MIN_POSES {
        let problem = format!("{n} poses make {} motions", n.saturating_sub(1));
        return Err(refused(problem, "give at least 4 poses (3 motions)"));
    }
    let poses = base_from_effector.iter().zip(camera_from_object);
    match poses.into_iter().position(|(a, b)| !(a.is_finite() && b.is_finite())) {
        Some(k) => Err(refused(format!("pose {k} is not finite"), "give finite numbers")),
        None => Ok(()),
    }
}

/// (A, B) of every pair of frames.
fn motions(base_from_effector: &[Pose], camera_from_object: &[Pose]) -> Vec<(Pose, Pose)> {
    let n = base_from_effector.len();
    let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
    pairs
        .map(|(i, j)| {
            let a = base_from_effector[j].inverse().compose(&base_from_effector[i]);
            (a, camera_from_object[j].compose(&camera_from_object[i].inverse()))
        })
        .collect()
}

/// The rotation vectors of robot and camera must span at least a plane.
fn check_axes(motions: &[(Pose, Pose)]) -> Result<()> {
    for (who, side) in [("end-effector", 0), ("camera", 1)] {
        let turns = motions.iter().map(|m| if side == 0 { m.0 } else { m.1 }.rotation_vector());
        let scatter = turns.fold(Matrix3::zeros(), |s, v| s + v * v.transpose());
        let mut sizes: Vec<f64> = scatter.symmetric_eigenvalues().iter().map(|v| v.max(0.0).sqrt()).collect();
        sizes.sort_by(|a, b| b.total_cmp(a));
        #[expect(clippy::cast_precision_loss, reason = "counts are small")]
        let second = sizes[1] / (motions.len() as f64).sqrt();
        if second < MIN_SECOND_TURN || sizes[1] < MIN_SECOND_SHARE * sizes[0] {
            let problem = format!(
                "the {who} turns about parallel axes (only {:.2} degrees rms about any second axis)",
                second.to_degrees()
            );
            return Err(refused(problem, AXES_REMEDY));
        }
    }
    Ok(())
}

/// The object in the base by every frame.
fn predicted(base_from_effector: &[Pose], camera_from_object: &[Pose], x: &Pose) -> Vec<Pose> {
    base_from_effector.iter().zip(camera_from_object).map(|(e, c)| e.compose(x).compose(c)).collect()
}

/// Mean of poses that are close to each other.
fn mean(poses: &[Pose]) -> Pose {
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    let n = poses.len() as f64;
    let translation = poses.iter().fold(Vector3::zeros(), |s, p| s + p.translation()) / n;
    let sum = poses.iter().fold(Matrix3::zeros(), |s, p| s + p.rotation());
    let rotation = nearest_rotation(&sum).unwrap_or_default();
    Pose::new(rotation, translation)
}

fn residual(seen: &Pose, base_from_effector: &Pose, x: &Pose, y: &Pose) -> Residual {
    let expected = x.inverse().compose(&base_from_effector.inverse()).compose(y);
    Residual {
        translation: seen.translation() - expected.translation(),
        rotation: (seen.quaternion() * expected.quaternion().inverse()).scaled_axis(),
    }
}

fn hand_eye(base_from_effector: &[Pose], camera_from_object: &[Pose], x: Pose, y: Pose) -> HandEye {
    let frames = base_from_effector.iter().zip(camera_from_object);
    HandEye {
        effector_from_camera: x,
        base_from_object: y,
        residuals: frames.map(|(e, c)| residual(c, e, &x, &y)).collect(),
    }
}

/// What the robot's pose is off by, in its own axes: translation (metres) and rotation vector (radians). Kinematic
/// errors are independent there; seen at the object, a small rotation would be a large translation as well.
fn kinematic(seen: &Pose, base_from_effector: &Pose, x: &Pose, y: &Pose) -> [Vector3<f64>; 2] {
    let expected = y.compose(&seen.inverse()).compose(&x.inverse());
    let off = base_from_effector.inverse().compose(&expected);
    [off.translation(), off.rotation_vector()]
}

/// Least squares of the robot's errors in all frames over both transforms. Translations and rotations are weighed by
/// their own scatter, estimated again three times (two variance components).
///
/// # Errors
/// [`Error::Invalid`] if the frames leave the transforms open.
pub fn refine(base_from_effector: &[Pose], camera_from_object: &[Pose], start: &HandEye) -> Result<HandEye> {
    check(base_from_effector, camera_from_object)?;
    let mut state = (start.effector_from_camera, start.base_from_object);
    for _ in 0..3 {
        let errors = |(x, y): &(Pose, Pose)| -> Vec<[Vector3<f64>; 2]> {
            let frames = base_from_effector.iter().zip(camera_from_object);
            frames.map(|(e, c)| kinematic(c, e, x, y)).collect()
        };
        let now = errors(&state);
        // Exact poses have no scatter: a micrometre and a microradian then weigh the same.
        let weights = [0, 1].map(|part| {
            #[expect(clippy::cast_precision_loss, reason = "counts are small")]
            let n = now.len() as f64;
            1.0 / (now.iter().map(|e| e[part].norm_squared()).sum::<f64>() / n).sqrt().max(1e-6)
        });
        let residuals = |state: &(Pose, Pose)| {
            let rows = errors(state).into_iter().flat_map(|[t, r]| {
                let (t, r) = (t * weights[0], r * weights[1]);
                [t.x, t.y, t.z, r.x, r.y, r.z]
            });
            Some(DVector::from_iterator(6 * base_from_effector.len(), rows))
        };
        let retract = |(x, y): &(Pose, Pose), d: &DVector<f64>| {
            let step = |k: usize| {
                let rotation = nalgebra::Rotation3::new(Vector3::new(d[k + 3], d[k + 4], d[k + 5]));
                Pose::new(rotation, Vector3::new(d[k], d[k + 1], d[k + 2]))
            };
            (x.compose(&step(0)), y.compose(&step(6)))
        };
        state = minimise(state, 12, retract, residuals)
            .filter(|fit| is_regular(&fit.normal))
            .ok_or_else(|| refused("the frames leave the transforms open", AXES_REMEDY))?
            .state;
    }
    Ok(hand_eye(base_from_effector, camera_from_object, state.0, state.1))
}

fn is_regular(normal: &DMatrix<f64>) -> bool {
    normal.clone().cholesky().is_some()
}

#[cfg(test)]
#[path = "hand_eye_tests.rs"]
mod tests;
