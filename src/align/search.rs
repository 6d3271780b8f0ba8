//! After a jump: many image shifts of the predicted pose, scored at the coarsest level in one batch, the best of them
//! aligned. The pyramid alone does not reach that far.

use nalgebra::{Vector2, Vector3};

use super::evaluator::{End, Evaluator, finish, visibility};
use super::inverse_compositional::InverseCompositional;
use super::levenberg_marquardt::State;
use super::normal_equations::{LevelProblem, Rows, cost};
use super::{PoseEstimate, Start, Target};
use crate::backend::{Backend, Sums};
use crate::error::Result;
use crate::geometry::Pose;

/// Pyramid level on which shifts are scored.
const LEVEL: usize = 3;
/// Shifts reach this far, pixels at full size.
const RADIUS_PX: f64 = 72.0;
/// Distance of neighbouring shifts, pixels at full size.
const STEP_PX: f64 = 8.0;
/// Shifts that are aligned are at least this far apart, pixels at full size.
const APART_PX: f64 = 20.0;
/// So many shifts are aligned, besides the prediction itself.
const KEPT: usize = 10;

impl InverseCompositional {
    /// The best estimate reached from the start pose and from shifts of it.
    pub(super) fn shift_search(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        around: &Start,
    ) -> Result<PoseEstimate> {
        let coarsest = LEVEL.min(target.model.levels.len() - 1);
        let states = self.promising(backend, target, around, coarsest)?;
        // Occlusion is the business of full size: robust weights on coarse levels cost reach.
        let finest = 1.min(coarsest);
        let descents = self.coarse_to_fine(backend, target, (finest..=coarsest).rev(), None, states)?;
        let problem = self.problem(target, finest);
        let row_len = Sums::row_len(target.model.modes());
        let misfit = |d: &super::inverse_compositional::Descended| {
            let rows = Rows { data: &d.last.rows, row_len };
            misfit(&problem, &d.last.state.appearance, &rows, &d.last.visibility)
        };
        let best = descents.iter().min_by(|a, b| misfit(a).total_cmp(&misfit(b)));
        let state =
            best.map_or_else(|| state_at(around, around.camera_from_object), |d| d.last.state.clone());
        let end = self.coarse_to_fine(backend, target, (0..=finest).rev(), Some(finest), vec![state])?;
        Ok(finish(backend, target, end.into_iter().map(End::from).collect())?.remove(0))
    }

    /// The start and the shifts of it that fit best.
    fn promising(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        around: &Start,
        level: usize,
    ) -> Result<Vec<State>> {
        let start = around.camera_from_object;
        let depth = start.transform_point(&target.model.shape.centre).z;
        let metres_per_px = Vector2::new(depth / target.camera.fx, depth / target.camera.fy);
        let shifts = disc();
        let states: Vec<State> = shifts
            .iter()
            .map(|px| {
                let shift = px.component_mul(&metres_per_px);
                let translation = start.translation() + Vector3::new(shift.x, shift.y, 0.0);
                state_at(around, Pose::from_quaternion(start.quaternion(), translation))
            })
            .collect();
        let problem = self.problem(target, level);
        // What is visible hardly depends on the shift.
        let visible = visibility(target, &start);
        let mut evaluator = Evaluator::new(backend, target, &problem);
        evaluator.evaluate(states.iter().map(|s| (s, &visible)))?;
        let misfits: Vec<f64> = (0..states.len())
            .map(|k| misfit(&problem, &around.appearance, &evaluator.rows(k), &visible))
            .collect();
        let mut order: Vec<usize> = (0..states.len()).collect();
        order.sort_by(|&a, &b| misfits[a].total_cmp(&misfits[b]));
        let mut kept: Vec<usize> = Vec::new();
        for k in order {
            if kept.len() < KEPT && kept.iter().all(|&j| (shifts[k] - shifts[j]).norm() >= APART_PX) {
                kept.push(k);
            }
        }
        let chosen = kept.into_iter().map(|k| states[k].clone());
        Ok(std::iter::once(state_at(around, start)).chain(chosen).collect())
    }
}

fn state_at(around: &Start, pose: Pose) -> State {
    State { pose, appearance: around.appearance.clone() }
}

/// Grid points of the disc of shifts, pixels at full size.
fn disc() -> Vec<Vector2<f64>> {
    #[expect(clippy::cast_possible_truncation, reason = "a small constant")]
    let n = (RADIUS_PX / STEP_PX).floor() as i32;
    let grid =
        (-n..=n).flat_map(|v| (-n..=n).map(move |u| Vector2::new(f64::from(u), f64::from(v)) * STEP_PX));
    grid.filter(|p| p.norm() <= RADIUS_PX).collect()
}

/// Residual energy after gain and bias in units of the template's variance; large where little of the object is in the
/// image.
fn misfit(problem: &LevelProblem<'_>, appearance: &[f64], rows: &Rows<'_>, visibility: &[f64]) -> f64 {
    let (mut variance, mut inside, mut all) = (0.0, 0.0, 0.0);
    for (t, moments) in problem.level.moments.iter().enumerate() {
        let weight = visibility[t] * rows.row(t).weight();
        variance += weight * moments.variance();
        inside += weight;
        all += visibility[t] * moments.weight();
    }
    // Less than half of the object in the image is no match, however well it fits.
    if inside < 0.5 * all || variance <= 0.0 {
        return f64::INFINITY;
    }
    cost(problem, appearance, rows, visibility) * inside / variance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shifts_fill_a_disc() {
        let shifts = disc();
        assert_eq!(shifts.len(), 253, "8 px steps within 72 px");
        assert!(shifts.contains(&Vector2::zeros()), "the prediction itself is one of them");
    }
}
