//! The rigid transform between two sets of corresponding points (Kabsch, Acta Cryst. A32, 1976).

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

use super::Pose;
use crate::error::{Error, Result};

/// Mean of points; the origin for none.
pub(super) fn centroid(points: &[Point3<f64>]) -> Point3<f64> {
    let sum = points.iter().fold(Vector3::zeros(), |s, p| s + p.coords);
    #[expect(clippy::cast_precision_loss, reason = "point counts are far below 2^52")]
    Point3::from(sum / points.len().max(1) as f64)
}

/// The rotation nearest to a matrix, and whether it is determined (at most one vanishing singular value).
pub(super) fn nearest_rotation(m: &Matrix3<f64>) -> Option<Rotation3<f64>> {
    let svd = m.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // Written so that NaN is not determined.
    let determined = svd.singular_values[1] > 1e-9 * svd.singular_values[0];
    if !determined {
        return None;
    }
    let sign = (u * v_t).determinant().signum();
    Some(Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t))
}

/// `to_from_from` with the least squares of `to - pose * from`, and its root mean square, metres.
///
/// # Errors
/// [`Error::Invalid`] for unequal counts, fewer than three points, or points on one line.
pub fn rigid_fit(from: &[Point3<f64>], to: &[Point3<f64>]) -> Result<(Pose, f64)> {
    let refuse = |problem: String| {
        Err(Error::invalid("points", problem, "give at least three pairs that are not on one line"))
    };
    if from.len() != to.len() || from.len() < 3 {
        return refuse(format!("{} points against {}", from.len(), to.len()));
    }
    let (a, b) = (centroid(from), centroid(to));
    let m = from.iter().zip(to).fold(Matrix3::zeros(), |m, (f, t)| m + (t - b) * (f - a).transpose());
    let Some(rotation) = nearest_rotation(&m) else { return refuse("they lie on one line".into()) };
    let pose = Pose::new(rotation, b.coords - rotation * a.coords);
    let squares: f64 = from.iter().zip(to).map(|(f, t)| (t - pose.transform_point(f)).norm_squared()).sum();
    #[expect(clippy::cast_precision_loss, reason = "point counts are far below 2^52")]
    Ok((pose, (squares / from.len() as f64).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_comes_back_and_lines_are_refused() {
        let points: Vec<_> =
            [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0]].map(Point3::from).into_iter().collect();
        let pose = Pose::new(Rotation3::new(Vector3::new(0.3, -2.0, 0.7)), Vector3::new(0.1, 0.2, 0.3));
        let moved: Vec<_> = points.iter().map(|p| pose.transform_point(p)).collect();
        let (found, rms) = rigid_fit(&points, &moved).unwrap();
        assert!((found.matrix() - pose.matrix()).norm() < 1e-12 && rms < 1e-12, "{}", found.matrix());
        let line: Vec<_> = (0..5).map(|k| Point3::new(f64::from(k), 2.0 * f64::from(k), 0.0)).collect();
        assert!(rigid_fit(&line, &line).is_err(), "a line");
        assert!(rigid_fit(&points, &moved[1..]).is_err(), "unequal counts");
    }
}
