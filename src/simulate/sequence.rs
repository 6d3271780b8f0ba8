//! The standard sequences: which scene, how many frames, which disturbances.

use image::GrayImage;
use serde::{Deserialize, Serialize};

use super::light::{Light, LightPath};
use super::object::{TexturedMesh, relief, textured_box};
use super::occluder::Occluder;
use super::path::Path;
use super::random::{Purpose, Stream};
use super::render::{Noise, Renderer, View};
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose};

/// Frames over which the occluder comes in.
const OCCLUDER_ENTERS_FRAMES: f64 = 10.0;

/// Turn of the occluder's edge per frame, radians.
const OCCLUDER_TURN: f64 = 0.03;

/// The two standard scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum SceneKind {
    /// A relief of 76 landmarks, 220 x 170 mm, tilted and rolled at 0.53 to 0.69 m; f = 800.
    #[default]
    Relief,
    /// A box of 165 x 68 x 80 mm that turns 45 degrees about its vertical axis at about 0.45 m; f = 700.
    Box,
    /// The same box going round by 360 degrees in 240 frames.
    Turntable,
}

impl SceneKind {
    /// The scene's camera, 640x480.
    pub fn camera(self) -> Camera {
        let f = match self {
            Self::Relief => 800.0,
            Self::Box | Self::Turntable => 700.0,
        };
        Camera::pinhole(f, f, 319.5, 239.5, 640, 480)
    }

    /// The scene's object; the seed changes its print, not its shape.
    pub fn object(self, seed: u64) -> TexturedMesh {
        match self {
            Self::Relief => relief(seed),
            Self::Box | Self::Turntable => textured_box(seed),
        }
    }
}

/// What to simulate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SequenceOptions {
    /// Object, camera and kind of motion.
    pub scene: SceneKind,
    /// Number of frames. Frame k does not depend on it.
    pub frames: usize,
    /// Seed of print, clutter, motion and noise.
    pub seed: u64,
    /// Which of the two sequences of a seed, 1 or 2: same object, other motion and clutter.
    pub sequence: u32,
    /// Changing exposure and direction of light.
    pub light: bool,
    /// Factor on all light, 0.1 to 10; from about 1.1 on bright parts saturate.
    pub exposure: f64,
    /// Share of the object's visible area behind a moving occluder, 0 to 0.6.
    pub occlusion: f64,
    /// Standard deviation of the noise, grey levels of 255, 0 to 50.
    pub noise: f64,
    /// Standard deviation of the optical blur, pixels, 0 to 10.
    pub blur: f64,
    /// Samples per pixel and axis, 1 to 8.
    pub supersampling: usize,
}

impl Default for SequenceOptions {
    fn default() -> Self {
        Self {
            scene: SceneKind::Relief,
            frames: 120,
            seed: 1,
            sequence: 1,
            light: false,
            exposure: 1.0,
            occlusion: 0.0,
            noise: 2.0,
            blur: 0.0,
            supersampling: 3,
        }
    }
}

impl SequenceOptions {
    /// Checks every value.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first value out of its range.
    pub fn validate(&self) -> Result<()> {
        let refuse = |what: &str, value: String, range: &str| {
            Err(Error::invalid(what, format!("{value} is out of range"), format!("give {range}")))
        };
        if !(1..=1_000_000).contains(&self.frames) {
            return refuse("frames", self.frames.to_string(), "1 to 1000000");
        }
        if !(1..=2).contains(&self.sequence) {
            return refuse("sequence", self.sequence.to_string(), "1 or 2");
        }
        if !(0.1..=10.0).contains(&self.exposure) {
            return refuse("exposure", self.exposure.to_string(), "a factor from 0.1 to 10");
        }
        if !(0.0..=0.6).contains(&self.occlusion) {
            return refuse("occlusion", self.occlusion.to_string(), "a share from 0 to 0.6");
        }
        if !(0.0..=50.0).contains(&self.noise) {
            return refuse("noise", self.noise.to_string(), "0 to 50 grey levels");
        }
        if !(0.0..=10.0).contains(&self.blur) {
            return refuse("blur", self.blur.to_string(), "0 to 10 pixels");
        }
        if !(1..=8).contains(&self.supersampling) {
            return refuse("supersampling", self.supersampling.to_string(), "1 to 8 samples per axis");
        }
        Ok(())
    }
}

/// A sequence with exact ground truth; every frame can be made on its own, in any order.
#[derive(Debug, Clone)]
pub struct Sequence {
    options: SequenceOptions,
    renderer: Renderer,
    path: Path,
    light: LightPath,
    occluder_angle: f64,
}

impl Sequence {
    /// Paints object and clutter.
    ///
    /// # Errors
    /// As [`SequenceOptions::validate`].
    pub fn new(options: SequenceOptions) -> Result<Self> {
        options.validate()?;
        let SequenceOptions { scene, seed, sequence, .. } = options;
        let index = u64::from(sequence);
        let renderer = Renderer::new(scene.object(seed), scene.camera())?
            .with_supersampling(options.supersampling)?
            .with_clutter(seed, index);
        let full_turn = 2.0 * std::f64::consts::PI;
        let occluder_angle = Stream::new(seed, Purpose::Occluder, index << 32).range(0.0, full_turn);
        let (path, light) = (Path::new(scene, seed, sequence), LightPath::new(seed, sequence));
        Ok(Self { options, renderer, path, light, occluder_angle })
    }

    /// The options it was made with.
    pub fn options(&self) -> &SequenceOptions {
        &self.options
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        self.renderer.camera()
    }

    /// The object.
    pub fn object(&self) -> &TexturedMesh {
        self.renderer.object()
    }

    /// The renderer, to look at the scene from elsewhere.
    pub fn renderer(&self) -> &Renderer {
        &self.renderer
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.options.frames
    }

    /// Never true: options without frames are refused.
    pub fn is_empty(&self) -> bool {
        self.options.frames == 0
    }

    /// True `camera_from_object` of a frame.
    pub fn pose(&self, frame: usize) -> Pose {
        self.path.pose(frame as f64)
    }

    /// Everything that a frame is rendered from.
    pub fn view(&self, frame: usize) -> View {
        let k = frame as f64;
        let entered = (k / OCCLUDER_ENTERS_FRAMES).min(1.0);
        let occluder = (self.options.occlusion > 0.0).then_some(Occluder {
            fraction: self.options.occlusion * entered * entered * (3.0 - 2.0 * entered),
            angle: self.occluder_angle + OCCLUDER_TURN * k,
        });
        let noise = (self.options.noise > 0.0).then_some(Noise {
            sigma: self.options.noise,
            seed: self.options.seed,
            frame: u64::from(self.options.sequence) << 32 | frame as u64,
        });
        let light = if self.options.light { self.light.at(k) } else { Light::default() };
        let light = Light { gain: light.gain * self.options.exposure, ..light };
        View { pose: self.pose(frame), light, occluder, blur: self.options.blur, noise }
    }

    /// Image of a frame.
    pub fn image(&self, frame: usize) -> GrayImage {
        self.renderer.render_view(&self.view(frame))
    }

    /// All frames in order, each made when it is asked for.
    pub fn frames(&self) -> impl ExactSizeIterator<Item = (Pose, GrayImage)> + '_ {
        (0..self.len()).map(|k| (self.pose(k), self.image(k)))
    }
}

#[cfg(test)]
#[path = "sequence_tests.rs"]
mod tests;
