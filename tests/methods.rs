//! Does every method come back to the true pose from a small disturbance, and does forward additive do so on both
//! backends alike?

mod support;

use std::process::ExitCode;
use std::sync::LazyLock;

use aam6d::align::{ForwardAdditive, Method, Order, Paper, PaperOptions, PoseEstimate, Start};
use aam6d::backend::{Backend, CpuBackend};
use aam6d::geometry::{Camera, Pose};
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{SceneKind, Sequence, SequenceOptions};
use aam6d::track::Tracker;
use aam6d::train::{TrainOptions, TrainingImage, train};
use libtest_mimic::{Failed, Trial};
use nalgebra::Vector3;

/// Disturbances, pixels (rms of the projected corners of the object's bounding box).
const DISTURBANCE_PX: f64 = 3.0;

fn main() -> ExitCode {
    let mut trials = Vec::new();
    for (method, limit_mm, limit_px) in [
        (Method::InverseCompositional, 0.2, 0.1),
        (Method::ForwardAdditive, 0.3, 0.1),
        (Method::Edge, 1.0, 0.3),
        (Method::Paper, 1.0, 0.3),
    ] {
        let test = move || comes_back(method, SceneKind::Relief, limit_mm, limit_px);
        trials.push(Trial::test(format!("relief/{method}"), test));
    }
    for method in [Method::ForwardAdditive, Method::Edge] {
        trials
            .push(Trial::test(format!("box/{method}"), move || comes_back(method, SceneKind::Box, 2.0, 0.5)));
    }
    trials.push(Trial::test("relief/paper_right_order", right_order_comes_back));
    trials.push(Trial::test("unprepared", methods_that_prepare_say_so));
    trials.push(Trial::test("names", every_method_has_its_name));
    trials.push(support::gpu::trial("forward_additive/cpu_gpu", on_gpu::backends_agree));
    libtest_mimic::run(&libtest_mimic::Arguments::from_args(), trials).exit_code()
}

/// A short rendered sequence: frame 0 to train on, the last one to align.
struct Scene {
    camera: Camera,
    frames: Vec<(Pose, GrayImage)>,
    cut: Model,
    whole: Model,
}

impl Scene {
    fn new(scene: SceneKind) -> Self {
        let options = SequenceOptions { scene, frames: 9, supersampling: 2, ..SequenceOptions::default() };
        let sequence = Sequence::new(options).expect("a sequence");
        let frames: Vec<_> = [0, 2].map(|k| (sequence.pose(k), sequence.image(k))).into();
        let (camera_from_object, image) = frames[0].clone();
        let image = [TrainingImage { image, camera: *sequence.camera(), camera_from_object }];
        let model = |max_edge_px| {
            let options = TrainOptions { max_edge_px, ..TrainOptions::default() };
            train(&sequence.object().mesh, &image, &options).expect("a model")
        };
        Self { camera: *sequence.camera(), frames, cut: model(40.0), whole: model(f64::INFINITY) }
    }

    /// Scenes are rendered once.
    fn of(kind: SceneKind) -> &'static Self {
        static RELIEF: LazyLock<Scene> = LazyLock::new(|| Scene::new(SceneKind::Relief));
        static BOX: LazyLock<Scene> = LazyLock::new(|| Scene::new(SceneKind::Box));
        if kind == SceneKind::Relief { &RELIEF } else { &BOX }
    }

    /// Distance of two poses, pixels: rms over the corners of the bounding box.
    fn distance_px(&self, a: &Pose, b: &Pose) -> f64 {
        let corners = &self.cut.shape.corners;
        let project = |pose: &Pose, x| self.camera.project(&pose.transform_point(x)).expect("in front");
        let squares = corners.iter().map(|x| (project(a, x) - project(b, x)).norm_squared());
        (squares.sum::<f64>() / 8.0).sqrt()
    }

    /// Starts at the given distance from a pose in six directions.
    fn starts(&self, pose: &Pose) -> Vec<Start> {
        let centre = self.cut.shape.centre;
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let directions = axes.iter().flat_map(|axis| [(*axis, -axis * 0.05), (-axis, axis.yzx() * 0.05)]);
        let start = |(turn, shift): (Vector3<f64>, Vector3<f64>)| {
            let moved = |size: f64| pose.compose(&Pose::about(turn * size, shift * size, &centre));
            let size = 1e-3 * DISTURBANCE_PX / self.distance_px(pose, &moved(1e-3));
            let start = moved(size);
            let px = self.distance_px(pose, &start);
            assert!((px / DISTURBANCE_PX - 1.0).abs() < 0.1, "a start is {px} px off");
            Start { camera_from_object: start, appearance: Vec::new() }
        };
        directions.map(start).collect()
    }

    fn align(&self, backend: Box<dyn Backend>, method: Method, frame: usize) -> Vec<PoseEstimate> {
        let model = if method.wants_whole_triangles() { &self.whole } else { &self.cut };
        let mut tracker =
            Tracker::new(model.clone(), self.camera, backend, method.aligner()).expect("a tracker");
        let (pose, image) = &self.frames[frame];
        tracker.align(image, &self.starts(pose)).expect("estimates")
    }

    /// Every estimate must be near the truth.
    fn judge(&self, frame: usize, estimates: &[PoseEstimate], mm: f64, px: f64) -> Result<(), Failed> {
        let (truth, _) = &self.frames[frame];
        let centre = self.cut.shape.centre;
        for (k, e) in estimates.iter().enumerate() {
            let pose = &e.camera_from_object;
            let off_mm = (pose.transform_point(&centre) - truth.transform_point(&centre)).norm() * 1e3;
            let off_px = self.distance_px(pose, truth);
            if off_mm > mm || off_px > px || e.score.is_lost() || !e.converged {
                let state = format!("{} steps, converged {}", e.iterations, e.converged);
                return Err(format!("start {k}: {off_mm:.3} mm and {off_px:.3} px off, {state}").into());
            }
            if e.covariance.cholesky().is_none() {
                return Err(format!("start {k}: the covariance is none").into());
            }
        }
        Ok(())
    }
}

