//! One frame: start poses, alignment, and a search around starts from which nothing was found.

use std::time::Instant;

use image::GrayImage;

use super::course::RECOVERED_CORRELATION;
use super::{FrameTimes, Tracker, ms_since};
use crate::align::{PoseEstimate, Start, Target};
use crate::error::{Error, Result};

/// A pose below [`RECOVERED_CORRELATION`] is checked by a search if the correlation fell by this since the last frame:
/// it may be a local minimum.
const FALLEN_CORRELATION: f64 = 0.1;

impl Tracker {
    /// Hands a frame to the backend; its time begins a new account.
    pub(super) fn take_frame(&mut self, image: &GrayImage) -> Result<()> {
        let expected = (self.camera.width, self.camera.height);
        if image.dimensions() != expected {
            let (w, h) = image.dimensions();
            let problem = format!("{w}x{h}, but the camera has {}x{}", expected.0, expected.1);
            return Err(Error::invalid("frame", problem, "give frames and calibration of the same camera"));
        }
        let began = Instant::now();
        self.is_rectified = self.rectifier.rectify_into(image, &mut self.rectified);
        let rectify_ms = ms_since(began);
        let image = if self.is_rectified { &self.rectified } else { image };
        self.backend.set_frame(image, self.aligner.levels(&self.model))?;
        let set_frame_ms = ms_since(began) - rectify_ms;
        self.times = FrameTimes { rectify_ms, set_frame_ms, ..FrameTimes::default() };
        Ok(())
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
            let fell = estimate.score.correlation
                < RECOVERED_CORRELATION.min(self.course.correlation - FALLEN_CORRELATION);
            if self.course.status(estimate, &self.model, &self.camera).has_pose() && !fell {
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
