//! The paper's robot cell (section 3.4): a stereo camera on an end-effector that moves around a stationary relief.
//!
//! The left camera takes the two sequences, along the paths of the relief scene. A pair of images from the front serves
//! to click the landmarks, and some frames of each sequence are annotated for training. What a person or a robot would
//! contribute carries noise; the exact values are known beside it.

use std::collections::BTreeMap;

use image::GrayImage;
use nalgebra::{Point2, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::path::rotation;
use super::random::{Purpose, Stream, for_each_gaussian};
use super::render::{Noise, Renderer, View};
use super::sequence::{SceneKind, Sequence, SequenceOptions};
use crate::dataset::{Annotations, Landmark, StereoCalibration, stereo::Clicks};
use crate::error::{Error, Result};
use crate::geometry::stereo::ClickPair;
use crate::geometry::{Camera, Pose, StereoRig};

/// Scenes of the frontal pair, left and right.
pub const FRONTAL_SCENES: [u32; 2] = [3, 4];
/// Distance of the object in the frontal pair, metres.
const FRONTAL_DISTANCE: f64 = 0.58;
/// Distance between the two cameras, metres.
const BASELINE: f64 = 0.2;
/// Each camera is turned inwards by this angle (radians), so that both look at the object in the frontal pair.
const VERGENCE: f64 = 0.170_7;

/// What to simulate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CellOptions {
    /// Frames of each of the two sequences.
    pub frames: usize,
    /// Seed of print, clutter, motion and noise.
    pub seed: u64,
    /// Changing exposure and direction of light.
    pub light: bool,
    /// Standard deviation of the image noise, grey levels of 255.
    pub noise: f64,
    /// Standard deviation of a click, pixels per coordinate, 0 to 20.
    pub click_noise_px: f64,
    /// Standard deviation of the position that the robot reports, millimetres per axis, 0 to 50.
    pub kinematic_noise_mm: f64,
    /// Standard deviation of the orientation that the robot reports, degrees per axis, 0 to 5.
    pub kinematic_noise_deg: f64,
    /// Annotated training frames of each sequence.
    pub training_views: usize,
}

impl Default for CellOptions {
    fn default() -> Self {
        Self {
            frames: 120,
            seed: 1,
            light: false,
            noise: 2.0,
            click_noise_px: 0.3,
            kinematic_noise_mm: 0.0,
            kinematic_noise_deg: 0.0,
            training_views: 16,
        }
    }
}

impl CellOptions {
    /// Checks every value.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first value out of its range.
    pub fn validate(&self) -> Result<()> {
        self.sequence(1).validate()?;
        let ranges = [
            ("click noise", self.click_noise_px, 20.0, "px"),
            ("kinematic noise", self.kinematic_noise_mm, 50.0, "mm"),
            ("kinematic noise", self.kinematic_noise_deg, 5.0, "degrees"),
        ];
        for (what, value, most, unit) in ranges {
            if !(0.0..=most).contains(&value) {
                let problem = format!("{value} {unit} is out of range");
                return Err(Error::invalid(what, problem, format!("give 0 to {most} {unit}")));
            }
        }
        if self.training_views == 0 {
            return Err(Error::invalid("training views", "0 is out of range", "give at least 1"));
        }
        Ok(())
    }

    /// Options of the images of a sequence, 1 or 2.
    pub fn sequence(&self, sequence: u32) -> SequenceOptions {
        SequenceOptions {
            scene: SceneKind::Relief,
            frames: self.frames,
            seed: self.seed,
            sequence,
            light: self.light,
            noise: self.noise,
            ..SequenceOptions::default()
        }
    }
}

/// The cell: what is constant in it, and all that is read off it.
#[derive(Debug, Clone)]
pub struct Cell {
    options: CellOptions,
    sequences: [Sequence; 2],
}

impl Cell {
    /// Paints object and clutter.
    ///
    /// # Errors
    /// As [`CellOptions::validate`].
    pub fn new(options: CellOptions) -> Result<Self> {
        options.validate()?;
        Ok(Self {
            options,
            sequences: [Sequence::new(options.sequence(1))?, Sequence::new(options.sequence(2))?],
        })
    }

