//! A sequence of frames: prediction, alignment, loss.

mod batch;
mod first_pose;
mod prediction;
pub mod realign;

use std::sync::Arc;
use std::time::Instant;

use image::GrayImage;

use crate::align::{AlignTimes, Aligner, PoseEstimate, Start, Target};
use crate::backend::{Backend, ModelId};
use crate::error::{Error, Result};
use crate::find::{Finder, Priors};
use crate::geometry::{Camera, Pose};
use crate::imaging::Rectifier;
use crate::model::Model;
use prediction::Motion;

/// After a lost frame a pose is believed from this median correlation on: wrong poses that a search ended in reached
/// 0.76 where right ones have more than 0.9.
const RECOVERED_CORRELATION: f64 = 0.8;

/// A pose below [`RECOVERED_CORRELATION`] is checked by a search if the correlation fell by this since the last frame:
/// it may be a local minimum.
const FALLEN_CORRELATION: f64 = 0.1;

/// What is known about the object in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// The pose is believed.
    Tracking,
    /// The object is not where the pose says.
    Lost,
}

/// Result of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracked {
    /// Is the pose to be believed?
    pub status: Status,
    /// The pose and all that is known about it.
    pub estimate: PoseEstimate,
    /// Wall time of this frame, milliseconds.
    pub time_ms: f64,
    /// Where it went.
    pub times: FrameTimes,
}

/// Where the time of a frame went: wall time, milliseconds. What is left of the whole is prediction and bookkeeping.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
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

impl Default for Tracked {
    /// Nothing is known yet: memory for [`Tracker::track_into`].
    fn default() -> Self {
        Self {
            status: Status::Lost,
            estimate: PoseEstimate::default(),
            time_ms: 0.0,
            times: FrameTimes::default(),
        }
    }
}

/// Tracks one object through the frames of one camera.
pub struct Tracker {
    backend: Box<dyn Backend>,
    aligner: Box<dyn Aligner>,
    /// Shared with the trackers of other streams.
    model: Arc<Model>,
    id: ModelId,
    camera: Camera,
    rectifier: Rectifier,
    /// The current frame without lens distortion.
    rectified: GrayImage,
    /// Where the time of the current frame went.
    times: FrameTimes,
    motion: Option<Motion>,
    /// Finds the object while there is no pose to start from.
    finder: Option<(Finder, Priors)>,
    appearance: Vec<f64>,
    /// True after a frame that was lost: coming back needs more evidence than going on.
    lost: bool,
    /// Median correlation in the last believed frame.
    correlation: f64,
    /// Memory of the start and the estimate of a frame.
    starts: Vec<Start>,
    estimates: Vec<PoseEstimate>,
}

impl std::fmt::Debug for Tracker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Tracker")
            .field("backend", &self.backend.name())
            .field("camera", &self.camera)
            .finish_non_exhaustive()
    }
}

impl Tracker {
    /// A tracker for `model` in frames of `camera` (with its lens distortion). Call [`Self::start_at`] or
    /// [`Self::start_by_search`] before the first frame.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a camera that is none, and what [`Backend::load`] and [`Aligner::prepare`] report.
    pub fn new(
        model: Model,
        camera: Camera,
        mut backend: Box<dyn Backend>,
        mut aligner: Box<dyn Aligner>,
    ) -> Result<Self> {
        camera.validate()?;
        let id = backend.load(&model)?;
        aligner.prepare(backend.as_mut(), &model, id)?;
        let appearance = vec![0.0; model.modes()];
        let rectifier = Rectifier::new(&camera);
        Ok(Self {
            backend,
            aligner,
            model: Arc::new(model),
            id,
            camera,
            rectifier,
            rectified: GrayImage::default(),
            times: FrameTimes::default(),
            motion: None,
            finder: None,
            appearance,
            lost: false,
            correlation: 1.0,
            starts: Vec::new(),
            estimates: Vec::new(),
        })
    }

    /// Sets where to look in the next frame.
    pub fn start_at(&mut self, camera_from_object: Pose) {
        self.motion = Some(Motion::at_rest(camera_from_object));
        self.appearance.fill(0.0);
        (self.lost, self.correlation) = (false, 1.0);
    }

