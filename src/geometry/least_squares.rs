//! Levenberg-Marquardt for small problems: a handful of unknowns on any manifold, derivatives by central differences.

use nalgebra::{DMatrix, DVector};

/// Step of the central differences, in the unit of the unknowns (metres, radians).
const DIFFERENCE: f64 = 1e-6;
const MAX_STEPS: usize = 200;
const FIRST_DAMPING: f64 = 1e-3;
const LARGEST_DAMPING: f64 = 1e10;

/// The end of a minimisation.
#[derive(Debug, Clone)]
pub(super) struct Fit<S> {
    /// The unknowns.
    pub(super) state: S,
    /// Residuals there.
    pub(super) residuals: DVector<f64>,
    /// `J^T J` there, by the increments of `retract`.
    pub(super) normal: DMatrix<f64>,
}

/// Minimises the sum of squared residuals over the increments (`dof` of them) that `retract` applies to a state.
/// `None` if the residuals cannot be computed at the start or the problem is singular.
pub(super) fn minimise<S: Clone>(
    start: S,
    dof: usize,
    retract: impl Fn(&S, &DVector<f64>) -> S,
    residuals: impl Fn(&S) -> Option<DVector<f64>>,
) -> Option<Fit<S>> {
    let mut state = start;
    let mut current = residuals(&state)?;
    let mut damping = FIRST_DAMPING;
    for _ in 0..MAX_STEPS {
        let jacobian = jacobian_at(&state, dof, &retract, &residuals)?;
        let (normal, gradient) = (jacobian.tr_mul(&jacobian), jacobian.tr_mul(&current));
        let mut moved = false;
        while damping < LARGEST_DAMPING {
            let step = solve(&normal, &gradient, damping)?;
            let next = retract(&state, &step);
            let candidate = residuals(&next);
            if let Some(r) = candidate.filter(|r| r.norm_squared() < current.norm_squared()) {
                moved = step.norm() > 1e-13
                    && current.norm_squared() - r.norm_squared() > 1e-15 * r.norm_squared();
                (state, current) = (next, r);
                damping = (damping / 10.0).max(1e-12);
                break;
            }
            damping *= 10.0;
        }
        if !moved {
            break;
        }
    }
    let jacobian = jacobian_at(&state, dof, &retract, &residuals)?;
    let normal = jacobian.tr_mul(&jacobian);
    normal.iter().all(|v| v.is_finite()).then_some(Fit { state, residuals: current, normal })
}

fn jacobian_at<S>(
    state: &S,
    dof: usize,
    retract: &impl Fn(&S, &DVector<f64>) -> S,
    residuals: &impl Fn(&S) -> Option<DVector<f64>>,
) -> Option<DMatrix<f64>> {
    let column = |k: usize| {
        let mut step = DVector::zeros(dof);
        step[k] = DIFFERENCE;
        let (ahead, behind) = (residuals(&retract(state, &step))?, residuals(&retract(state, &-step))?);
        Some((ahead - behind) / (2.0 * DIFFERENCE))
    };
    let columns: Option<Vec<DVector<f64>>> = (0..dof).map(column).collect();
    Some(DMatrix::from_columns(&columns?))
}

/// Damped step with the unknowns scaled to a unit diagonal.
fn solve(normal: &DMatrix<f64>, gradient: &DVector<f64>, damping: f64) -> Option<DVector<f64>> {
    let scale = normal.diagonal().map(|d| 1.0 / d.sqrt());
    if scale.iter().any(|s| !s.is_finite()) {
        return None;
    }
    let mut scaled =
        DMatrix::from_fn(normal.nrows(), normal.ncols(), |i, j| normal[(i, j)] * scale[i] * scale[j]);
    for k in 0..scaled.nrows() {
        scaled[(k, k)] += damping;
    }
    let step = scaled.cholesky()?.solve(&gradient.component_mul(&scale));
    Some(-step.component_mul(&scale))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley, whose minimum (1, 1) is hard to reach for a plain descent.
    #[test]
    fn finds_the_end_of_a_bent_valley() {
        let valley =
            |p: &DVector<f64>| Some(DVector::from_vec(vec![10.0 * (p[1] - p[0] * p[0]), 1.0 - p[0]]));
        let fit = minimise(DVector::from_vec(vec![-1.2, 1.0]), 2, |p, d| p + d, valley).unwrap();
        assert!((fit.state - DVector::from_vec(vec![1.0, 1.0])).norm() < 1e-8, "the minimum");
        assert!(fit.residuals.norm() < 1e-8, "{}", fit.residuals);
    }

    #[test]
    fn what_does_not_matter_is_singular() {
        let one = |p: &DVector<f64>| Some(DVector::from_vec(vec![p[0] - 1.0]));
        assert!(minimise(DVector::zeros(2), 2, |p, d| p + d, one).is_none(), "the second unknown is free");
        assert!(
            minimise(DVector::zeros(1), 1, |p: &DVector<f64>, d| p + d, |_| None).is_none(),
            "no residuals"
        );
    }
}
