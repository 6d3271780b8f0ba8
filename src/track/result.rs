//! What is known about a frame.

use serde::{Deserialize, Serialize};

use super::course::probability;
use crate::align::{AlignTimes, PoseEstimate};
use crate::geometry::Camera;
use crate::model::Model;

/// A pose is tracked from this probability on that it is right.
const CERTAIN: f64 = 0.9;
/// Below this it is more likely wrong: the object is lost.
const LIKELY: f64 = 0.5;

/// What is known about the object in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// The pose is believed: right with a probability of at least 0.9, and, if it was searched for, recognised clearly since.
    Tracking,
    /// The pose is more likely right than not, and followed.
    Uncertain,
    /// The object is not where it was expected; the pose means nothing.
    Lost,
    /// The whole image is searched for the object, so far without result; the pose means nothing.
    Searching,
}

impl Status {
    /// That of a pose which is right with this probability.
    pub fn of_probability(probability: f64) -> Self {
        // Written so that NaN is lost.
        if probability >= CERTAIN {
            Self::Tracking
        } else if probability >= LIKELY {
            Self::Uncertain
        } else {
            Self::Lost
        }
    }

    /// Is there a pose?
    pub fn has_pose(self) -> bool {
        matches!(self, Self::Tracking | Self::Uncertain)
    }
}

/// Result of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracked {
    /// Is the pose to be believed?
    pub status: Status,
    /// Probability (0..1) that the pose is right: within a few pixels of the truth, all over the object; 0 without a pose.
    /// [`crate::model::Calibration`] and [`Self::spread_px`] say where it comes from.
    pub probability: f64,
    /// [`PoseEstimate::spread_px`] in the frame's camera (of a rig: the reference camera).
    pub spread_px: f64,
    /// The pose and all that is known about it.
    pub estimate: PoseEstimate,
    /// Wall time of this frame, milliseconds.
    pub time_ms: f64,
    /// Where it went.
    pub times: FrameTimes,
}

/// Where the time of a frame went: wall time, milliseconds. What is left of the whole is prediction and bookkeeping.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct FrameTimes {
    /// Removing lens distortion, on the host.
    pub rectify_ms: f64,
    /// Handing the frame to the backend, pyramid included.
    pub set_frame_ms: f64,
    /// The alignment of the predicted pose; zero but for the default method.
    #[serde(flatten)]
    pub align: AlignTimes,
    /// Searching for what was not found there.
    pub search_ms: f64,
}

impl Tracked {
    /// States how probable it is.
    pub(super) fn rate(&mut self, model: &Model, camera: &Camera) {
        self.spread_px = self.estimate.spread_px(camera, &model.shape);
        let probability = || probability(&self.estimate, model, camera);
        self.probability = if self.status.has_pose() { probability() } else { 0.0 };
    }
}

impl Default for Tracked {
    /// Nothing is known yet: memory for [`crate::track::Tracker::track_into`].
    fn default() -> Self {
        Self {
            status: Status::Lost,
            probability: 0.0,
            spread_px: f64::INFINITY,
            estimate: PoseEstimate::default(),
            time_ms: 0.0,
            times: FrameTimes::default(),
        }
    }
}
