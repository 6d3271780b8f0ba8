//! Many streams of one object, or many objects in one frame: every track has a state of its own, and all share what is
//! loaded and the cores.

use image::GrayImage;
use rayon::prelude::*;

use super::course::Course;
use super::search::Search;
use super::{FrameTimes, Tracked, Tracker};
use crate::error::{Error, Result};

impl Tracker {
    /// A tracker of the same object for another stream of the same camera, without a pose to start from. It shares the
    /// model with this one, on the host and on the device.
    ///
    /// # Errors
    /// Those of [`crate::backend::Backend::another`].
    pub fn another(&self) -> Result<Self> {
        Ok(Self {
            backend: self.backend.another()?,
            aligner: self.aligner.another(),
            model: self.model.clone(),
            id: self.id,
            camera: self.camera,
            rectifier: self.rectifier.clone(),
            rectified: GrayImage::default(),
            is_rectified: false,
            times: FrameTimes::default(),
            course: Course::unknown(self.model.modes()),
            search: self.search.as_ref().map(Search::another),
            starts: Vec::new(),
            estimates: Vec::new(),
        })
    }

    /// Tracks every object into its next frame: `images[k]` is that of `trackers[k]`. Trackers of different objects may be
    /// given the same image. Each result is what [`Self::track`] would have given, whatever the others do, and one
    /// that fails leaves the others alone.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there are not as many images as trackers; each result has the errors of [`Self::track`].
    pub fn track_batch(trackers: &mut [Self], images: &[&GrayImage]) -> Result<Vec<Result<Tracked>>> {
        if trackers.len() != images.len() {
            let problem = format!("{} images for {} trackers", images.len(), trackers.len());
            return Err(Error::invalid("batch", problem, "give one image per tracker"));
        }
        Ok(trackers.par_iter_mut().zip(images).map(|(tracker, image)| tracker.track(image)).collect())
    }
}