    /// Changes the camera of the following frames (zoom, another calibration per frame).
    ///
    /// # Errors
    /// [`Error::Invalid`] for a camera that is none.
    pub fn set_camera(&mut self, camera: Camera) -> Result<()> {
        if camera != self.camera {
            camera.validate()?;
            self.rectifier = Rectifier::new(&camera);
            self.camera = camera;
        }
        Ok(())
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Name of the backend in use.
    pub fn backend_name(&self) -> String {
        self.backend.name()
    }

    /// Tracks the object into the next frame. After a lost frame the search goes on from the last believed pose.
    ///
    /// # Errors
    /// [`Error::Invalid`] before [`Self::start_at`] or [`Self::start_by_search`], or for an image of another size than
    /// the camera's; errors of the backend. The tracker stays usable after an error.
    pub fn track(&mut self, image: &GrayImage) -> Result<Tracked> {
        let mut tracked = Tracked::default();
        self.track_into(image, &mut tracked)?;
        Ok(tracked)
    }

    /// As [`Self::track`], in the memory of an earlier result. With the default method on the CPU backend, and a model
    /// that one thread is enough for (see `docs/architecture.md`), nothing is allocated once every buffer has grown to
    /// its size, as long as the object is tracked.
    ///
    /// # Errors
    /// As [`Self::track`]; what is in `tracked` then means nothing.
    pub fn track_into(&mut self, image: &GrayImage, tracked: &mut Tracked) -> Result<()> {
        let began = Instant::now();
        let Some(motion) = self.motion else { return self.find_first(image, began, tracked) };
        let (mut starts, mut estimates) =
            (std::mem::take(&mut self.starts), std::mem::take(&mut self.estimates));
        starts.resize_with(1, Start::default);
        starts[0].camera_from_object = motion.predict(&self.model.shape.centre);
        starts[0].appearance.clone_from(&self.appearance);
        let aligned = self.align_into(image, &starts, &mut estimates);
        if aligned.is_ok() {
            // The caller's memory is that of the next frame.
            std::mem::swap(&mut tracked.estimate, &mut estimates[0]);
        }
        (self.starts, self.estimates) = (starts, estimates);
        aligned?;
        tracked.status = self.follow(motion, &tracked.estimate);
        (tracked.time_ms, tracked.times) = (ms_since(began), self.times);
        Ok(())
    }

    /// Goes on from an estimate, if it is to be believed.
    fn follow(&mut self, motion: Motion, estimate: &PoseEstimate) -> Status {
        let status = if believed(estimate, self.lost) { Status::Tracking } else { Status::Lost };
        self.lost = status == Status::Lost;
        match status {
            Status::Tracking => {
                self.motion = Some(motion.advance(estimate.camera_from_object));
                self.appearance.clone_from(&estimate.appearance);
                self.correlation = estimate.score.correlation;
            }
            Status::Lost => {
                self.motion = Some(motion.stop());
                self.appearance.fill(0.0);
            }
        }
        status
    }

    /// Aligns every start with one frame, each on its own, and leaves the track as it is. Around starts from which
    /// the object is not found, or found with much less correlation than before, it is searched for.
    ///
    /// # Errors
    /// As [`Self::track`].
    pub fn align(&mut self, image: &GrayImage, starts: &[Start]) -> Result<Vec<PoseEstimate>> {
        let mut estimates = Vec::new();
        self.align_into(image, starts, &mut estimates)?;
        Ok(estimates)
    }

    fn align_into(
        &mut self,
        image: &GrayImage,
        starts: &[Start],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        self.check_size(image)?;
        let began = Instant::now();
        let is_rectified = self.rectifier.rectify_into(image, &mut self.rectified);
        let image = if is_rectified { &self.rectified } else { image };
        let rectify_ms = ms_since(began);
        self.backend.set_frame(image, self.aligner.levels(&self.model))?;
        let set_frame_ms = ms_since(began) - rectify_ms;
        let target = Target { model: &self.model, id: self.id, camera: self.camera.rectified(), image };
        self.aligner.align(self.backend.as_mut(), &target, starts, estimates)?;
        let align = self.aligner.times();
        let began = Instant::now();
        for (estimate, start) in estimates.iter_mut().zip(starts) {
            let fell =
                estimate.score.correlation < RECOVERED_CORRELATION.min(self.correlation - FALLEN_CORRELATION);
            if believed(estimate, self.lost) && !fell {
                continue;
            }
            if let Some(found) = self.aligner.search(self.backend.as_mut(), &target, start)? {
                let iterations = estimate.iterations + found.iterations;
                if believed(&found, true) && found.score.correlation > estimate.score.correlation {
                    *estimate = found;
                }
                estimate.iterations = iterations;
            }
        }
        self.times = FrameTimes { rectify_ms, set_frame_ms, align, search_ms: ms_since(began) };
        Ok(())
    }

    fn check_size(&self, image: &GrayImage) -> Result<()> {
        let expected = (self.camera.width, self.camera.height);
        if image.dimensions() != expected {
            let (w, h) = image.dimensions();
            let problem = format!("{w}x{h}, but the camera has {}x{}", expected.0, expected.1);
            return Err(Error::invalid("frame", problem, "give frames and calibration of the same camera"));
        }
        Ok(())
    }
}

fn ms_since(began: Instant) -> f64 {
    began.elapsed().as_secs_f64() * 1e3
}

/// Is the object where the estimate says? Coming back after a loss or by a search needs more evidence than going on.
fn believed(estimate: &PoseEstimate, recovering: bool) -> bool {
    !estimate.score.is_lost() && (!recovering || estimate.score.correlation >= RECOVERED_CORRELATION)
}
