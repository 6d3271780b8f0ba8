//! Predictions are picked up; from those that went astray the default method descends again, in other ways.

use super::inverse_compositional::{COARSEST_ROBUST, InverseCompositional, TRACKED};
use super::workspace::Workspace;
use super::{PoseEstimate, Start, Target};
use crate::backend::Backend;
use crate::error::Result;

/// A further descent from a prediction.
struct Retry {
    /// Coarsest level, and coarsest with triangle weights.
    levels: (usize, usize),
    /// Is it also for ends that did not converge, or only for those that are lost?
    unconverged: bool,
}

/// What covers much of the object leads a descent astray that trusts everything on its coarse levels: first without those,
/// since a prediction is mostly right to a pixel or two, then with weights on all.
const RETRIES: [Retry; 2] = [
    Retry { levels: (COARSEST_ROBUST, COARSEST_ROBUST), unconverged: true },
    Retry { levels: (usize::MAX, usize::MAX), unconverged: false },
];

impl InverseCompositional {
    /// Picks up predictions, and those that went astray again as [`RETRIES`] says; an end that fits better takes the place
    /// of the first.
    pub(super) fn picked_up(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
        work: &mut Workspace,
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        self.descend(backend, target, TRACKED, starts, work, estimates)?;
        for Retry { levels, unconverged } in RETRIES.into_iter().filter(|_| self.options.robust) {
            let is_astray = |end: &PoseEstimate| end.score.is_lost() || (unconverged && !end.converged);
            let astray: Vec<usize> = (0..starts.len()).filter(|&i| is_astray(&estimates[i])).collect();
            if astray.is_empty() {
                continue;
            }
            let again: Vec<Start> = astray.iter().map(|&i| starts[i].clone()).collect();
            let (before, mut ends) = (work.times, Vec::new());
            self.descend(backend, target, levels, &again, work, &mut ends)?;
            work.times += before;
            for (i, end) in astray.into_iter().zip(ends) {
                let iterations = estimates[i].iterations + end.iterations;
                if end.score.correlation > estimates[i].score.correlation {
                    estimates[i] = end;
                }
                estimates[i].iterations = iterations;
            }
        }
        Ok(())
    }
}
