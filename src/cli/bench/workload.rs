//! The standard workload: a simulated relief, 640x480, about 72,000 chart pixels, three levels.

use image::GrayImage;

use crate::align::Start;
use crate::backend::TriangleWarp;
use crate::error::Result;
use crate::geometry::warp::homography;
use crate::geometry::{Camera, Pose};
use crate::model::{LevelTemplate, Model};
use crate::simulate::{SceneKind, Sequence, SequenceOptions};
use crate::train::{TrainOptions, TrainingImage, train};
use nalgebra::Vector3;

/// Training images: enough for eight modes.
const TRAINING_IMAGES: usize = 10;
/// Most appearance modes of any workload.
const MOST_MODES: usize = 8;
/// Smallest and largest distance of the start poses, metres and radians.
const START_OFFSET: f64 = 0.002;

/// Frames, true poses and the model with all modes.
pub(super) struct Workload {
    pub(super) images: Vec<GrayImage>,
    pub(super) poses: Vec<Pose>,
    pub(super) camera: Camera,
    model: Model,
}

impl Workload {
    /// Renders and trains.
    pub(super) fn new(frames: usize) -> Result<Self> {
        let options = |sequence, frames| SequenceOptions {
            scene: SceneKind::Relief,
            frames,
            sequence,
            light: true,
            supersampling: 2,
            ..SequenceOptions::default()
        };
        let trained_on = Sequence::new(options(2, TRAINING_IMAGES))?;
        let images: Vec<_> = (0..TRAINING_IMAGES)
            .map(|k| TrainingImage {
                image: trained_on.image(k),
                camera: *trained_on.camera(),
                camera_from_object: trained_on.pose(k),
            })
            .collect();
        let options_of_model = TrainOptions { modes: MOST_MODES, ..TrainOptions::default() };
        let model = train(&trained_on.object().mesh, &images, &options_of_model)?;
        let tracked = Sequence::new(options(1, frames))?;
        Ok(Self {
            images: (0..frames).map(|k| tracked.image(k)).collect(),
            poses: (0..frames).map(|k| tracked.pose(k)).collect(),
            camera: *tracked.camera(),
            model,
        })
    }

    /// Pixels per level.
    pub(super) fn pixels(&self) -> Vec<usize> {
        self.model.levels.iter().map(|level| level.pixels.len()).collect()
    }

    /// The model with its first `modes` modes.
    pub(super) fn model(&self, modes: usize) -> Result<Model> {
        let (shape, views) = (&self.model.shape, &self.model.views);
        let cut = |(k, level): (usize, &LevelTemplate)| {
            let mut pixels = level.pixels.clone();
            pixels.modes.truncate(modes);
            LevelTemplate::new(shape, views, k, pixels, level.charts.clone())
        };
        let levels = self.model.levels.iter().enumerate().map(cut).collect::<Result<_>>()?;
        Ok(Model { levels, ..self.model.clone() })
    }

    /// Warps of all triangles of the full size at the true pose of the first frame.
    pub(super) fn warps(&self, model: &Model) -> Vec<TriangleWarp> {
        let warp = |g: &Option<crate::model::ChartGeometry>| TriangleWarp {
            image_from_chart: g.as_ref().map_or_else(nalgebra::Matrix3::zeros, |g| {
                homography(&self.camera, &self.poses[0], &g.object_from_chart)
            }),
            active: g.is_some(),
        };
        model.levels[0].geometry.iter().map(warp).collect()
    }

    /// Start poses around the true pose of the first frame.
    pub(super) fn starts(&self, model: &Model, count: usize) -> Vec<Start> {
        let start = |k: usize| {
            // A spiral on the sphere: no two are the same, and no random numbers are needed.
            #[expect(clippy::cast_precision_loss, reason = "small counts")]
            let (k, n) = (k as f64 + 0.5, count as f64);
            let (z, angle) = (1.0 - 2.0 * k / n, 2.4 * k);
            let ring = (1.0 - z * z).max(0.0).sqrt();
            let direction = Vector3::new(ring * angle.cos(), ring * angle.sin(), z);
            let moved =
                Pose::about(10.0 * START_OFFSET * direction, START_OFFSET * direction, &model.shape.centre);
            Start { camera_from_object: self.poses[0].compose(&moved), appearance: vec![0.0; model.modes()] }
        };
        (0..count).map(start).collect()
    }
}
