//! The scene of the basin study: views of the relief at given tilts, and seeded starts at given distances.

use image::GrayImage;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use super::data::TRAINING_IMAGES;
use super::methods::PerShape;
use crate::geometry::{Camera, Pose};
use crate::model::Model;
use crate::simulate::{Noise, Sequence, SequenceOptions};
use crate::train::{TrainOptions, TrainingImage, train};

/// Views per tilt, the tilt axis turned from one to the next.
const VIEWS: u32 = 6;
/// Frames between the training images: both ends of the tilt are among them.
const TRAINING_STEP: usize = 8;
/// Standard deviation of noise in the views, grey levels.
const NOISE: f64 = 2.0;
/// Starts before they are scaled to their distance: half widths of uniform displacements, metres and radians.
const SHIFT: [f64; 3] = [0.005, 0.005, 0.010];
const TURN: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// The model and what it is aligned with.
pub(super) struct Scene {
    seed: u64,
    sequence: Sequence,
    pub(super) camera: Camera,
    pub(super) landmarks: Vec<Point3<f64>>,
    pub(super) models: PerShape<Model>,
}

/// One picture with its true pose.
pub(super) struct View {
    pub(super) image: GrayImage,
    pub(super) pose: Pose,
    number: u64,
}

impl Scene {
    /// Trains on sequence 2; the views have the background of sequence 1.
    pub(super) fn new(seed: u64) -> anyhow::Result<Self> {
        let frames = TRAINING_STEP * TRAINING_IMAGES as usize;
        let other =
            Sequence::new(SequenceOptions { frames, seed, sequence: 2, ..SequenceOptions::default() })?;
        let images: Vec<TrainingImage> = (0..frames)
            .step_by(TRAINING_STEP)
            .map(|k| TrainingImage {
                image: other.image(k),
                camera: *other.camera(),
                camera_from_object: other.pose(k),
            })
            .collect();
        let mesh = &other.object().mesh;
        let models = PerShape::train(&TrainOptions::default(), |options| Ok(train(mesh, &images, options)?))?;
        let sequence = Sequence::new(SequenceOptions { seed, sequence: 1, ..SequenceOptions::default() })?;
        let camera = *sequence.camera();
        Ok(Self { seed, camera, landmarks: mesh.vertices.clone(), models, sequence })
    }

    fn random(&self, stream: u64) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(stream);
        random
    }

    /// Pictures at a tilt, each about another axis, a little shifted and rolled.
    pub(super) fn views(&self, tilt_deg: f64) -> Vec<View> {
        (0..VIEWS).map(|k| self.view(tilt_deg, k)).collect()
    }

    fn view(&self, tilt_deg: f64, k: u32) -> View {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "tilts are whole degrees"
        )]
        let number = (tilt_deg as u64) << 8 | u64::from(k);
        let mut random = self.random(number);
        let mut within = |half: f64| half * symmetric(&mut random);
        let axis = std::f64::consts::TAU * f64::from(k) / f64::from(VIEWS) + within(0.3);
        let tilt = UnitQuaternion::from_scaled_axis(
            Vector3::new(axis.cos(), axis.sin(), 0.0) * tilt_deg.to_radians(),
        );
        let roll = UnitQuaternion::from_scaled_axis(Vector3::z() * within(0.3));
        let at = Vector3::new(within(0.02), within(0.015), 0.61 + within(0.04));
        let pose = Pose::from_quaternion(tilt * roll, at);
        let noise = Some(Noise { sigma: NOISE, seed: self.seed, frame: number });
        let view = crate::simulate::View { pose, noise, ..self.sequence.view(0) };
        View { image: self.sequence.renderer().render_view(&view), pose, number }
    }

    /// Poses whose landmarks are `distance` pixels (rms) from where they should be. The same for every method.
    pub(super) fn starts(&self, view: &View, distance: f64, count: usize) -> Vec<Pose> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "distances are whole pixels"
        )]
        let mut random = self.random(1 << 40 | (distance as u64) << 20 | view.number);
        (0..count).map(|_| self.start(view, distance, &mut random)).collect()
    }

    fn start(&self, view: &View, distance: f64, random: &mut ChaCha8Rng) -> Pose {
        let shift = Vector3::from(SHIFT.map(|half| half * symmetric(random)));
        let turn = Vector3::from([TURN; 3].map(|half| half * symmetric(random)));
        let centre = self.models.cut.shape.centre;
        let moved = |scale: f64| view.pose.compose(&Pose::about(turn * scale, shift * scale, &centre));
        let (mut below, mut above) = (0.0, 64.0);
        for _ in 0..60 {
            let scale = (below + above) / 2.0;
            let away = rms_px(&self.camera, &self.landmarks, &moved(scale), &view.pose);
            if away.is_some_and(|px| px < distance) { below = scale } else { above = scale }
        }
        moved(below)
    }
}

/// Uniform in [-1, 1).
fn symmetric(random: &mut ChaCha8Rng) -> f64 {
    f64::from(random.next_u32()) / f64::from(1_u32 << 31) - 1.0
}

/// Root mean square displacement of the landmarks between two poses; `None` behind the camera.
pub(super) fn rms_px(camera: &Camera, landmarks: &[Point3<f64>], a: &Pose, b: &Pose) -> Option<f64> {
    let mut squares = Vec::with_capacity(landmarks.len());
    for x in landmarks {
        let at = |pose: &Pose| camera.project(&pose.transform_point(x));
        squares.push((at(a)? - at(b)?).norm());
    }
    crate::eval::statistics::rms(&squares)
}
