//! A sequence of frames: prediction, alignment, loss.

mod prediction;
pub mod realign;

use std::time::Instant;

use image::GrayImage;

use crate::align::{Aligner, PoseEstimate, Start, Target};
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
}

/// Tracks one object through the frames of one camera.
pub struct Tracker {
    backend: Box<dyn Backend>,
    aligner: Box<dyn Aligner>,
    model: Model,
    id: ModelId,
    camera: Camera,
    rectifier: Rectifier,
    motion: Option<Motion>,
    /// Finds the object while there is no pose to start from.
    finder: Option<(Finder, Priors)>,
    appearance: Vec<f64>,
    /// True after a frame that was lost: coming back needs more evidence than going on.
    lost: bool,
    /// Median correlation in the last believed frame.
    correlation: f64,
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
            model,
            id,
            camera,
            rectifier,
            motion: None,
            finder: None,
            appearance,
            lost: false,
            correlation: 1.0,
        })
    }

    /// Sets where to look in the next frame.
    pub fn start_at(&mut self, camera_from_object: Pose) {
        self.motion = Some(Motion::at_rest(camera_from_object));
        self.appearance.fill(0.0);
        (self.lost, self.correlation) = (false, 1.0);
    }

    /// Lets every next frame be searched until the object is found; `finder` is for the model and the rectified camera of
    /// this tracker.
    pub fn start_by_search(&mut self, finder: Finder, priors: Priors) {
        self.motion = None;
        self.finder = Some((finder, priors));
    }

    /// Searches a frame without a pose to start from; a frame without the object is lost.
    fn find_first(&mut self, image: &GrayImage, began: Instant) -> Result<Tracked> {
        self.check_size(image)?;
        let Some((finder, priors)) = &self.finder else {
            let remedy = "call start_at or start_by_search first";
            return Err(Error::invalid("tracker", "there is no pose to start from", remedy));
        };
        let rectified = (!self.camera.distortion.is_none()).then(|| self.rectifier.rectify(image.clone()));
        let image = rectified.as_ref().unwrap_or(image);
        self.backend.set_frame(image, self.aligner.levels(&self.model))?;
        let target = Target { model: &self.model, id: self.id, camera: self.camera.rectified(), image };
        let found = finder.find(self.backend.as_mut(), self.aligner.as_ref(), &target, priors)?;
        let status = if found.best.is_some() { Status::Tracking } else { Status::Lost };
        let Some(estimate) = found.best.or(found.rejected) else {
            return Err(Error::invalid("search", "it ended without any pose", "report this as a bug"));
        };
        if status == Status::Tracking {
            self.start_at(estimate.camera_from_object);
            self.appearance.clone_from(&estimate.appearance);
            self.correlation = estimate.score.correlation;
        }
        Ok(Tracked { status, estimate, time_ms: began.elapsed().as_secs_f64() * 1e3 })
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
    /// [`Error::Invalid`] before [`Self::start_at`] or [`Self::start_by_search`], or for an image of another size than the camera's; errors of the
    /// backend. The tracker stays usable after an error.
    pub fn track(&mut self, image: &GrayImage) -> Result<Tracked> {
        let began = Instant::now();
        let Some(motion) = self.motion else { return self.find_first(image, began) };
        let centre = self.model.shape.centre;
        let start =
            Start { camera_from_object: motion.predict(&centre), appearance: self.appearance.clone() };
        let estimate = self.align(image, std::slice::from_ref(&start))?.remove(0);
        let status = if believed(&estimate, self.lost) { Status::Tracking } else { Status::Lost };
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
        Ok(Tracked { status, estimate, time_ms: began.elapsed().as_secs_f64() * 1e3 })
    }

    /// Aligns every start with one frame, each on its own, and leaves the track as it is. Around starts from which
    /// the object is not found, or found with much less correlation than before, it is searched for.
    ///
    /// # Errors
    /// As [`Self::track`].
    pub fn align(&mut self, image: &GrayImage, starts: &[Start]) -> Result<Vec<PoseEstimate>> {
        self.check_size(image)?;
        let rectified = (!self.camera.distortion.is_none()).then(|| self.rectifier.rectify(image.clone()));
        let image = rectified.as_ref().unwrap_or(image);
        self.backend.set_frame(image, self.aligner.levels(&self.model))?;
        let target = Target { model: &self.model, id: self.id, camera: self.camera.rectified(), image };
        let mut estimates = self.aligner.align(self.backend.as_mut(), &target, starts)?;
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
        Ok(estimates)
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

/// Is the object where the estimate says? Coming back after a loss or by a search needs more evidence than going on.
fn believed(estimate: &PoseEstimate, recovering: bool) -> bool {
    !estimate.score.is_lost() && (!recovering || estimate.score.correlation >= RECOVERED_CORRELATION)
}
