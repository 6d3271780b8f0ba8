//! The first pose of a track, where none is given.

use std::time::Instant;

use image::GrayImage;

use super::{FrameTimes, Status, Tracked, Tracker, ms_since};
use crate::align::{AlignTimes, Target};
use crate::error::{Error, Result};
use crate::find::{Finder, Priors};

impl Tracker {
    /// Lets every next frame be searched until the object is found; `finder` is for the model and the rectified camera of
    /// this tracker.
    pub fn start_by_search(&mut self, finder: Finder, priors: Priors) {
        self.motion = None;
        self.finder = Some((finder, priors));
    }

    /// Searches a frame without a pose to start from; a frame without the object is lost.
    pub(super) fn find_first(
        &mut self,
        image: &GrayImage,
        began: Instant,
        tracked: &mut Tracked,
    ) -> Result<()> {
        self.check_size(image)?;
        let Some((finder, priors)) = &self.finder else {
            let remedy = "call start_at or start_by_search first";
            return Err(Error::invalid("tracker", "there is no pose to start from", remedy));
        };
        let is_rectified = self.rectifier.rectify_into(image, &mut self.rectified);
        let image = if is_rectified { &self.rectified } else { image };
        let rectify_ms = ms_since(began);
        self.backend.set_frame(image, self.aligner.levels(&self.model))?;
        let set_frame_ms = ms_since(began) - rectify_ms;
        let target = Target { model: &self.model, id: self.id, camera: self.camera.rectified(), image };
        let found = finder.find(self.backend.as_mut(), self.aligner.as_mut(), &target, priors)?;
        tracked.status = if found.best.is_some() { Status::Tracking } else { Status::Lost };
        let Some(estimate) = found.best.or(found.rejected) else {
            return Err(Error::invalid("search", "it ended without any pose", "report this as a bug"));
        };
        if tracked.status == Status::Tracking {
            self.start_at(estimate.camera_from_object);
            self.appearance.clone_from(&estimate.appearance);
            self.correlation = estimate.score.correlation;
        }
        tracked.estimate = estimate;
        tracked.time_ms = ms_since(began);
        let search_ms = tracked.time_ms - rectify_ms - set_frame_ms;
        tracked.times = FrameTimes { rectify_ms, set_frame_ms, align: AlignTimes::default(), search_ms };
        Ok(())
    }
}
