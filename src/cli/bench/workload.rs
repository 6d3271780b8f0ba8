//! The standard workload: a simulated relief, 640x480, 72,000 chart pixels, three levels.

use image::GrayImage;

use crate::align::Start;
use crate::backend::TriangleWarp;
use crate::error::Result;
use crate::geometry::warp::homography;
use crate::geometry::{Camera, Pose};
use crate::model::{Chart, LevelTemplate, Model, Pixels};
use crate::simulate::{SceneKind, Sequence, SequenceOptions};
use crate::train::{TrainOptions, TrainingImage, train};
use nalgebra::Vector3;

/// Training images: enough for all modes, spread over a sequence of so many frames.
const TRAINING_IMAGES: usize = 18;
const TRAINING_FRAMES: usize = 120;
/// Most appearance modes of any workload.
const MOST_MODES: usize = 16;
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
        let trained_on = Sequence::new(options(2, TRAINING_FRAMES))?;
        let images: Vec<_> = (0..TRAINING_IMAGES)
            .map(|k| k * (TRAINING_FRAMES - 1) / (TRAINING_IMAGES - 1))
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

    /// The model with its first `modes` modes and `pixels` pixels at full size, the other levels in proportion: pixels of
    /// a chart are left out or taken again, evenly, which changes the amount of work and nothing else.
    pub(super) fn model(&self, modes: usize, pixels: usize) -> Result<Model> {
        let (shape, views) = (&self.model.shape, &self.model.views);
        #[expect(clippy::cast_precision_loss, reason = "pixel counts are far below 2^52")]
        let share = pixels as f64 / self.model.levels[0].pixels.len() as f64;
        let cut = |(k, level): (usize, &LevelTemplate)| {
            let (pixels, charts) = resampled(level, share, modes);
            LevelTemplate::new(shape, views, k, pixels, charts)
        };
        let levels = self.model.levels.iter().enumerate().map(cut).collect::<Result<_>>()?;
        Ok(Model { levels, ..self.model.clone() })
    }

    /// Warps of all triangles of the full size at the true pose of the first frame, blurred as a tracker's are.
    pub(super) fn warps(&self, model: &Model) -> Vec<TriangleWarp> {
        let warp = |g: &Option<crate::model::ChartGeometry>| {
            g.as_ref().map_or_else(TriangleWarp::idle, |g| {
                let warp = homography(&self.camera, &self.poses[0], &g.object_from_chart);
                TriangleWarp::plain(warp).blurred(&g.centroid(), 0.0)
            })
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

/// `share` times as many pixels in every chart, and the first `modes` modes.
fn resampled(level: &LevelTemplate, share: f64, modes: usize) -> (Pixels, Vec<Chart>) {
    let (from, mut charts) = (&level.pixels, level.charts.clone());
    let mut taken = Vec::new();
    // Rounding is carried along, so that the whole has the right size.
    let (mut wanted, mut start) = (0.0, 0);
    for chart in &mut charts {
        let range = chart.range();
        wanted += f64::from(chart.end - chart.start) * share;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of pixels")]
        let end = if range.is_empty() { start } else { f64::round(wanted) as u32 };
        let count = (end - start) as usize;
        taken.extend((0..count).map(|k| range.start + k * range.len() / count));
        (chart.start, chart.end, start) = (start, end, end);
    }
    (from.picked(&taken, modes), charts)
}
