//! What a track remembers from frame to frame, with one camera or several.

use super::Status;
use super::prediction::Motion;
use crate::align::{PoseEstimate, Start};
use crate::geometry::{Camera, Pose};
use crate::model::Model;

/// After a loss, or a search, a pose is certain from this correlation on: wrong poses that a search ended in reached
/// 0.76 where right ones have more than 0.9.
pub(super) const RECOVERED_CORRELATION: f64 = 0.8;
/// And if this share of its triangles is recognised. A wrong pose that explains one face of a half-hidden box where two or
/// three are seen reached a correlation of 0.93 with a share of 0.72; of objects in full view more than 0.95 is recognised.
const CLEAR_SHARE: f64 = 0.8;

/// Or with less spread than this (pixels, [`PoseEstimate::spread_px`]): of an object that is covered for the most part right ends
/// correlate less. Of 1273 ends from starts up to 120 px off 7 right ones had a correlation below 0.8, and a spread of 0.05 at
/// most; those more than 2.5 px off had 0.67 at least.
const SHARP_PX: f64 = 0.2;

/// With this spread (pixels, [`PoseEstimate::spread_px`]) a pose is right with a probability of a half at most, and so with a
/// third of it no more than uncertain. Right ends of searches had up to 0.65 px, ends more than 10 px off at least 2.
const WIDE_PX: f64 = 3.0;

/// Where the object was, and how sure that is.
#[derive(Debug, Clone)]
pub(super) struct Course {
    /// `None` before the first pose.
    pub(super) motion: Option<Motion>,
    pub(super) appearance: Vec<f64>,
    /// Frames since the last one with a pose: coming back needs more evidence than going on.
    pub(super) lost_frames: usize,
    /// Correlation in the last frame with a pose.
    pub(super) correlation: f64,
    /// False from a search, which may end in a wrong pose of a half-hidden object, until the object is recognised clearly.
    is_confirmed: bool,
}

impl Course {
    /// Of an object that was not seen yet.
    pub(super) fn unknown(modes: usize) -> Self {
        let appearance = vec![0.0; modes];
        Self { motion: None, appearance, lost_frames: 0, correlation: 1.0, is_confirmed: false }
    }

    /// Begins at a pose that is known.
    pub(super) fn start_at(&mut self, pose: Pose) {
        self.motion = Some(Motion::at_rest(pose));
        self.appearance.fill(0.0);
        (self.lost_frames, self.correlation, self.is_confirmed) = (0, 1.0, true);
    }

    /// Where the object is expected in the next frame.
    pub(super) fn expected(&self, motion: &Motion, model: &Model, start: &mut Start) {
        start.camera_from_object = motion.predict(&model.shape.centre);
        start.appearance.clone_from(&self.appearance);
    }

    /// Status of a pose that was aligned from where it was expected.
    pub(super) fn status(&self, estimate: &PoseEstimate, model: &Model, camera: &Camera) -> Status {
        let is_sharp = || estimate.spread_px(camera, &model.shape) < SHARP_PX;
        if self.lost_frames > 0 && estimate.score.correlation < RECOVERED_CORRELATION && !is_sharp() {
            return Status::Lost;
        }
        let status = Status::of_probability(probability(estimate, model, camera));
        if self.is_confirmed { status } else { unconfirmed(status, estimate) }
    }

    /// Goes on from what is known of a frame, if there is a pose.
    pub(super) fn follow(&mut self, status: Status, estimate: &PoseEstimate) {
        if status.has_pose() {
            let pose = estimate.camera_from_object;
            self.motion = Some(self.motion.map_or(Motion::found(pose), |motion| motion.advance(pose)));
            self.appearance.clone_from(&estimate.appearance);
            (self.lost_frames, self.correlation) = (0, estimate.score.correlation);
            self.is_confirmed |= is_clear(estimate);
        } else {
            self.motion = self.motion.map(Motion::stop);
            self.appearance.fill(0.0);
            self.lost_frames += 1;
            self.is_confirmed = false;
        }
    }
}

/// Status of a pose that a search of the whole image has found.
pub(super) fn status_of_found(estimate: &PoseEstimate, model: &Model, camera: &Camera) -> Status {
    unconfirmed(Status::of_probability(probability(estimate, model, camera)), estimate)
}

/// Probability that the pose of an estimate is right: that the object is recognised, as the model was calibrated, and that the
/// pose is not merely near. Errors of ends that are no minimum have longer tails than a normal distribution.
pub(super) fn probability(estimate: &PoseEstimate, model: &Model, camera: &Camera) -> f64 {
    let spread = estimate.spread_px(camera, &model.shape) / WIDE_PX;
    model.calibration.probability(estimate.score.margin()) / (1.0 + spread * spread)
}

/// Not more than uncertain unless the object is recognised clearly.
fn unconfirmed(status: Status, estimate: &PoseEstimate) -> Status {
    if status == Status::Tracking && !is_clear(estimate) { Status::Uncertain } else { status }
}

/// Is the object recognised, and most of what should be seen of it?
fn is_clear(estimate: &PoseEstimate) -> bool {
    estimate.score.correlation >= RECOVERED_CORRELATION && estimate.score.recognised >= CLEAR_SHARE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::Score;

    fn seen(correlation: f64) -> PoseEstimate {
        let score = Score { correlation, recognised: 0.9, visible: 0.5 };
        PoseEstimate { score, ..PoseEstimate::default() }
    }

    #[test]
    fn what_a_search_found_half_hidden_stays_uncertain_until_it_is_clear() {
        let tracking = Status::Tracking;
        assert_eq!(unconfirmed(tracking, &seen(0.7)), Status::Uncertain, "half hidden");
        assert_eq!(unconfirmed(tracking, &seen(0.9)), tracking, "clear");
        let score = Score { correlation: 0.93, recognised: 0.72, visible: 0.16 };
        let one_face = PoseEstimate { score, ..PoseEstimate::default() };
        assert_eq!(unconfirmed(tracking, &one_face), Status::Uncertain, "a part of what should be seen");
        let mut course = Course::unknown(0);
        course.follow(Status::Uncertain, &seen(0.7));
        assert!(!course.is_confirmed && course.motion.is_some(), "followed, not confirmed");
        course.follow(tracking, &seen(0.9));
        course.follow(tracking, &seen(0.7));
        assert!(course.is_confirmed, "it was clear once");
        course.follow(Status::Lost, &seen(0.1));
        assert!(!course.is_confirmed && course.lost_frames == 1, "until the next loss");
    }
}