    /// The options it was made with.
    pub fn options(&self) -> &CellOptions {
        &self.options
    }

    /// The two sequences of the left camera.
    pub fn sequences(&self) -> &[Sequence; 2] {
        &self.sequences
    }

    /// The pair of cameras.
    pub fn stereo(&self) -> StereoCalibration {
        let [left, right] = FRONTAL_POSES.map(|from_middle| from_middle());
        let rig = StereoRig {
            left: *self.sequences[0].camera(),
            right: Camera::pinhole(806.0, 805.0, 317.2, 243.1, 640, 480),
            right_from_left: right.compose(&left.inverse()),
        };
        StereoCalibration { rig, left_scene: FRONTAL_SCENES[0], right_scene: FRONTAL_SCENES[1] }
    }

    /// Exact `camera_from_object` of the frontal pair, left and right.
    pub fn frontal_poses(&self) -> [Pose; 2] {
        let middle_from_object = Pose::from_quaternion(
            rotation(Vector3::new(0.05, -0.03, 0.02)),
            Vector3::new(0.0, 0.0, FRONTAL_DISTANCE),
        );
        FRONTAL_POSES.map(|from_middle| from_middle().compose(&middle_from_object))
    }

    /// Images of the frontal pair.
    ///
    /// # Errors
    /// None with the standard object and cameras; those of [`Renderer::new`].
    pub fn frontal_images(&self) -> Result<[GrayImage; 2]> {
        let rig = self.stereo().rig;
        let mut images = Vec::new();
        for ((camera, pose), scene) in
            [rig.left, rig.right].into_iter().zip(self.frontal_poses()).zip(FRONTAL_SCENES)
        {
            let index = u64::from(scene);
            let sigma = self.options.noise;
            let noise = (sigma > 0.0).then_some(Noise { sigma, seed: self.options.seed, frame: index << 32 });
            let renderer = Renderer::new(self.sequences[0].object().clone(), camera)?
                .with_clutter(self.options.seed, index);
            images.push(renderer.render_view(&View { pose, noise, ..View::default() }));
        }
        images.try_into().map_err(|_| Error::invalid("cell", "no pair of images", "report this as a bug"))
    }

    /// Exact landmarks in the object frame.
    pub fn landmarks(&self) -> Vec<Landmark> {
        let vertices = self.sequences[0].object().mesh.vertices.iter().enumerate();
        let landmark = |(k, &position)| Landmark { name: name(k), position, covariance: Default::default() };
        vertices.map(landmark).collect()
    }

    /// What a person clicks in the frontal pair.
    pub fn clicks(&self) -> Clicks {
        let rig = self.stereo().rig;
        let [left, right] = self.frontal_poses();
        let left = self.pixels(&rig.left, &left, Some(0));
        let right = self.pixels(&rig.right, &right, Some(1));
        let pair = |(k, (left, right))| ClickPair { name: name(k), left, right };
        let sigma = self.options.click_noise_px;
        Clicks {
            frames: Some([0, 0]),
            sigma_px: (sigma > 0.0).then_some(sigma),
            pairs: left.into_iter().zip(right).enumerate().map(pair).collect(),
        }
    }

    /// Training frames of a sequence (0 or 1), spread evenly.
    pub fn training_frames(&self) -> Vec<u32> {
        let (n, views) = (self.options.frames, self.options.training_views.min(self.options.frames));
        (0..views).map(|k| u32::try_from(k * n / views).unwrap_or(u32::MAX)).collect()
    }

    /// Landmarks in the training frames of a sequence (0 or 1): as a person clicks them, or exact.
    pub fn annotations(&self, sequence: usize, exact: bool) -> Annotations {
        let images = &self.sequences[sequence];
        let pixels = |frame: u32| {
            let stream = (sequence as u64 + 1) << 32 | u64::from(frame);
            self.pixels(images.camera(), &images.pose(frame as usize), (!exact).then_some(stream))
        };
        let names = (0..images.object().mesh.vertices.len()).map(name).collect();
        let frames = self.training_frames().into_iter().map(|frame| (frame, pixels(frame))).collect();
        let sigma = self.options.click_noise_px;
        Annotations { names, sigma_px: (!exact && sigma > 0.0).then_some(sigma), frames }
    }

