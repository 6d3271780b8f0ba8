//! One frame: start poses, alignment, and a search around starts from which nothing was found.

use std::time::Instant;

use image::GrayImage;

use super::course::RECOVERED_CORRELATION;
use super::{FrameTimes, Tracker, ms_since};
use crate::align::{PoseEstimate, Start, Target};
use crate::error::{Error, Result};
use crate::geometry::Camera;

/// A pose below [`RECOVERED_CORRELATION`] is checked by a search if the correlation fell by this since the last frame:
/// it may be a local minimum.
const FALLEN_CORRELATION: f64 = 0.1;

impl Tracker {
    /// Is a frame of the camera's size?
    pub(super) fn fits(&self, image: &GrayImage) -> bool {
        image.dimensions() == (self.camera.width, self.camera.height)
    }

    /// Removes the lens distortion of a frame; its time begins a new account.
    pub(super) fn rectify(&mut self, image: &GrayImage) {
        let began = Instant::now();
        self.is_rectified = self.rectifier.rectify_into(image, &mut self.rectified);
        self.times = FrameTimes { rectify_ms: ms_since(began), ..FrameTimes::default() };
    }

    /// What the backend is to see of a frame after [`Self::rectify`].
    pub(super) fn target<'a>(&'a self, image: &'a GrayImage) -> Target<'a> {
        let image = if self.is_rectified { &self.rectified } else { image };
        Target { model: &self.model, id: self.id, camera: self.camera.rectified(), image }
    }

    /// Hands a frame to the backend.
    pub(super) fn take_frame(&mut self, image: &GrayImage) -> Result<()> {
        if !self.fits(image) {
            let ((w, h), Camera { width, height, .. }) = (image.dimensions(), self.camera);
            let problem = format!("{w}x{h}, but the camera has {width}x{height}");
            return Err(Error::invalid("frame", problem, "give frames and calibration of the same camera"));
        }
        self.rectify(image);
        let began = Instant::now();
        let image = if self.is_rectified { &self.rectified } else { image };
        self.backend.set_frame(image, self.aligner.levels(&self.model))?;
        self.times.set_frame_ms = ms_since(began);
        Ok(())
    }

    /// Is what came of a prediction to be checked by a search around it?
    pub(super) fn is_doubtful(&self, estimate: &PoseEstimate) -> bool {
        let fallen = self.course.correlation - FALLEN_CORRELATION;
        let fell = estimate.score.correlation < RECOVERED_CORRELATION.min(fallen);
        fell || !self.course.status(estimate, &self.model, &self.camera).has_pose()
    }

    pub(super) fn align_into(
        &mut self,
        image: &GrayImage,
        starts: &[Start],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        self.take_frame(image)?;
        let image = if self.is_rectified { &self.rectified } else { image };
        let target = Target { model: &self.model, id: self.id, camera: self.camera.rectified(), image };
        self.aligner.align(self.backend.as_mut(), &target, starts, estimates)?;
        self.times.align = self.aligner.times();
        let began = Instant::now();
        for (estimate, start) in estimates.iter_mut().zip(starts) {
            if !self.is_doubtful(estimate) {
                continue;
            }
            if let Some(found) = self.aligner.search(self.backend.as_mut(), &target, start)? {
                let iterations = estimate.iterations + found.iterations;
                let certain = found.score.correlation >= RECOVERED_CORRELATION;
                if certain && found.score.correlation > estimate.score.correlation {
                    *estimate = found;
                }
                estimate.iterations = iterations;
            }
        }
        self.times.search_ms = ms_since(began);
        Ok(())
    }
}
