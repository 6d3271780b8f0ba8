//! The end of a search: hypotheses are aligned, and judged by what they explain of the image.

use std::time::Instant;

use rayon::prelude::*;

use super::evidence::Witness;
use super::hypotheses::{self, Hypothesis};
use super::render::Rendering;
use super::{Candidate, Finder, Found, StageReport};
use crate::align::{Aligner, PoseEstimate, Start, Target};
use crate::backend::Backend;
use crate::error::Result;
use crate::geometry::Pose;
use crate::model::Model;

/// A pose with nothing hidden has at least this correlation ([`crate::align::Score`]).
const WHOLE_CORRELATION: f64 = 0.8;
/// Another pose is an ambiguity from this share of what the best one explains on.
const AMBIGUOUS_SHARE: f64 = 0.75;
/// Poses with a larger spread ([`PoseEstimate::spread_px`]) are vague: a tracker calls them uncertain.
const VAGUE_PX: f64 = 1.0;
/// Poses whose corners are this far apart (rms, pixels) are different ones.
const DIFFERENT_PX: f64 = 20.0;

impl Finder {
    /// Aligns hypotheses in full.
    pub(super) fn align(
        &self,
        backend: &mut dyn Backend,
        aligner: &mut dyn Aligner,
        target: &Target<'_>,
        hypotheses: &[Hypothesis],
        candidates: &mut Vec<Candidate>,
        reports: &mut Vec<StageReport>,
    ) -> Result<()> {
        let began = Instant::now();
        let start = |h: &Hypothesis| Start {
            camera_from_object: h.pose,
            appearance: vec![0.0; target.model.modes()],
        };
        let starts: Vec<Start> = hypotheses.iter().map(start).collect();
        let mut estimates = Vec::new();
        aligner.refine(backend, target, &starts, &mut estimates)?;
        // What is not hidden reaches farther from coarser levels.
        if !estimates.iter().any(is_whole) {
            let mut aligned = Vec::new();
            aligner.align(backend, target, &starts, &mut aligned)?;
            estimates.extend(aligned);
        }
        let kept = estimates.iter().map(|e| e.camera_from_object).collect();
        reports.push(StageReport::new("align", hypotheses.len(), kept, began));
        let witness = Witness::new(target.image);
        let object = (&target.model.shape.centre, self.extent);
        let judged = estimates.into_par_iter().map_init(Rendering::default, |picture, estimate| {
            let seen = (&self.camera, &estimate.camera_from_object);
            (witness.evidence(&self.atlas, seen, object, picture), estimate)
        });
        candidates.extend(judged.collect::<Vec<_>>());
        Ok(())
    }

    /// Who is believed, and who is the best of them: the one that explains most of the image, unless it is vague and another
    /// one explains nearly as much. Correlations over the whole object, or a median of them, are reached as well by a pose
    /// that shows one face of a box where it is and the others elsewhere; and a face that is small in the image correlates
    /// well at many poses, but only at the right one do its triangles agree.
    pub(super) fn judge(&self, target: &Target<'_>, candidates: &mut [Candidate], found: &mut Found) {
        let began = Instant::now();
        (found.best, found.rejected) = (None, None);
        found.others.clear();
        candidates.sort_by(|a, b| b.0.information.total_cmp(&a.0.information));
        let (believed, rejected): (Vec<_>, Vec<_>) =
            candidates.iter().cloned().partition(|(evidence, _)| evidence.is_enough());
        let most = believed.first().map_or(0.0, |(evidence, _)| evidence.information);
        let near =
            believed.into_iter().filter(|(evidence, _)| evidence.information >= AMBIGUOUS_SHARE * most);
        let (vague, clear): (Vec<_>, Vec<_>) =
            near.map(|(_, e)| e).partition(|e| self.is_vague(target.model, e));
        let mut believed = if clear.is_empty() { vague } else { clear }.into_iter();
        found.best = believed.next();
        for estimate in believed {
            let known = found.best.iter().chain(&found.others);
            if known.into_iter().all(|e| self.differ(target.model, e, &estimate)) {
                found.others.push(estimate);
            }
        }
        if found.best.is_none() {
            found.rejected = rejected.into_iter().map(|(_, e)| e).next();
        }
        let believed = found.best.iter().chain(&found.others).map(|e| e.camera_from_object).collect();
        found.stages.push(StageReport::new("judge", candidates.len(), believed, began));
    }

    /// Does the image leave open where the object is?
    pub(super) fn is_vague(&self, model: &Model, estimate: &PoseEstimate) -> bool {
        estimate.spread_px(&self.camera, &model.shape) > VAGUE_PX
    }

    fn differ(&self, model: &Model, a: &PoseEstimate, b: &PoseEstimate) -> bool {
        let project = |pose: &Pose| hypotheses::corners(model, &self.camera, pose);
        let seen = project(&a.camera_from_object);
        let same = |motion: &Pose| {
            hypotheses::distance_px(&seen, &project(&b.camera_from_object.compose(motion))) <= DIFFERENT_PX
        };
        !self.options.symmetries.motions().iter().any(same)
    }
}

/// Is it found with nothing of importance hidden?
fn is_whole(estimate: &PoseEstimate) -> bool {
    !estimate.score.is_lost() && estimate.score.correlation >= WHOLE_CORRELATION
}