    /// Where the landmarks are in an image, with the noise of the random stream of this number.
    fn pixels(&self, camera: &Camera, pose: &Pose, noise: Option<u64>) -> Vec<Point2<f64>> {
        let vertices = &self.sequences[0].object().mesh.vertices;
        let project = |x| camera.project(&pose.transform_point(x)).expect("the object is in front");
        let exact = vertices.iter().map(project);
        let mut off = vec![0.0; 2 * vertices.len()];
        if let Some(stream) = noise {
            let sigma = self.options.click_noise_px;
            let mut random = Stream::new(self.options.seed, Purpose::Click, stream);
            for_each_gaussian(&mut random, &mut off, |v, z| *v = sigma * z);
        }
        exact.zip(off.chunks(2)).map(|(p, d)| p + Vector2::new(d[0], d[1])).collect()
    }

    /// The exact hand-eye transform, `effector_from_camera`.
    pub fn hand_eye(&self) -> Pose {
        let turn = rotation(Vector3::new(0.03, -0.02, 1.55));
        Pose::from_quaternion(turn, Vector3::new(0.058, -0.034, -0.042))
    }

    /// The hand-eye transform as calibrated: off by as much as one pose of the robot.
    pub fn calibrated_hand_eye(&self) -> Pose {
        self.hand_eye().compose(&self.kinematic_error(0))
    }

    /// Where the object stands: flat on a table beside the robot, its front up.
    pub fn base_from_object(&self) -> Pose {
        let turn = rotation(Vector3::new(3.08, 0.04, 0.05));
        Pose::from_quaternion(turn, Vector3::new(0.45, -0.06, 0.09))
    }

    /// Poses `base_from_effector` of a sequence (0 or 1): as the robot reports them, or exact.
    pub fn robot(&self, sequence: usize, exact: bool) -> BTreeMap<u32, Pose> {
        let (base_from_object, camera_from_effector) = (self.base_from_object(), self.hand_eye().inverse());
        let pose = |frame: usize| {
            let camera_from_object = self.sequences[sequence].pose(frame);
            base_from_object.compose(&camera_from_object.inverse()).compose(&camera_from_effector)
        };
        (0..self.options.frames)
            .map(|k| {
                let stream = (sequence as u64 + 1) << 32 | k as u64;
                let noise = if exact { Pose::identity() } else { self.kinematic_error(stream) };
                (u32::try_from(k).unwrap_or(u32::MAX), pose(k).compose(&noise))
            })
            .collect()
    }

    fn kinematic_error(&self, stream: u64) -> Pose {
        let mut z = [0.0; 6];
        let mut random = Stream::new(self.options.seed, Purpose::Robot, stream);
        for_each_gaussian(&mut random, &mut z, |v, z| *v = z);
        let (t, r) = (Vector3::new(z[0], z[1], z[2]), Vector3::new(z[3], z[4], z[5]));
        let degrees = self.options.kinematic_noise_deg * std::f64::consts::PI / 180.0;
        Pose::from_quaternion(rotation(r * degrees), t * (self.options.kinematic_noise_mm / 1000.0))
    }
}

/// The left and the right camera from the middle between them.
const FRONTAL_POSES: [fn() -> Pose; 2] = [|| from_middle(-1.0), || from_middle(1.0)];

fn from_middle(side: f64) -> Pose {
    let turned = Pose::from_quaternion(rotation(Vector3::new(0.0, side * VERGENCE, 0.0)), Vector3::zeros());
    let shift = Vector3::new(-side * BASELINE / 2.0, 0.0, 0.0);
    turned.compose(&Pose::from_quaternion(Default::default(), shift))
}

/// Names of the landmarks.
fn name(k: usize) -> String {
    format!("p{k:02}")
}

#[cfg(test)]
#[path = "cell_tests.rs"]
mod tests;
