//! After a jump: many image shifts of the predicted pose, scored at the coarsest level in one batch, the best of them
//! aligned. The pyramid alone does not reach that far.

use nalgebra::{Vector2, Vector3};

use super::evaluator::{Evaluator, Sight};
use super::inverse_compositional::InverseCompositional;
use super::levenberg_marquardt::{Descent, State};
use super::normal_equations::{LevelProblem, Rows, cost};
use super::photometric::Solution;
use super::visibility::visibility;
use super::workspace::Workspace;
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
        work: &mut Workspace,
    ) -> Result<PoseEstimate> {
        let coarsest = LEVEL.min(target.model.levels.len() - 1);
        let promising = self.promising(backend, target, around, coarsest, work)?;
        work.begin(&promising);
        // Occlusion is the business of full size: robust weights on coarse levels cost reach.
        let finest = 1.min(coarsest);
        self.coarse_to_fine(backend, std::slice::from_ref(target), (finest..=coarsest).rev(), None, work)?;
        let problem = self.problem(target, finest);
        let row_len = Sums::row_len(target.model.modes());
        let Workspace { descents, workers, .. } = work;
        let scratch = &mut workers[0].scratch;
        let mut misfit = |d: &Descent| {
            let rows = Rows { data: &d.look.rows, row_len };
            misfit(&problem, &d.steps.state.appearance, &rows, &d.look.visibility, &mut scratch.solutions)
        };
        let misfits: Vec<f64> = descents.iter().map(&mut misfit).collect();
        let best = descents.iter().zip(misfits).min_by(|(_, a), (_, b)| a.total_cmp(b));
        let start = best.map_or_else(|| around.clone(), |(d, _)| start_of(&d.steps.state));
        work.begin(&[start]);
        self.coarse_to_fine(backend, std::slice::from_ref(target), (0..=finest).rev(), Some(finest), work)?;
        let mut estimates = Vec::new();
        work.finish(backend, std::slice::from_ref(target), &mut estimates)?;
        Ok(estimates.remove(0))
    }

    /// The start and the shifts of it that fit best.
    fn promising(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        around: &Start,
        level: usize,
        work: &mut Workspace,
    ) -> Result<Vec<Start>> {
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
        let Workspace { evaluation, workers, .. } = work;
        let mut evaluator = Evaluator::new(backend, std::slice::from_ref(target), &problem, evaluation);
        evaluator.evaluate(states.iter().map(|state| Sight::new(state, &visible)))?;
        let solutions = &mut workers[0].scratch.solutions;
        let misfits: Vec<f64> = (0..states.len())
            .map(|k| misfit(&problem, &around.appearance, &evaluator.rows(k), &visible, solutions))
            .collect();
        let mut order: Vec<usize> = (0..states.len()).collect();
        order.sort_by(|&a, &b| misfits[a].total_cmp(&misfits[b]));
        let mut kept: Vec<usize> = Vec::new();
        for k in order {
            if kept.len() < KEPT && kept.iter().all(|&j| (shifts[k] - shifts[j]).norm() >= APART_PX) {
                kept.push(k);
            }
        }
        let chosen = kept.into_iter().map(|k| start_of(&states[k]));
        Ok(std::iter::once(around.clone()).chain(chosen).collect())
    }
}

fn start_of(state: &State) -> Start {
    Start { camera_from_object: state.pose, appearance: state.appearance.clone() }
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
fn misfit(
    problem: &LevelProblem<'_>,
    appearance: &[f64],
    rows: &Rows<'_>,
    visibility: &[f64],
    solutions: &mut Vec<Solution>,
) -> f64 {
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
    cost(problem, appearance, rows, visibility, solutions).0 * inside / variance
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
