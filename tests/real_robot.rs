//! The real robot data, where they are present (see `real_data.rs`): hand-eye calibration and alignment from perturbed
//! starts. With `AAM6D_FIGURES=1` the measured figures are printed.

mod support;

use std::collections::BTreeMap;
use std::path::Path;

use aam6d::align::{InverseCompositional, Start};
use aam6d::backend::CpuBackend;
use aam6d::dataset::robot::{read_hand_eye, read_robot};
use aam6d::dataset::{Dataset, FrameInfo, PoseSource, Scene};
use aam6d::eval::errors::{corner_error_px, rotation_error_deg, translation_error_mm};
use aam6d::eval::statistics::median;
use aam6d::eval::{EvalObject, RobotCell, robot::robot_errors};
use aam6d::geometry::hand_eye::{calibrate, closed_form};
use aam6d::geometry::{Pose, TriangleMesh};
use aam6d::imaging::gray;
use aam6d::track::Tracker;
use aam6d::train::{TrainOptions, TrainingImage, train};
use libtest_mimic::Failed;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::data::{self, check, figure};

const CASES: [(&str, data::Case); 3] = [
    ("franka_hand_eye", franka_hand_eye),
    ("franka_alignment", franka_alignment),
    ("franka_pairs", franka_pairs),
];

fn main() {
    data::main(CASES.map(|(name, case)| data::trial(name, case)).into());
}

fn images(scene: &Scene, poses: &BTreeMap<u32, Pose>, frames: &[u32]) -> Result<Vec<TrainingImage>, Failed> {
    let mut images = Vec::new();
    for frame in scene.frames.iter().filter(|f| frames.contains(&f.id)) {
        let image = gray::read_sized(&frame.image, frame.camera.width, frame.camera.height)?;
        images.push(TrainingImage { image, camera: frame.camera, camera_from_object: poses[&frame.id] });
    }
    Ok(images)
}

fn tracker(mesh: &TriangleMesh, images: &[TrainingImage]) -> Result<Tracker, Failed> {
    let model = train(mesh, images, &TrainOptions::default())?;
    let aligner = Box::new(InverseCompositional::default());
    Ok(Tracker::new(model, images[0].camera, Box::new(CpuBackend::new()), aligner)?)
}

/// From the poses of the corners and the robot, as the data's own calibration (Park) has it.
fn franka_hand_eye(folder: &Path) -> Result<(), Failed> {
    let folder = folder.join("franka_chessboard");
    let scene = folder.join("test/000001");
    let robot = read_robot(&scene.join("scene_robot.json"))?;
    let pnp = PoseSource::File(scene.join("scene_pnp.json"));
    let seen = Dataset::open(&folder)?.poses(1, 1, &pnp)?;
    let published = read_hand_eye(&scene.join("hand_eye.json"))?.effector_from_camera;
    let effector: Vec<Pose> = robot.values().copied().collect();
    let object: Vec<Pose> = seen.values().copied().collect();
    for (name, found, limit) in
        [("park", closed_form(&effector, &object)?, 0.5), ("refined", calibrate(&effector, &object)?, 5.0)]
    {
        let x = &found.effector_from_camera;
        let t = (x.translation() - published.translation()).norm() * 1000.0;
        let r = rotation_error_deg(x, &published).norm();
        let rms = |v: Vec<f64>| (v.iter().sum::<f64>() / 8.0).sqrt();
        let left = rms(found.residuals.iter().map(|r| r.translation.norm_squared()).collect()) * 1000.0;
        let turned = rms(found.residuals.iter().map(|r| r.rotation.norm_squared()).collect()).to_degrees();
        figure(&format!(
            "{name}: {t:.3} mm {r:.4} deg from Park; residuals {left:.2} mm {turned:.3} deg rms"
        ));
        check(t < limit && r < 0.5, format!("{name}: {t} mm, {r} deg from the published one"))?;
    }
    let tracked: Vec<(u32, Pose)> = seen.into_iter().collect();
    let cell = RobotCell { base_from_effector: robot, effector_from_camera: published };
    let errors = robot_errors(&tracked, &cell);
    figure(&format!(
        "relative motion, PnP against robot: {:?} mm {:?} deg rms",
        errors.rms_t_mm, errors.rms_r_deg
    ));
    check(errors.frames == 7 && errors.rms_t_mm.is_some_and(|t| t < 8.0), format!("{errors:?}"))
}

/// Uniform in a ball of this radius.
fn ball(rng: &mut ChaCha8Rng, radius: f64) -> Vector3<f64> {
    loop {
        let mut one = || rng.random_range(-1.0..1.0);
        let v = Vector3::new(one(), one(), one());
        if v.norm() <= 1.0 {
            return v * radius;
        }
    }
}

/// The chessboard, with the poses of its corners for truth.
struct Board {
    scene: Scene,
    poses: BTreeMap<u32, Pose>,
    mesh: TriangleMesh,
    object: EvalObject,
}

/// Where starts around the truth of a frame ended.
struct Ends {
    /// Millimetres, degrees, pixels of the corners.
    errors: Vec<[f64; 3]>,
    /// The same from the true pose itself: what is left where nothing has to be found.
    from_truth: [f64; 3],
    /// Ends beside that of the true pose.
    beside: usize,
}

impl Ends {
    /// Within 1 mm, 0.3 degrees and 0.7 px of the corners' pose.
    fn good(&self) -> usize {
        self.errors.iter().filter(|[t, r, px]| *t < 1.0 && *r < 0.3 && *px < 0.7).count()
    }

    fn median(&self) -> [Option<f64>; 3] {
        [0, 1, 2].map(|k| median(&self.errors.iter().map(|e| e[k]).collect::<Vec<_>>()))
    }
}

