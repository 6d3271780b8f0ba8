//! Are smoothed poses steadier than tracked ones, and no less right in motion? From simulated images.

mod support;

use aam6d::geometry::Pose;
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{Noise, SceneKind, Sequence, View};
use aam6d::track::smooth::Smoother;
use aam6d::track::{Status, Tracked};
use aam6d::train::TrainOptions;
use nalgebra::Vector3;
use rayon::prelude::*;
use support::tracking::{cpu, say, sequence, sixteen, track, tracker, trained};

const FPS: f64 = 30.0;
const FRAMES: usize = 60;
/// The filter is settled.
const SETTLED: usize = 20;
/// Not of the sequence that the model was trained on.
const AT: usize = 40;

/// Root mean square error of the centre, millimetres, and of the rotation, degrees.
fn rms(model: &Model, truth: &[Pose], poses: &[Pose]) -> [f64; 2] {
    let mut sum = [0.0, 0.0];
    for (a, b) in truth.iter().zip(poses).skip(SETTLED) {
        let centre = &model.shape.centre;
        sum[0] += (a.transform_point(centre) - b.transform_point(centre)).norm_squared() * 1e6;
        sum[1] += a.compose(&b.inverse()).rotation_vector().map(f64::to_degrees).norm_squared();
    }
    sum.map(|s| (s / (truth.len() - SETTLED) as f64).sqrt())
}

fn smoothed(model: &Model, lag: usize, tracked: &[Tracked]) -> Vec<Pose> {
    let mut smoother = Smoother::new(model, lag);
    let mut out = Vec::new();
    for (k, t) in tracked.iter().enumerate() {
        assert_eq!(t.status, Status::Tracking, "frame {k}");
        out.extend(smoother.push(k as f64 / FPS, t).expect("in order"));
    }
    out.extend(smoother.finish());
    assert_eq!(out.len(), tracked.len(), "every frame");
    out.iter().map(|s| s.camera_from_object).collect()
}

/// What is left of the errors of tracked poses at a lag: of the centre, and of the rotation.
fn left(what: &str, model: &Model, sequence: &Sequence, truth: &[Pose], lag: usize) -> [f64; 2] {
    let image = |(k, pose): (usize, &Pose)| {
        let noise = Some(Noise { sigma: 2.0, seed: 33, frame: k as u64 });
        sequence.renderer().render_view(&View { pose: *pose, noise, ..View::default() })
    };
    let frames: Vec<GrayImage> = truth.par_iter().enumerate().map(image).collect();
    let tracked = track(&mut tracker(model, *sequence.camera(), cpu()), truth[0], &frames);
    let raw: Vec<Pose> = tracked.iter().map(|t| t.estimate.camera_from_object).collect();
    // At rest the part of the error that is the same in all frames is no jitter.
    let mean = if truth[0] == truth[1] { constant(model, truth, &raw) } else { Vector3::zeros() };
    let moved = |p: &Pose| Pose::from_quaternion(p.quaternion(), p.translation() - mean);
    let (before, after) = (rms(model, truth, &raw), rms(model, truth, &smoothed(model, lag, &tracked)));
    let jitter = |poses: &[Pose]| rms(model, truth, &poses.iter().map(moved).collect::<Vec<_>>())[0];
    let jitters = [jitter(&raw), jitter(&smoothed(model, lag, &tracked))];
    say(format_args!(
        "{what}, lag {lag}: raw {before:.4?} mm and degrees, smoothed {after:.4?}; without the constant part {jitters:.4?} mm"
    ));
    [jitters[1] / jitters[0], after[1] / before[1]]
}

/// Mean error of the centre, metres.
fn constant(model: &Model, truth: &[Pose], poses: &[Pose]) -> Vector3<f64> {
    let centre = &model.shape.centre;
    let errors = truth.iter().zip(poses).skip(SETTLED);
    let sum: Vector3<f64> = errors.map(|(a, b)| b.transform_point(centre) - a.transform_point(centre)).sum();
    sum / (truth.len() - SETTLED) as f64
}

#[test]
fn at_rest_steadier_and_in_motion_as_right() {
    for scene in [SceneKind::Relief, SceneKind::Box] {
        let model = trained(&sequence(scene, 2, 2.0), &sixteen(), &TrainOptions::default());
        let sequence = sequence(scene, 1, 2.0);
        let rest = [sequence.pose(AT); FRAMES];
        let motion: Vec<Pose> = (0..FRAMES).map(|k| sequence.pose(k)).collect();
        for lag in [0, 3] {
            let at_rest = left(&format!("{scene:?} at rest"), &model, &sequence, &rest, lag);
            assert!(at_rest[0] < 0.5, "{scene:?}, lag {lag}: {at_rest:?} of the jitter is left");
            let moving = left(&format!("{scene:?} moving"), &model, &sequence, &motion, lag);
            assert!(moving.iter().all(|r| *r < 1.1), "{scene:?}, lag {lag}: {moving:?} of the error");
        }
    }
}
