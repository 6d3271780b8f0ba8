//! An object to be found in single images: random views of it, and where the search loses them.

use std::collections::BTreeMap;

use aam6d::align::{Aligner, InverseCompositional, Target};
use aam6d::backend::{Backend, CpuBackend, ModelId};
use aam6d::find::{FindOptions, Finder, Found, Priors, StageReport};
use aam6d::geometry::{Camera, Pose};
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{Light, Noise, Occluder, Renderer, SceneKind, View};
use aam6d::train::{TrainOptions, TrainingImage, train};
use nalgebra::{Point3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::tracking::{distance_px, say};

/// The tracker comes back from this far, pixels (rms over the mesh).
pub(crate) const BASIN_PX: f64 = 20.0;
/// A pose farther off than this must not be called certain, pixels.
const WRONG_PX: f64 = 10.0;
/// A hypothesis nearer than this to the truth is not lost yet.
const NEAR_PX: f64 = 30.0;
const SEED: u64 = 11;

/// A number of the environment.
pub(crate) fn number(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

pub(crate) fn seed() -> u64 {
    number("AAM6D_SEED").unwrap_or(SEED)
}

/// An object, a model trained on 13 views of a cap of 60 degrees, and what finds it.
pub(crate) struct Searched {
    pub(crate) scene: SceneKind,
    pub(crate) plain: Renderer,
    pub(crate) model: Model,
    pub(crate) backend: CpuBackend,
    pub(crate) id: ModelId,
    pub(crate) finder: Finder,
    pub(crate) seed: u64,
}

/// The middle of the cap: the front of the relief, a corner of the box.
fn facing(scene: SceneKind) -> Rotation3<f64> {
    let corner = Vector3::new(1.0, -1.0, -1.0).normalize();
    match scene {
        SceneKind::Relief => Rotation3::identity(),
        _ => Rotation3::rotation_between(&corner, &-Vector3::z()).expect("not opposite"),
    }
}

fn pose(scene: SceneKind, tilt: f64, azimuth: f64, roll: f64, translation: Vector3<f64>) -> Pose {
    let tilt = Rotation3::new(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0) * tilt);
    Pose::new(Rotation3::new(Vector3::z() * roll) * tilt * facing(scene), translation)
}

impl Searched {
    pub(crate) fn new(scene: SceneKind) -> Self {
        let camera = scene.camera();
        let plain = Renderer::new(scene.object(1), camera).expect("a standard object");
        let ring = |tilt: f64, shift: f64| {
            (0..6).map(move |k| (tilt.to_radians(), (f64::from(k) + shift) * std::f64::consts::FRAC_PI_3))
        };
        let views = std::iter::once((0.0, 0.0)).chain(ring(35.0, 0.0)).chain(ring(60.0, 0.5));
        let image = |(frame, (tilt, azimuth)): (u64, (f64, f64))| {
            let pose = pose(scene, tilt, azimuth, 0.0, Vector3::z() * 0.55);
            let noise = Some(Noise { sigma: 2.0, seed: 77, frame });
            let image = plain.render_view(&View { pose, noise, ..View::default() });
            TrainingImage { image, camera, camera_from_object: pose }
        };
        let images: Vec<_> = (0..).zip(views).map(image).collect();
        let model = train(&plain.object().mesh, &images, &TrainOptions::default()).expect("in view");
        let mut backend = CpuBackend::new();
        let id = backend.load(&model).expect("fits");
        let finder = Finder::new(&model, &camera, &FindOptions::default()).expect("charts");
        Self { scene, plain, model, backend, id, finder, seed: seed() }
    }

    pub(crate) fn camera(&self) -> Camera {
        *self.plain.camera()
    }

    pub(crate) fn vertices(&self) -> &[Point3<f64>] {
        &self.plain.object().mesh.vertices
    }

    /// Distance 0.35 to 0.9 m, any roll, tilt up to 60 degrees (uniform on the cap), most of the object in the image.
    pub(crate) fn random_pose(&self, rng: &mut ChaCha8Rng) -> Pose {
        loop {
            let tilt = rng.random_range(0.5..1.0_f64).acos();
            let [azimuth, roll] = [0, 1].map(|_| rng.random_range(0.0..std::f64::consts::TAU));
            let z: f64 = rng.random_range(0.35..0.9);
            let (x, y) = (rng.random_range(-0.4..0.4) * z, rng.random_range(-0.3..0.3) * z);
            let pose = pose(self.scene, tilt, azimuth, roll, Vector3::new(x, y, z));
            let seen = |x: &&Point3<f64>| {
                self.camera()
                    .project(&pose.transform_point(x))
                    .is_some_and(|p| self.camera().contains(&p, 0.0))
            };
            if 5 * self.vertices().iter().filter(seen).count() >= 4 * self.vertices().len() {
                return pose;
            }
        }
    }

    /// Half of the views before clutter, half of them lit from a side.
    pub(crate) fn image(&self, k: u64, pose: &Pose, occlusion: f64, rng: &mut ChaCha8Rng) -> GrayImage {
        let view = Self::random_view(k, pose, occlusion, rng);
        if k.is_multiple_of(2) || occlusion > 0.0 {
            self.plain.clone().with_clutter(self.seed, k).render_view(&view)
        } else {
            self.plain.render_view(&view)
        }
    }

    /// One of the views that [`Self::count`] looks at: pose and image.
    pub(crate) fn view(&self, number: u64, occlusion: f64) -> (Pose, GrayImage) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        for k in 0..number {
            let pose = self.random_pose(&mut rng);
            Self::random_view(k, &pose, occlusion, &mut rng);
        }
        let pose = self.random_pose(&mut rng);
        let image = self.image(number, &pose, occlusion, &mut rng);
        (pose, image)
    }

    fn random_view(k: u64, pose: &Pose, occlusion: f64, rng: &mut ChaCha8Rng) -> View {
        let aside = Vector3::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), -1.0);
        let lamp = Light {
            gain: rng.random_range(0.6..1.1),
            bias: rng.random_range(-10.0..10.0),
            direction: aside.normalize(),
            diffuse: 0.6,
        };
        let light = if (k / 2).is_multiple_of(2) { lamp } else { Light::default() };
        let angle = rng.random_range(0.0..std::f64::consts::TAU);
        let occluder = (occlusion > 0.0).then_some(Occluder { fraction: occlusion, angle });
        let noise = Some(Noise { sigma: 2.0, seed: 5, frame: k });
        View { pose: *pose, light, occluder, blur: 0.0, noise }
    }

    pub(crate) fn find(&mut self, image: &GrayImage, priors: &Priors) -> Found {
        let mut aligner = InverseCompositional::default();
        self.backend.set_frame(image, aligner.levels(&self.model)).expect("a frame");
        let target = Target { model: &self.model, id: self.id, camera: self.camera(), image };
        self.finder.find(&mut self.backend, &mut aligner, &target, priors).expect("a search")
    }

    /// Looks at so many random views.
    pub(crate) fn count(&mut self, views: u64, occlusion: f64) -> Tally {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let mut tally = Tally::default();
        for k in 0..views {
            let truth = self.random_pose(&mut rng);
            let image = self.image(k, &truth, occlusion, &mut rng);
            let began = cpu_time::ProcessTime::now();
            let found = self.find(&image, &Priors::default());
            let seconds = began.elapsed().as_secs_f64();
            self.judge(k, &truth, &found, &mut tally);
            (tally.seconds, tally.longest) = (tally.seconds + seconds, tally.longest.max(seconds));
        }
        let Tally { found, exact, wrong, .. } = tally;
        say(format_args!(
            "{:?}, {occlusion} hidden: {found} found, {exact} within 1 px, {wrong} wrong of {views}; {:.2} s of the process each, {:.2} at most",
            self.scene,
            tally.seconds / views as f64,
            tally.longest
        ));
        if std::env::var_os("AAM6D_FIGURES").is_some() {
            say(format_args!("lost in: {:?}", tally.lost_in));
        }
        tally
    }

    pub(crate) fn judge(&self, k: u64, truth: &Pose, found: &Found, tally: &mut Tally) {
        let px = |pose: &Pose| distance_px(&self.camera(), self.vertices(), truth, pose);
        let best = found.best.as_ref().map(|e| (px(&e.camera_from_object), e.score));
        if let Some((px, score)) = best.filter(|(px, _)| *px >= WRONG_PX) {
            say(format_args!("view {k}: a pose {px:.1} px off is believed, {score:.2?}"));
        }
        match best {
            Some((px, _)) if px < BASIN_PX => {
                tally.found += 1;
                tally.exact += u64::from(px < 1.0);
                return;
            }
            Some(_) => tally.wrong += 1,
            None => {}
        }
        // The first stage that leaves nothing near the truth.
        let near = |s: &StageReport| s.kept.iter().any(|pose| px(pose) < NEAR_PX);
        let stage = found.stages.iter().rposition(near).map_or(0, |last| last + 1);
        let name = found.stages.get(stage).map_or("choice", |s| s.stage);
        tally.lost_in.entry(name).or_default().push(k);
    }
}

/// What became of many views.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    /// Ended in the basin, and within a pixel.
    pub(crate) found: u64,
    pub(crate) exact: u64,
    /// Ended in a wrong pose that is believed.
    pub(crate) wrong: u64,
    /// Processor time of all searches, and of the longest.
    pub(crate) seconds: f64,
    pub(crate) longest: f64,
    /// Views that were not found, by the stage that lost them.
    pub(crate) lost_in: BTreeMap<&'static str, Vec<u64>>,
}
