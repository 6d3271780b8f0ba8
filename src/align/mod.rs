//! One frame: from a start pose to the pose that aligns the template with the image.

mod contribution;
mod covariance;
mod derivative;
mod edge;
mod evaluator;
mod forward_additive;
mod inspection;
mod inverse_compositional;
mod joint;
mod levenberg_marquardt;
mod look;
mod method;
mod normal_equations;
mod paper;
mod photometric;
mod rendering;
mod retry;
mod robust;
mod score;
mod search;
mod vertices;
mod visibility;
mod workspace;

use image::GrayImage;
use nalgebra::Matrix6;

use crate::backend::{Backend, ModelId};
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose};
use crate::model::Model;

pub use crate::model::Grouping;
pub use covariance::to_ros_order;
pub use edge::{Edge, EdgeOptions};
pub use forward_additive::{ForwardAdditive, ForwardOptions};
pub use inspection::{TriangleFit, VertexShift, triangle_fits, vertex_shifts};
pub use inverse_compositional::{InverseCompositional, Options};
pub use joint::Eye;
pub use method::Method;
pub use paper::{Order, Paper, PaperOptions};
pub use score::Score;

/// What is aligned: a model, loaded into a backend, seen by a pinhole camera.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    /// The model.
    pub model: &'a Model,
    /// Its id in the backend.
    pub id: ModelId,
    /// Camera of the current (rectified) frame, full size.
    pub camera: Camera,
    /// The current (rectified) frame, full size: the one the backend has.
    pub image: &'a GrayImage,
}

/// Where an alignment starts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Start {
    /// Pose `camera_from_object`.
    pub camera_from_object: Pose,
    /// Appearance parameters, l of them, in standard deviations of the training set.
    pub appearance: Vec<f64>,
}

/// The end of an alignment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoseEstimate {
    /// Pose `camera_from_object`.
    pub camera_from_object: Pose,
    /// Appearance parameters, l of them, in standard deviations of the training set.
    pub appearance: Vec<f64>,
    /// Covariance of the increment `[tx ty tz rx ry rz]` (metres, radians) in object axes about
    /// [`crate::model::Shape::centre`]; [`to_ros_order`] turns it into the camera frame. Zero where the pose is not
    /// determined.
    pub covariance: Matrix6<f64>,
    /// `JtQJ` of the increment (object axes about the centre, metres and radians) after gain, bias and appearance are
    /// eliminated: what the image says about the pose. Zero where the pose is not determined.
    pub hessian: Matrix6<f64>,
    /// Weighted root mean square residual (after gain and bias, where the method has them), grey levels.
    pub rms: f64,
    /// Solved steps over all levels or phases.
    pub iterations: usize,
    /// False if a level ran into the iteration limit or its equations could not be solved.
    pub converged: bool,
    /// How well template and image agree.
    pub score: Score,
}

/// Where the time of an alignment went: wall time, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct AlignTimes {
    /// What hides what, on the host.
    pub visibility_ms: f64,
    /// Work of the backend on the pixels, waiting included.
    pub accumulate_ms: f64,
    /// Weights, equations and steps, on the host.
    pub solve_ms: f64,
    /// Score and covariance of the estimate, the backend's part included.
    pub score_ms: f64,
}

impl std::ops::AddAssign for AlignTimes {
    fn add_assign(&mut self, other: Self) {
        self.visibility_ms += other.visibility_ms;
        self.accumulate_ms += other.accumulate_ms;
        self.solve_ms += other.solve_ms;
        self.score_ms += other.score_ms;
    }
}

/// Aligns a model with the current frame of a backend. An aligner may keep memory between frames, but no results.
pub trait Aligner: Send {
    /// Pyramid levels the frame must have.
    fn levels(&self, model: &Model) -> usize;

    /// Gets ready for a model that has just been loaded as `id`; called once before [`Self::align`]. Methods that
    /// need nothing but the model itself do nothing here.
    ///
    /// # Errors
    /// Those of [`Backend::load`], and [`crate::Error::Invalid`] if the model is of no use to the method.
    fn prepare(&mut self, _backend: &mut dyn Backend, _model: &Model, _id: ModelId) -> Result<()> {
        Ok(())
    }

    /// An aligner with the same choices, ready for the same models, for another stream.
    fn another(&self) -> Box<dyn Aligner>;

    /// Where the time of the last [`Self::align`] went; zero where a method does not measure it.
    fn times(&self) -> AlignTimes {
        AlignTimes::default()
    }

    /// Aligns every start on its own; estimates come in the order of the starts, in the memory of those that
    /// `estimates` had.
    ///
    /// # Errors
    /// Those of the backend. A start from which nothing is visible is no error: its score is zero.
    fn align(
        &mut self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()>;

    /// Has the method a way to serve many frames with the same calls, [`Self::align_streams`]?
    fn shares_calls(&self) -> bool {
        false
    }

    /// Aligns `starts[k]` with frame k of the backend, that of `targets[k]`, in calls that all of them share; the targets are
    /// of one model. Estimates are those of [`Self::align`] but for poses whose score says lost or that have not converged,
    /// where that may try something else.
    ///
    /// # Errors
    /// As [`Self::align`], and [`crate::Error::Invalid`] if the method has no such way.
    fn align_streams(
        &mut self,
        _backend: &mut dyn Backend,
        _targets: &[Target<'_>],
        _starts: &[Start],
        _estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        let problem = "this method aligns one frame at a time";
        Err(Error::invalid("streams", problem, "ask shares_calls first"))
    }

    /// As [`Self::align`] from starts that are right to a pixel or two, as a search ends: what hides a part of the object
    /// may be left out from the beginning. Methods without anything better align.
    ///
    /// # Errors
    /// As [`Self::align`].
    fn refine(
        &mut self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        self.align(backend, target, starts, estimates)
    }

    /// Looks for the object around a pose from which [`Self::align`] found nothing; `None` if the method has no
    /// search. The caller decides by the score whether to believe the estimate.
    ///
    /// # Errors
    /// Those of the backend.
    fn search(
        &mut self,
        _backend: &mut dyn Backend,
        _target: &Target<'_>,
        _around: &Start,
    ) -> Result<Option<PoseEstimate>> {
        Ok(None)
    }
}
