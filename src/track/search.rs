//! The whole image is searched where no pose is given: for the first one, and after a loss.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use image::GrayImage;

use super::course::{Course, status_of_found};
use super::prediction::Motion;
use super::{Status, Tracked, Tracker, ms_since};
use crate::align::{PoseEstimate, Start, Target};
use crate::error::{Error, Result};
use crate::find::{FindOptions, Finder, Found, Priors};
use crate::geometry::Camera;
use crate::model::Model;

/// How the object is looked for in the whole image.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchOptions {
    /// Choices of the search itself.
    pub find: FindOptions,
    /// What is known of the first pose.
    pub first: Priors,
    /// Search after a loss as well, every frame until the object is found.
    pub recover: bool,
    /// A file to keep the templates in ([`Finder::cached`]); `None`: they are rendered at every start.
    pub templates: Option<PathBuf>,
}

impl Default for SearchOptions {
    fn default() -> Self {
        Self { find: FindOptions::default(), first: Priors::default(), recover: true, templates: None }
    }
}

/// The options, and the templates once they are needed.
pub(super) struct Search {
    options: SearchOptions,
    /// For the camera of the frames; rendering its templates takes a second.
    finder: Option<Arc<Finder>>,
}

impl Search {
    /// The same for another stream.
    pub(super) fn another(&self) -> Self {
        Self { options: self.options.clone(), finder: self.finder.clone() }
    }

    /// Templates are of one model and for one camera.
    pub(super) fn forget_templates(&mut self) {
        self.finder = None;
    }

    fn finder(&mut self, model: &Model, camera: &Camera) -> Result<Arc<Finder>> {
        if let Some(finder) = &self.finder {
            return Ok(finder.clone());
        }
        let find = &self.options.find;
        let finder = Arc::new(match &self.options.templates {
            Some(path) => Finder::cached(model, camera, find, path)?,
            None => Finder::new(model, camera, find)?,
        });
        tracing::info!("searching with {} templates", finder.templates());
        self.finder = Some(finder.clone());
        Ok(finder)
    }
}

impl Tracker {
    /// Lets the object be looked for in the whole image: in every frame before the first pose, unless
    /// [`Self::start_at`] gives it, and if the options say so in every frame after a loss. Such a frame takes about a
    /// second of processor time, the first one another to render templates.
    ///
    /// # Errors
    /// [`Error::Invalid`] for options out of range.
    pub fn search_by(&mut self, options: SearchOptions) -> Result<()> {
        options.find.check()?;
        self.search = Some(Search { options, finder: None });
        Ok(())
    }

    /// Searches a frame without a pose to start from.
    pub(super) fn find_first(&mut self, image: &GrayImage, tracked: &mut Tracked) -> Result<()> {
        let Some(search) = &self.search else {
            let remedy = "call start_at or search_by first";
            return Err(Error::invalid("tracker", "there is no pose to start from", remedy));
        };
        let first = search.options.first;
        self.take_frame(image)?;
        let found = self.search_frame(image, &first)?;
        let (status, estimate) = self.outcome(found)?;
        (tracked.status, tracked.estimate) = (status, estimate);
        Ok(())
    }

    /// Searches a frame, the current one of the backend, in which the object is not where it was expected: first
    /// among views like the last one, then among all, in turn.
    pub(super) fn recover(
        &mut self,
        image: &GrayImage,
        motion: &Motion,
        tracked: &mut Tracked,
    ) -> Result<()> {
        if !self.searches() {
            return Ok(());
        }
        let near = self.course.lost_frames.is_multiple_of(2);
        let priors = Priors { last_seen: near.then(|| motion.last()), ..Priors::default() };
        let found = self.search_frame(image, &priors)?;
        let (status, estimate) = self.outcome(found)?;
        if status.has_pose() {
            (tracked.status, tracked.estimate) = (status, estimate);
        } else if self.course.lost_frames > 0 {
            tracked.status = Status::Searching;
        }
        Ok(())
    }

    /// For a rig, whose course this camera follows: looks around a pose from which nothing was found, then, where that is
    /// wished, in the whole frame.
    pub(super) fn look_for(
        &mut self,
        image: &GrayImage,
        around: &Start,
        course: &Course,
    ) -> Result<Option<PoseEstimate>> {
        self.course.clone_from(course);
        let mut tracked = Tracked::default();
        tracked.estimate = self.align(image, std::slice::from_ref(around))?.remove(0);
        tracked.status = course.status(&tracked.estimate, &self.model, &self.camera);
        if tracked.status == Status::Lost {
            self.recover(image, &Motion::at_rest(around.camera_from_object), &mut tracked)?;
        }
        Ok(tracked.status.has_pose().then_some(tracked.estimate))
    }

    /// Is the whole image searched after a loss?
    pub(super) fn searches(&self) -> bool {
        self.search.as_ref().is_some_and(|s| s.options.recover)
    }

    /// What is known of the first pose holds for one camera, and so does a file of templates.
    pub(super) fn forget_priors(&mut self) {
        if let Some(search) = &mut self.search {
            (search.options.first, search.options.templates) = (Priors::default(), None);
        }
    }

    fn search_frame(&mut self, image: &GrayImage, priors: &Priors) -> Result<Found> {
        let began = Instant::now();
        let image = if self.is_rectified { &self.rectified } else { image };
        let target = Target { model: &self.model, id: self.id, camera: self.camera.rectified(), image };
        let Some(search) = &mut self.search else { return Ok(Found::default()) };
        let finder = search.finder(&self.model, &target.camera)?;
        // A pose that was tracked may look like none of the templates.
        let all = Priors::default();
        let priors = if priors.last_seen.is_some() && !finder.allows(priors) { &all } else { priors };
        let found = finder.find(self.backend.as_mut(), self.aligner.as_mut(), &target, priors)?;
        self.times.search_ms += ms_since(began);
        Ok(found)
    }

    fn outcome(&self, found: Found) -> Result<(Status, PoseEstimate)> {
        let status = found.best.as_ref().map_or(Status::Searching, |best| {
            let status = status_of_found(best, &self.model, &self.camera);
            if status.has_pose() { status } else { Status::Searching }
        });
        let estimate = found.best.or(found.rejected);
        let nothing = || Error::invalid("search", "it ended without any pose", "report this as a bug");
        Ok((status, estimate.ok_or_else(nothing)?))
    }
}
