//! Does a tracker know how wrong it is? Errors in units of the covariance that came with them.

use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

use super::statistics::{mean, median};
use crate::geometry::Pose;

/// Statistics of the normalised error squared over the tracked frames; 6 on average for an honest covariance.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct NormalisedError {
    /// Mean.
    pub mean: Option<f64>,
    /// Median; 5.3 for Gaussian errors.
    pub median: Option<f64>,
}

impl NormalisedError {
    /// Statistics of single values.
    pub fn of(values: &[f64]) -> Self {
        Self { mean: mean(values), median: median(values) }
    }
}

/// Normalised error squared e^T C^-1 e of one pose (`camera_from_object`, metres). The covariance is in ROS order, x y
/// z rotX rotY rotZ: metres and radians, fixed axes of the camera frame. `None` if it is singular (unknown).
pub fn normalised_error_squared(estimate: &Pose, truth: &Pose, covariance: &Matrix6<f64>) -> Option<f64> {
    let turn = truth.compose(&estimate.inverse()).rotation_vector();
    let shift = truth.translation() - estimate.translation();
    let error = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
    Some(error.dot(&covariance.cholesky()?.solve(&error)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_standard_deviation_per_axis_gives_six() {
        let truth = Pose::from_params(&Vector6::new(0.1, -0.2, 0.6, 0.3, 0.2, -0.1));
        let sigma = Vector6::new(1e-4, 1e-4, 1e-3, 1e-4, 1e-4, 1e-5);
        let turn = nalgebra::Rotation3::new(sigma.fixed_rows::<3>(3).into_owned());
        let rotation = turn * nalgebra::Rotation3::from_matrix_unchecked(truth.rotation());
        let estimate = Pose::new(rotation, truth.translation() + sigma.fixed_rows::<3>(0));
        let covariance = Matrix6::from_diagonal(&sigma.component_mul(&sigma));
        let value = normalised_error_squared(&estimate, &truth, &covariance).expect("regular");
        assert!((value - 6.0).abs() < 1e-6, "{value}");
        assert!(
            normalised_error_squared(&estimate, &truth, &Matrix6::zeros()).is_none(),
            "unknown covariance"
        );
    }
}
