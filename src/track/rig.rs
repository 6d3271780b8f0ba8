//! One object seen by several calibrated cameras at the same time.

use std::time::Instant;

use image::GrayImage;

use super::course::Course;
use super::{Status, Tracked, Tracker, ms_since};
use crate::align::{Eye, InverseCompositional, Options, PoseEstimate, Start, Target};
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose};
use crate::model::Model;

/// A camera of a rig besides the reference camera.
#[derive(Debug, Clone)]
pub struct RigCamera {
    /// The camera, with its lens distortion.
    pub camera: Camera,
    /// `X_camera = camera_from_reference X_reference`, metres.
    pub camera_from_reference: Pose,
    /// A model of the same object and mesh, trained on images of this camera; `None`: the model of the reference camera. Its
    /// own model takes up what is wrong in the calibration between the cameras. Without appearance modes.
    pub model: Option<Model>,
}

/// Tracks one object with several cameras whose frames are taken at the same time. Poses are those in the reference
/// camera.
#[derive(Debug)]
pub struct RigTracker {
    /// One per camera, the reference camera first; each searches its own frame when the object is lost.
    trackers: Vec<Tracker>,
    camera_from_reference: Vec<Pose>,
    aligner: InverseCompositional,
    course: Course,
}

impl RigTracker {
    /// A rig of the camera of `reference`, a tracker with the default method, and others, which share its model. What
    /// [`Tracker::start_at`] and [`Tracker::search_by`] have told it holds for the rig; priors of the first pose hold for its own camera.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a camera that is none and for a model of something else or with appearance modes; those of
    /// [`Tracker::another`] and of loading a model.
    pub fn new(reference: Tracker, others: Vec<RigCamera>, options: Options) -> Result<Self> {
        let course = reference.course.clone();
        let (mut trackers, mut camera_from_reference) = (vec![reference], vec![Pose::identity()]);
        for other in others {
            let mut tracker = trackers[0].another()?;
            if let Some(model) = other.model {
                check_same(trackers[0].model(), &model)?;
                tracker.set_model(model)?;
            }
            tracker.set_camera(other.camera)?;
            tracker.forget_priors();
            trackers.push(tracker);
            camera_from_reference.push(other.camera_from_reference);
        }
        let aligner = InverseCompositional::new(options);
        Ok(Self { trackers, camera_from_reference, aligner, course })
    }

    /// Sets where to look in the next frames: the pose in the reference camera.
    pub fn start_at(&mut self, reference_from_object: Pose) {
        self.course.start_at(reference_from_object);
    }

    /// The model.
    pub fn model(&self) -> &Model {
        self.trackers[0].model()
    }

    /// Name of the backend in use.
    pub fn backend_name(&self) -> String {
        self.trackers[0].backend_name()
    }

    /// Changes a camera (0: the reference camera) of the following frames; where it is stays.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a camera that is none.
    pub fn set_camera(&mut self, index: usize, camera: Camera) -> Result<()> {
        self.trackers[index].set_camera(camera)
    }

    /// Tracks the object into the next frames, one per camera in their order.
    ///
    /// # Errors
    /// [`Error::Invalid`] for another number of images than cameras, for images of another size than their camera's,
    /// and before the first pose unless it is to be searched for; errors of the backends.
    pub fn track(&mut self, images: &[&GrayImage]) -> Result<Tracked> {
        if images.len() != self.trackers.len() {
            let problem = format!("{} images for {} cameras", images.len(), self.trackers.len());
            return Err(Error::invalid("frames of the rig", problem, "give one image per camera"));
        }
        let began = Instant::now();
        let mut tracked = match self.course.motion {
            Some(motion) => {
                let mut start = Start::default();
                self.course.expected(&motion, self.model(), &mut start);
                self.take_frames(images)?;
                let mut tracked = self.align(images, &start)?;
                if tracked.status == Status::Lost {
                    self.recover(images, &start, &mut tracked)?;
                }
                tracked
            }
            None => self.find_first(images)?,
        };
        self.course.follow(tracked.status, &tracked.estimate);
        tracked.rate(self.model(), &self.trackers[0].camera);
        tracked.time_ms = ms_since(began);
        tracked.times = self.trackers[0].times;
        Ok(tracked)
    }

