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
mod tests {
    use super::*;

    fn sequence(change: impl FnOnce(&mut SequenceOptions)) -> Sequence {
        let mut options = SequenceOptions { frames: 4, ..SequenceOptions::default() };
        change(&mut options);
        Sequence::new(options).expect("good options")
    }

    #[test]
    fn a_sequence_repeats_itself_and_differs_from_the_other() {
        let first = sequence(|_| ());
        assert_eq!(first.image(3), sequence(|o| o.frames = 50).image(3), "frame 3 of a longer sequence");
        let second = sequence(|o| o.sequence = 2);
        assert_ne!(first.pose(3), second.pose(3), "motion");
        assert_ne!(first.image(3), second.image(3), "image");
        assert_eq!(first.object(), second.object(), "the object is the same");
        let frames: Vec<_> = first.frames().collect();
        assert_eq!(frames.len(), 4, "length");
        assert_eq!(frames[2], (first.pose(2), first.image(2)), "the iterator gives the same frames");
    }

    #[test]
    fn objects_stay_in_the_image_and_move_a_few_pixels() {
        for (scene, number) in
            [(SceneKind::Relief, 1), (SceneKind::Relief, 2), (SceneKind::Box, 1), (SceneKind::Box, 2)]
        {
            let sequence = sequence(|o| (o.scene, o.sequence) = (scene, number));
            let camera = sequence.camera();
            let pixels = |k: usize| {
                let see = |v| camera.project(&sequence.pose(k).transform_point(v)).expect("in front");
                sequence.object().mesh.vertices.iter().map(see).collect::<Vec<_>>()
            };
            for k in 0..120 {
                let (now, next) = (pixels(k), pixels(k + 1));
                assert!(
                    now.iter().all(|p| camera.contains(p, 5.0)),
                    "{scene:?} {number}: frame {k} leaves the image"
                );
                let squares: f64 = now.iter().zip(&next).map(|(a, b)| (a - b).norm_squared()).sum();
                let rms = (squares / now.len() as f64).sqrt();
                assert!(rms < 5.0, "{scene:?} {number}: frame {k} moves by {rms} px");
            }
        }
    }

    #[test]
    fn box_shows_three_faces_throughout() {
        let sequence = sequence(|o| o.scene = SceneKind::Box);
        let mesh = &sequence.object().mesh;
        for k in 0..120 {
            let pose = sequence.pose(k);
            let seen = (0..12)
                .filter(|&t| {
                    let at = pose.transform_point(&mesh.corners(t)[0]).coords;
                    pose.rotate(&mesh.normal(t).normalize()).dot(&at.normalize()) < -0.1
                })
                .count();
            assert_eq!(seen, 6, "frame {k} shows {seen} triangles");
        }
    }

    #[test]
    fn light_changes_the_image_without_saturation() {
        for scene in [SceneKind::Relief, SceneKind::Box] {
            let lit = sequence(|o| (o.scene, o.light) = (scene, true));
            for k in [0, 30, 60, 90] {
                let image = lit.image(k);
                let (lo, hi) = image.iter().fold((255, 0), |(lo, hi), &v| (v.min(lo), v.max(hi)));
                assert!(lo > 0 && hi < 255, "{scene:?}, frame {k}: {lo}..{hi}");
            }
            assert_ne!(lit.image(0), sequence(|o| o.scene = scene).image(0), "light must be visible");
        }
    }

    #[test]
    fn wrong_options_are_named() {
        let refused = |change: fn(&mut SequenceOptions)| {
            let mut options = SequenceOptions::default();
            change(&mut options);
            Sequence::new(options).expect_err("refused").to_string()
        };
        assert!(refused(|o| o.frames = 0).starts_with("frames: 0 is out of range; give 1 to"), "frames");
        assert!(refused(|o| o.sequence = 3).starts_with("sequence: 3"), "sequence");
        assert!(refused(|o| o.occlusion = f64::NAN).starts_with("occlusion: NaN"), "occlusion");
        assert!(refused(|o| o.noise = -1.0).starts_with("noise: -1"), "noise");
        assert!(refused(|o| o.supersampling = 9).starts_with("supersampling: 9"), "supersampling");
    }
}
