//! Simulated sequences, models trained on them, and how far poses are from the truth.

use std::collections::BTreeMap;

use aam6d::align::{InverseCompositional, Options, PoseEstimate, Start};
use aam6d::backend::{Backend, CpuBackend};
use aam6d::eval::{Estimate, EvalObject, Evaluation, evaluate};
use aam6d::geometry::{Camera, Pose};
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{SceneKind, Sequence, SequenceOptions};
use aam6d::track::{Status, Tracked, Tracker};
use aam6d::train::{TrainOptions, TrainingImage, train};
use nalgebra::{Point3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Standard deviations of a random motion, metres and radians: each moves the landmarks of the relief by about the
/// same distance. Only their ratios matter, the size is set in pixels.
const SPREAD: [f64; 6] = [0.7e-3, 0.7e-3, 5.2e-3, 0.051, 0.043, 0.0091];

/// A sequence of the standard scenes.
pub(crate) fn sequence(scene: SceneKind, number: u32, noise: f64) -> Sequence {
    let options = SequenceOptions { scene, sequence: number, noise, ..SequenceOptions::default() };
    Sequence::new(options).expect("good options")
}

/// A frame of a sequence to train on.
pub(crate) fn training_image(sequence: &Sequence, frame: usize) -> TrainingImage {
    TrainingImage {
        image: sequence.image(frame),
        camera: *sequence.camera(),
        camera_from_object: sequence.pose(frame),
    }
}

/// A model trained on frames of a sequence.
pub(crate) fn trained(sequence: &Sequence, frames: &[usize], options: &TrainOptions) -> Model {
    let images: Vec<_> = frames.iter().map(|&k| training_image(sequence, k)).collect();
    train(&sequence.object().mesh, &images, options).expect("the object is in view")
}

/// Sixteen frames over 120, as the demo takes them.
pub(crate) fn sixteen() -> Vec<usize> {
    (0..16).map(|k| k * 119 / 15).collect()
}

/// A tracker with the default method.
pub(crate) fn tracker(model: &Model, camera: Camera, backend: Box<dyn Backend>) -> Tracker {
    tracker_with(model, camera, backend, Options::default())
}

/// A tracker with chosen options of the method.
pub(crate) fn tracker_with(
    model: &Model,
    camera: Camera,
    backend: Box<dyn Backend>,
    options: Options,
) -> Tracker {
    Tracker::new(model.clone(), camera, backend, Box::new(InverseCompositional::new(options)))
        .expect("the model fits the backend")
}

/// The CPU backend.
pub(crate) fn cpu() -> Box<dyn Backend> {
    Box::new(CpuBackend::new())
}

/// Root mean square distance of the projected points at two poses, pixels; infinite behind the camera.
pub(crate) fn distance_px(camera: &Camera, points: &[Point3<f64>], a: &Pose, b: &Pose) -> f64 {
    let square = |x: &Point3<f64>| {
        let at = |pose: &Pose| camera.project(&pose.transform_point(x));
        at(a).zip(at(b)).map_or(f64::INFINITY, |(p, q)| (p - q).norm_squared())
    };
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    let mean = points.iter().map(square).sum::<f64>() / points.len() as f64;
    mean.sqrt()
}

/// Random motions of a pose that move the points of an object by a given distance.
pub(crate) struct Disturbance {
    rng: ChaCha8Rng,
    camera: Camera,
    points: Vec<Point3<f64>>,
    centre: Point3<f64>,
}

impl Disturbance {
    pub(crate) fn new(seed: u64, camera: Camera, points: &[Point3<f64>], centre: Point3<f64>) -> Self {
        Self { rng: ChaCha8Rng::seed_from_u64(seed), camera, points: points.to_vec(), centre }
    }

    /// The pose after a random motion that moves the points by `px` (rms).
    pub(crate) fn apply(&mut self, pose: &Pose, px: f64) -> Pose {
        let direction = Vector6::from(SPREAD.map(|s| s * gauss(&mut self.rng)));
        let at = |size: f64| pose.compose(&Pose::increment(&(direction * size), &self.centre));
        let moved = |size: f64| distance_px(&self.camera, &self.points, pose, &at(size));
        // The first size that moves the points far enough, bisected.
        let mut far = 1e-3;
        while moved(far) < px {
            far *= 1.5;
        }
        let mut near = far / 1.5;
        for _ in 0..30 {
            let middle = (near + far) / 2.0;
            if moved(middle) < px { near = middle } else { far = middle }
        }
        assert!((moved(near) / px - 1.0).abs() < 1e-3, "{} px instead of {px}", moved(near));
        at(near)
    }
}

/// A sum of twelve uniform numbers.
fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| rng.random_range(-0.5..0.5)).sum()
}

/// A start without appearance parameters.
pub(crate) fn start(model: &Model, camera_from_object: Pose) -> Start {
    Start { camera_from_object, appearance: vec![0.0; model.modes()] }
}

/// Tracks the given frames in their order from a start pose. The frames are numbered from 0.
pub(crate) fn track(tracker: &mut Tracker, start: Pose, frames: &[GrayImage]) -> Vec<Tracked> {
    tracker.start_at(start);
    frames.iter().map(|image| tracker.track(image).expect("the frame fits the camera")).collect()
}

/// Judges a track against the true poses.
pub(crate) fn judge(sequence: &Sequence, tracked: &[Tracked], truth: &[Pose]) -> Evaluation {
    let number = |k: usize| u32::try_from(k).expect("few frames");
    let estimates: Vec<Estimate> =
        tracked.iter().enumerate().map(|(k, t)| estimate(number(k), t.status, &t.estimate)).collect();
    let truth: BTreeMap<u32, Pose> = truth.iter().enumerate().map(|(k, p)| (number(k), *p)).collect();
    let cameras = truth.keys().map(|&k| (k, *sequence.camera())).collect();
    let object = EvalObject::new(&sequence.object().mesh).expect("a mesh");
    evaluate(&estimates, &truth, &object, &cameras).expect("there is a truth")
}

/// What is judged of a frame; a score of 0 means lost.
pub(crate) fn estimate(frame: u32, status: Status, estimate: &PoseEstimate) -> Estimate {
    #[expect(clippy::cast_precision_loss, reason = "iteration counts are small")]
    let iterations = Some(estimate.iterations as f64);
    let score = if status.has_pose() { estimate.score.correlation } else { 0.0 };
    Estimate { frame, pose: estimate.camera_from_object, score, time_s: None, iterations }
}

/// Shows a measured figure where the test's output is shown.
pub(crate) fn say(figure: std::fmt::Arguments<'_>) {
    #[expect(clippy::print_stdout, reason = "tests have no other way to show a figure")]
    {
        println!("{figure}");
    }
}