    fn take_frames(&mut self, images: &[&GrayImage]) -> Result<()> {
        self.trackers.iter_mut().zip(images).try_for_each(|(tracker, image)| tracker.take_frame(image))
    }

    /// Aligns a pose with the frames that the backends have.
    fn align(&mut self, images: &[&GrayImage], start: &Start) -> Result<Tracked> {
        let parts = self.trackers.iter_mut().zip(images).zip(&self.camera_from_reference);
        let mut eyes: Vec<Eye<'_>> = parts
            .map(|((tracker, image), camera_from_reference)| {
                let Tracker { backend, model, id, camera, rectified, is_rectified, .. } = tracker;
                let image = if *is_rectified { &*rectified } else { *image };
                let target = Target { model, id: *id, camera: camera.rectified(), image };
                Eye { backend: backend.as_mut(), target, camera_from_reference: *camera_from_reference }
            })
            .collect();
        let estimate = self.aligner.align_joint(&mut eyes, start)?;
        let status = self.course.status(&estimate, self.model(), &self.trackers[0].camera);
        Ok(Tracked { status, estimate, ..Tracked::default() })
    }

    /// Lets every camera search on its own around where the object was expected, and, after a loss, its whole image; what
    /// one of them finds is aligned with all.
    fn recover(&mut self, images: &[&GrayImage], start: &Start, tracked: &mut Tracked) -> Result<()> {
        for k in 0..self.trackers.len() {
            let place = self.camera_from_reference[k];
            let seen =
                Start { camera_from_object: place.compose(&start.camera_from_object), ..start.clone() };
            let found = self.trackers[k].look_for(images[k], &seen, &self.course)?;
            let Some(found) = found else { continue };
            self.take_up(images, k, &found, tracked)?;
            if tracked.status.has_pose() {
                return Ok(());
            }
        }
        if self.course.lost_frames > 0 && self.trackers[0].searches() {
            tracked.status = Status::Searching;
        }
        Ok(())
    }

    fn find_first(&mut self, images: &[&GrayImage]) -> Result<Tracked> {
        let mut first = Tracked::default();
        for k in 0..self.trackers.len() {
            let mut alone = Tracked::default();
            self.trackers[k].find_first(images[k], &mut alone)?;
            if alone.status.has_pose() {
                self.take_frames(images)?;
                self.take_up(images, k, &alone.estimate, &mut first)?;
                if first.status.has_pose() {
                    return Ok(first);
                }
            }
            if k == 0 {
                first.estimate = alone.estimate;
            }
        }
        first.status = Status::Searching;
        Ok(first)
    }

    /// Aligns with all cameras what one of them has found.
    fn take_up(
        &mut self,
        images: &[&GrayImage],
        camera: usize,
        found: &PoseEstimate,
        tracked: &mut Tracked,
    ) -> Result<()> {
        let reference_from_camera = self.camera_from_reference[camera].inverse();
        let start = Start {
            camera_from_object: reference_from_camera.compose(&found.camera_from_object),
            appearance: found.appearance.clone(),
        };
        let joint = self.align(images, &start)?;
        if joint.status.has_pose() {
            *tracked = joint;
        }
        Ok(())
    }
}

/// Models of one rig are of one object; appearance parameters of different models mean different things.
fn check_same(reference: &Model, model: &Model) -> Result<()> {
    let refuse = |problem: &str, remedy: &str| Err(Error::invalid("model of a camera", problem, remedy));
    if (reference.shape.centre - model.shape.centre).norm() > 1e-9 {
        return refuse(
            "its mesh is another one than that of the reference camera's model",
            "train both with one mesh",
        );
    }
    if reference.modes() + model.modes() > 0 {
        return refuse("models of single cameras cannot have appearance modes", "train both with --modes 0");
    }
    Ok(())
}
