//! A sequence of frames: prediction, alignment, loss.

pub mod annotated;
mod batch;
mod calibrate;
mod course;
mod locate;
mod pair;
mod prediction;
mod realign;
mod result;
mod rig;
mod search;
pub mod smooth;
mod survey;
mod triangulation;

use std::sync::Arc;
use std::time::Instant;

use image::GrayImage;

use crate::align::{Aligner, PoseEstimate, Start};
use crate::backend::{Backend, ModelId, Traffic};
use crate::error::Result;
use crate::geometry::{Camera, Pose};
use crate::imaging::Rectifier;
use crate::model::Model;
use course::{Course, probability};
use prediction::Motion;
use search::Search;

pub use calibrate::calibrate;
pub use pair::StereoPair;
pub use result::{FrameTimes, Status, Tracked};
pub use rig::{RigCamera, RigTracker};
pub use search::SearchOptions;

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
    /// Is that the frame, or was there no distortion to remove?
    is_rectified: bool,
    /// Where the time of the current frame went.
    times: FrameTimes,
    course: Course,
    /// Looks for the object in the whole image, while there is no pose to start from and after a loss.
    search: Option<Search>,
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
    /// [`Self::search_by`] before the first frame.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a camera that is none, and what [`Backend::load`] and [`Aligner::prepare`] report.
    pub fn new(
        model: Model,
        camera: Camera,
        mut backend: Box<dyn Backend>,
        mut aligner: Box<dyn Aligner>,
    ) -> Result<Self> {
        camera.validate()?;
        let id = backend.load(&model)?;
        aligner.prepare(backend.as_mut(), &model, id)?;
        let course = Course::unknown(model.modes());
        let rectifier = Rectifier::new(&camera);
        Ok(Self {
            backend,
            aligner,
            model: Arc::new(model),
            id,
            camera,
            rectifier,
            rectified: GrayImage::default(),
            is_rectified: false,
            times: FrameTimes::default(),
            course,
            search: None,
            starts: Vec::new(),
            estimates: Vec::new(),
        })
    }

    /// Sets where to look in the next frame.
    pub fn start_at(&mut self, camera_from_object: Pose) {
        self.course.start_at(camera_from_object);
    }

    /// Changes the camera of the following frames (zoom, another calibration per frame).
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a camera that is none.
    pub fn set_camera(&mut self, camera: Camera) -> Result<()> {
        if camera != self.camera {
            camera.validate()?;
            self.rectifier = Rectifier::new(&camera);
            self.camera = camera;
            if let Some(search) = &mut self.search {
                search.forget_templates();
            }
        }
        Ok(())
    }

    /// Another model for the following frames.
    fn set_model(&mut self, model: Model) -> Result<()> {
        self.id = self.backend.load(&model)?;
        self.aligner.prepare(self.backend.as_mut(), &model, self.id)?;
        self.course = Course::unknown(model.modes());
        self.model = Arc::new(model);
        if let Some(search) = &mut self.search {
            search.forget_templates();
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

    /// What has crossed to and from the device so far, for this stream and all that share its device.
    pub fn traffic(&self) -> Traffic {
        self.backend.traffic()
    }

    /// Probability that the pose of an estimate is right, (`docs/maths.md`, "Is it lost?").
    pub fn probability(&self, estimate: &PoseEstimate) -> f64 {
        probability(estimate, &self.model, &self.camera)
    }

    /// Tracks the object into the next frame. After a lost frame it is looked for where it was seen last, and, with
    /// [`Self::search_by`], in the whole image.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] before [`Self::start_at`] or [`Self::search_by`], or for an image of another size than
    /// the camera's; errors of the backend. The tracker stays usable after an error.
    pub fn track(&mut self, image: &GrayImage) -> Result<Tracked> {
        let mut tracked = Tracked::default();
        self.track_into(image, &mut tracked)?;
        Ok(tracked)
    }

    /// As [`Self::track`], in the memory of an earlier result. With the default method on the CPU backend, and a model
    /// that one thread is enough for (see `docs/speed.md`), nothing is allocated once every buffer has grown to
    /// its size, as long as the object is tracked.
    ///
    /// # Errors
    /// As [`Self::track`]; what is in `tracked` then means nothing.
    pub fn track_into(&mut self, image: &GrayImage, tracked: &mut Tracked) -> Result<()> {
        let began = Instant::now();
        match self.course.motion {
            Some(motion) => self.track_from(motion, image, tracked)?,
            None => self.find_first(image, tracked)?,
        }
        self.conclude(began, tracked);
        Ok(())
    }

    /// Goes on from what came of a frame.
    fn conclude(&mut self, began: Instant, tracked: &mut Tracked) {
        self.course.follow(tracked.status, &tracked.estimate);
        tracked.rate(&self.model, &self.camera);
        (tracked.time_ms, tracked.times) = (ms_since(began), self.times);
    }

    fn track_from(&mut self, motion: Motion, image: &GrayImage, tracked: &mut Tracked) -> Result<()> {
        let (mut starts, mut estimates) =
            (std::mem::take(&mut self.starts), std::mem::take(&mut self.estimates));
        starts.resize_with(1, Start::default);
        self.course.expected(&motion, &self.model, &mut starts[0]);
        let aligned = self.align_into(image, &starts, &mut estimates);
        if aligned.is_ok() {
            // The caller's memory is that of the next frame.
            std::mem::swap(&mut tracked.estimate, &mut estimates[0]);
        }
        (self.starts, self.estimates) = (starts, estimates);
        aligned?;
        tracked.status = self.course.status(&tracked.estimate, &self.model, &self.camera);
        if tracked.status == Status::Lost { self.recover(image, &motion, tracked) } else { Ok(()) }
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
}

fn ms_since(began: Instant) -> f64 {
    began.elapsed().as_secs_f64() * 1e3
}
