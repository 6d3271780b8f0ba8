//! The one seam between host and device: per-pixel work over a frame, summed per triangle.
//!
//! Every stage exists twice with the same name: `shaders/<stage>.wgsl` and its readable twin
//! `src/backend/cpu/<stage>.rs`, which is its reference.

pub mod cpu;
#[cfg(feature = "gpu")]
pub mod gpu;
mod linearization;
mod local;
pub mod scanning;
mod sums;
pub mod templates;
mod warp;

use image::GrayImage;

use crate::error::{Error, Result};
use crate::model::Model;

pub use cpu::{CpuBackend, Implementation, Instructions};
#[cfg(feature = "gpu")]
pub use gpu::{AdapterSelection, AdapterSummary, GpuBackend, adapters};
pub use linearization::{LinearRow, Linearization};
pub use sums::{Sums, SumsRow};
pub use templates::{ScanPeak, ScanPoint, ScanRequest, ScanTemplates};
pub use warp::{SATURATED, SATURATED_SHARE, TEMPLATE_BLUR, TriangleWarp};

/// A model loaded into a backend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ModelId(pub(crate) usize);

/// One call of the `accumulate` or `linearize` stage: many poses of one model against the current frame.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// The model.
    pub model: ModelId,
    /// Pyramid level of the template.
    pub level: usize,
    /// Pyramid level of the image: the template's own, or another where the object is seen at another scale than in
    /// the reference view.
    pub image_level: usize,
    /// Number of poses B.
    pub items: usize,
    /// B numbers of current frames: the one that each pose is looked at in. Empty: all in the first.
    pub frames: &'a [usize],
    /// B times one warp per triangle.
    pub warps: &'a [TriangleWarp],
    /// B times the l appearance parameters.
    pub appearance: &'a [f32],
}

impl Request<'_> {
    /// Number of the frame that a pose is looked at in.
    pub fn frame_of(&self, item: usize) -> usize {
        self.frames.get(item).copied().unwrap_or(0)
    }

    /// Checks the sizes against the triangles and modes of the level, the number of current frames and that of their
    /// pyramid levels.
    ///
    /// # Errors
    /// [`Error::Invalid`] saying what does not fit.
    pub fn check(
        &self,
        triangles: usize,
        modes: usize,
        (frames, frame_levels): (usize, usize),
    ) -> Result<()> {
        let refuse =
            |problem: String, remedy: &str| Err(Error::invalid("accumulate request", problem, remedy));
        if self.image_level >= frame_levels {
            return refuse(
                format!("level {} of a frame with {frame_levels}", self.image_level),
                "call set_frame first",
            );
        }
        if !self.frames.is_empty() && self.frames.len() != self.items {
            let problem = format!("{} frames named for {} poses", self.frames.len(), self.items);
            return refuse(problem, "name one frame per pose, or none");
        }
        if let Some(frame) = self.frames.iter().find(|frame| **frame >= frames) {
            return refuse(format!("frame {frame} of {frames}"), "call set_frames with all of them first");
        }
        let warps = self.items * triangles;
        let appearance = self.items * modes;
        if self.warps.len() != warps || self.appearance.len() != appearance {
            let problem = format!(
                "{} warps and {} appearance parameters where {warps} and {appearance} are needed",
                self.warps.len(),
                self.appearance.len()
            );
            return refuse(problem, "give one warp per triangle and l parameters for every pose");
        }
        Ok(())
    }
}

/// What has crossed between host and device so far, on behalf of a backend and of all that share its device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Traffic {
    /// Times that work was handed to the device.
    pub submits: u64,
    /// Times that results were waited for and read.
    pub maps: u64,
    /// Bytes read back.
    pub bytes_read: u64,
}

/// Does the image work. One frame is current at a time, or, where a backend can, those of many streams.
pub trait Backend: Send {
    /// What a person calls it: `cpu`, or the adapter's name.
    fn name(&self) -> String;

    /// A backend with the models of this one and a frame of its own, for another stream. What is loaded is shared, not
    /// copied.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] if this backend cannot be shared, which is the default.
    fn another(&self) -> Result<Box<dyn Backend>> {
        Err(Error::invalid("backend", format!("{} cannot be shared", self.name()), "open one per stream"))
    }

    /// What has crossed to and from a device; nothing where there is none.
    fn traffic(&self) -> Traffic {
        Traffic::default()
    }

    /// Makes a model available.
    ///
    /// # Errors
    /// [`crate::Error::AdapterTooSmall`] if it does not fit the device.
    fn load(&mut self, model: &Model) -> Result<ModelId>;

    /// Makes `image` (rectified) the current frame and builds `levels` pyramid levels of it.
    ///
    /// # Errors
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Gpu`] if the device fails.
    fn set_frame(&mut self, image: &GrayImage, levels: usize) -> Result<()>;

    /// How many frames of a size (width, height) can be current at a time: more than one where a call that serves many
    /// streams costs less than a call for each.
    fn frames_at_once(&self, _size: (u32, u32)) -> usize {
        1
    }

    /// Makes all `images`, of one size, current; [`Request::frames`] says which one a pose is looked at in.
    ///
    /// # Errors
    /// As [`Self::set_frame`], and [`crate::Error::Invalid`] for images of different sizes and for more of them than
    /// [`Self::frames_at_once`].
    fn set_frames(&mut self, images: &[&GrayImage], levels: usize) -> Result<()> {
        match images {
            [image] => self.set_frame(image, levels),
            _ => {
                let problem = format!("{} frames for a backend that holds one", images.len());
                Err(Error::invalid("frames", problem, "ask frames_at_once first"))
            }
        }
    }

    /// Warps every active chart pixel into the current frame, forms r = T0 + sum lambda_k T_k - I (eq. 17) and adds
    /// up q r times its factors per triangle.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a request that does not fit the model or before the first frame,
    /// [`crate::Error::DeviceLost`] or [`crate::Error::Gpu`] if the device fails.
    fn accumulate(&mut self, request: &Request<'_>, sums: &mut Sums) -> Result<()>;

    /// As [`Self::accumulate`] with the gradient of the frame at the warped position in place of the template's,
    /// and with the second-order sums that make JtQJ of J = grad I(W) D. The template is compared as it is: blur and light of the
    /// warps are not looked at.
    ///
    /// # Errors
    /// As [`Self::accumulate`].
    fn linearize(&mut self, request: &Request<'_>, out: &mut Linearization) -> Result<()>;

    /// Scores sparse templates of a normalised gradient at every position of an image; `peaks` gets the best position
    /// of every tile, tile by tile (row by row) and template by template as chosen. Needs neither model nor frame, so
    /// a backend that does not say otherwise does it on the host.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for a request that does not fit, [`crate::Error::DeviceLost`] or
    /// [`crate::Error::Gpu`] if the device fails.
    fn scan(&mut self, request: &ScanRequest<'_>, peaks: &mut Vec<ScanPeak>) -> Result<()> {
        scanning::on_host(Implementation::default(), request, peaks)
    }
}