fn comes_back(method: Method, kind: SceneKind, mm: f64, px: f64) -> Result<(), Failed> {
    let scene = Scene::of(kind);
    let estimates = scene.align(Box::new(CpuBackend::new()), method, 1);
    scene.judge(1, &estimates, mm, px)
}

fn right_order_comes_back() -> Result<(), Failed> {
    let scene = Scene::of(SceneKind::Relief);
    let aligner = Paper::new(PaperOptions { order: Order::Right, ..PaperOptions::default() });
    let backend = Box::new(CpuBackend::new());
    let mut tracker = Tracker::new(scene.whole.clone(), scene.camera, backend, Box::new(aligner))?;
    let (pose, image) = &scene.frames[1];
    scene.judge(1, &tracker.align(image, &scene.starts(pose))?, 1.0, 0.3)
}

/// Methods that need `prepare` must not fall silent without it; the others need none.
fn methods_that_prepare_say_so() -> Result<(), Failed> {
    let scene = Scene::of(SceneKind::Relief);
    let (pose, image) = &scene.frames[1];
    for method in Method::ALL {
        let mut backend = CpuBackend::new();
        let id = backend.load(&scene.cut)?;
        let mut aligner = method.aligner();
        backend.set_frame(image, aligner.levels(&scene.cut))?;
        let target = aam6d::align::Target { model: &scene.cut, id, camera: scene.camera, image };
        let said = aligner.align(&mut backend, &target, &scene.starts(pose), &mut Vec::new()).is_err();
        let needs = matches!(method, Method::Paper | Method::Edge);
        if said != needs {
            return Err(format!("{method}: refused {said}, needs prepare {needs}").into());
        }
    }
    Ok(())
}

fn every_method_has_its_name() -> Result<(), Failed> {
    for method in Method::ALL {
        let json = serde_json::to_string(&method)?;
        if json != format!("\"{}\"", method.name()) || format!("{method}") != method.name() {
            return Err(format!("{method:?} is called {method}, {}, and {json}", method.name()).into());
        }
    }
    if Method::default() == Method::InverseCompositional && ForwardAdditive::default().options.robust {
        Ok(())
    } else {
        Err("the defaults changed".into())
    }
}

mod on_gpu {
    use super::*;
    use aam6d::backend::gpu::GpuOptions;

    /// f32 against f64 at the same stop rule.
    const TOLERANCE_MM: f64 = 1e-2;
    const TOLERANCE_PX: f64 = 1e-2;

    pub(super) fn backends_agree() -> Result<(), Failed> {
        let scene = Scene::of(SceneKind::Relief);
        let method = Method::ForwardAdditive;
        let cpu = scene.align(Box::new(CpuBackend::new()), method, 1);
        let gpu = scene.align(Box::new(support::gpu::open(GpuOptions::default())), method, 1);
        scene.judge(1, &gpu, 0.3, 0.1)?;
        let centre = scene.cut.shape.centre;
        for (k, (a, b)) in cpu.iter().zip(&gpu).enumerate() {
            let (a, b) = (a.camera_from_object, b.camera_from_object);
            let mm = (a.transform_point(&centre) - b.transform_point(&centre)).norm() * 1e3;
            let px = scene.distance_px(&a, &b);
            if mm > TOLERANCE_MM || px > TOLERANCE_PX {
                return Err(format!("start {k}: {mm:e} mm and {px:e} px apart").into());
            }
        }
        Ok(())
    }
}
