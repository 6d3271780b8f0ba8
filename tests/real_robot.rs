//! The real robot data, where they are present (see `real_data.rs`): hand-eye calibration and alignment from perturbed
//! starts. With `AAM6D_FIGURES=1` the measured figures are printed.

mod support;

use std::collections::BTreeMap;
use std::path::Path;

use aam6d::align::{InverseCompositional, Start};
use aam6d::backend::CpuBackend;
use aam6d::dataset::robot::{read_hand_eye, read_robot};
use aam6d::dataset::{Dataset, PoseSource, Scene};
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

const CASES: [(&str, data::Case); 2] =
    [("franka_hand_eye", franka_hand_eye), ("franka_alignment", franka_alignment)];

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

/// Share of 20 starts (up to 10 mm and 3 degrees off) that end within 1 mm, 0.3 degrees and 0.7 px of the corners' poses, per frame:
/// the model once trained on the frame with the nearest view, once on all other frames. The starts are up to half a square
/// of the board off in the image, so the four pyramid levels of the default are needed: with three 145 of 160 come back.
fn franka_alignment(folder: &Path) -> Result<(), Failed> {
    let folder = folder.join("franka_chessboard");
    let dataset = Dataset::open(&folder)?;
    let scene = dataset.scene(1)?;
    let pnp = PoseSource::File(folder.join("test/000001/scene_pnp.json"));
    let poses = dataset.poses(1, 1, &pnp)?;
    let mesh = dataset.mesh(1)?;
    let object = EvalObject::new(&mesh)?;
    let mut shares = Vec::new();
    for others in [false, true] {
        let mut good = 0;
        for frame in &scene.frames {
            let truth = poses[&frame.id];
            let mut training: Vec<u32> = poses.keys().copied().filter(|&f| f != frame.id).collect();
            if !others {
                let angle = |f: u32| rotation_error_deg(&poses[&f], &truth).norm();
                training.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)));
                training.truncate(1);
            }
            let mut tracker = tracker(&mesh, &images(&scene, &poses, &training)?)?;
            let mut rng = ChaCha8Rng::seed_from_u64(u64::from(frame.id));
            let starts: Vec<Start> = (0..20)
                .map(|_| {
                    let turn = ball(&mut rng, 3_f64.to_radians());
                    let shift = Pose::about(turn, ball(&mut rng, 0.01), &object.centre());
                    Start { camera_from_object: truth.compose(&shift), appearance: Vec::new() }
                })
                .collect();
            let image = gray::read_sized(&frame.image, frame.camera.width, frame.camera.height)?;
            let ends = tracker.align(&image, &starts)?;
            let errors: Vec<[f64; 3]> = ends
                .iter()
                .map(|e| {
                    let p = &e.camera_from_object;
                    let t = translation_error_mm(p, &truth, &object.centre()).norm();
                    let px = corner_error_px(p, &truth, &object.corners(), &frame.camera);
                    [t, rotation_error_deg(p, &truth).norm(), px.unwrap_or(f64::INFINITY)]
                })
                .collect();
            let within = errors.iter().filter(|[t, r, px]| *t < 1.0 && *r < 0.3 && *px < 0.7).count();
            good += within;
            let middle = [0, 1, 2].map(|k| median(&errors.iter().map(|e| e[k]).collect::<Vec<_>>()));
            let trained = if others { "all others".to_owned() } else { training[0].to_string() };
            figure(&format!(
                "frame {}, trained on {trained}: {within}/20, median mm, deg, px {middle:.3?}",
                frame.id
            ));
        }
        figure(&format!("trained on {}: {good}/160", if others { "all other frames" } else { "one frame" }));
        shares.push(good);
    }
    check(shares[1] >= FRANKA_GOOD, format!("{shares:?} of 160 starts"))
}

/// 95 % of the starts.
const FRANKA_GOOD: usize = 152;