impl Board {
    fn open(folder: &Path) -> Result<Self, Failed> {
        let folder = folder.join("franka_chessboard");
        let dataset = Dataset::open(&folder)?;
        let pnp = PoseSource::File(folder.join("test/000001/scene_pnp.json"));
        let (poses, mesh) = (dataset.poses(1, 1, &pnp)?, dataset.mesh(1)?);
        Ok(Self { scene: dataset.scene(1)?, poses, object: EvalObject::new(&mesh)?, mesh })
    }

    /// Angle between the views of two frames, degrees.
    fn angle(&self, a: u32, b: u32) -> f64 {
        rotation_error_deg(&self.poses[&a], &self.poses[&b]).norm()
    }

    /// 20 starts up to 10 mm and 3 degrees off, aligned with a model of some frames.
    fn align(&self, frame: &FrameInfo, training: &[u32]) -> Result<Ends, Failed> {
        let truth = self.poses[&frame.id];
        let mut tracker = tracker(&self.mesh, &images(&self.scene, &self.poses, training)?)?;
        let mut rng = ChaCha8Rng::seed_from_u64(u64::from(frame.id));
        let start = |camera_from_object| Start { camera_from_object, appearance: Vec::new() };
        let mut starts = vec![start(truth)];
        for _ in 0..20 {
            let turn = ball(&mut rng, 3_f64.to_radians());
            let shift = Pose::about(turn, ball(&mut rng, 0.01), &self.object.centre());
            starts.push(start(truth.compose(&shift)));
        }
        let image = gray::read_sized(&frame.image, frame.camera.width, frame.camera.height)?;
        let ends = tracker.align(&image, &starts)?;
        let px = |a: &Pose, b: &Pose| {
            corner_error_px(a, b, &self.object.corners(), &frame.camera).unwrap_or(f64::INFINITY)
        };
        let error = |p: &Pose| {
            let t = translation_error_mm(p, &truth, &self.object.centre()).norm();
            [t, rotation_error_deg(p, &truth).norm(), px(p, &truth)]
        };
        let poses: Vec<Pose> = ends.iter().map(|e| e.camera_from_object).collect();
        Ok(Ends {
            from_truth: error(&poses[0]),
            beside: poses[1..].iter().filter(|p| px(p, &poses[0]) < 0.5).count(),
            errors: poses[1..].iter().map(error).collect(),
        })
    }
}

/// Share of 20 starts per frame that end near the corners' poses: the model once trained on the frame with the nearest view
/// (113 of 160; see [`franka_pairs`]), once on all other frames. The starts are up to half a square of the board off in the image, so the four pyramid levels
/// of the default are needed: with three 145 of 160 come back.
fn franka_alignment(folder: &Path) -> Result<(), Failed> {
    let board = Board::open(folder)?;
    let mut shares = Vec::new();
    for others in [false, true] {
        let mut good = 0;
        for frame in &board.scene.frames {
            let mut training: Vec<u32> = board.poses.keys().copied().filter(|&f| f != frame.id).collect();
            if !others {
                training.sort_by(|&a, &b| board.angle(a, frame.id).total_cmp(&board.angle(b, frame.id)));
                training.truncate(1);
            }
            let ends = board.align(frame, &training)?;
            good += ends.good();
            let trained = if others { "all others".to_owned() } else { training[0].to_string() };
            figure(&format!(
                "frame {}, trained on {trained}: {}/20, median mm, deg, px {:.3?}",
                frame.id,
                ends.good(),
                ends.median()
            ));
        }
        figure(&format!("trained on {}: {good}/160", if others { "all other frames" } else { "one frame" }));
        shares.push(good);
    }
    check(shares[1] >= FRANKA_GOOD, format!("{shares:?} of 160 starts"))
}

/// Every other frame with a model of a single one: of frame 0, with `AAM6D_FIGURES=1` of each.
///
/// 1067 of all 1120 starts end beside the end of the true pose: the start has next to no part in what is missed. Per training
/// frame 131, 117, 112, 98, 0, 133, 111 and 115 of 140 are within the limits, give or take two or three by what rounding does to starts half a square off: a model of one frame is as wrong as that frame's
/// pose and lens, and all ends of a pair are within the limits or none (those of frame 4, the one with the nearest view of
/// frames 6 and 7, are off by 0.26 to 0.68 degrees).
fn franka_pairs(folder: &Path) -> Result<(), Failed> {
    let board = Board::open(folder)?;
    let all = std::env::var_os("AAM6D_FIGURES").is_some();
    let mut shares = Vec::new();
    for &other in board.poses.keys().filter(|&&f| all || f == 0) {
        let (mut good, mut beside) = (0, 0);
        for frame in board.scene.frames.iter().filter(|f| f.id != other) {
            let ends = board.align(frame, &[other])?;
            (good, beside) = (good + ends.good(), beside + ends.beside);
            figure(&format!(
                "frame {} by {other}, {:.0} deg apart: {}/20 within the limits, {}/20 end beside the true start, which is {:.2?} \
                 mm, deg, px off",
                frame.id,
                board.angle(other, frame.id),
                ends.good(),
                ends.beside,
                ends.from_truth
            ));
        }
        figure(&format!("trained on {other}: {good}/140 within the limits, {beside}/140 together"));
        shares.push(good);
    }
    check(shares[0] >= PAIRS_GOOD, format!("{shares:?} of 140 starts"))
}

/// 95 % of the starts with a model of seven frames.
const FRANKA_GOOD: usize = 152;
/// 90 % with one of frame 0 alone: the 95 % that a good model should have are just missed.
const PAIRS_GOOD: usize = 126;
