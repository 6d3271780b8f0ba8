//! Do CPU and device track alike? Final poses at equal iteration counts, and whole tracks; every comparison has a
//! control that must be noticed.

mod support;

use std::process::ExitCode;

use aam6d::align::{Options, PoseEstimate};
use aam6d::backend::Backend;
use aam6d::backend::gpu::GpuOptions;
use aam6d::geometry::Pose;
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{SceneKind, Sequence};
use aam6d::track::{RigCamera, Status, Tracked};
use aam6d::train::TrainOptions;
use libtest_mimic::Failed;
use support::gpu::{open, trial};
use support::pair::Pair;
use support::tracking::{
    Disturbance, cpu, distance_px, say, sequence, sixteen, start, track, tracker, tracker_with, trained,
};

/// Final poses at equal iteration counts: f32 leaves 4e-5 mm, 1e-5 degrees and 3e-5 px, here is room for other adapters.
const FINAL_MM: f64 = 1e-3;
const FINAL_DEG: f64 = 1e-4;
const FINAL_PX: f64 = 1e-3;
/// Poses of whole tracks, pixels: twice the stop tolerance, since either track may stop one step earlier.
const TRACK_PX: f64 = 0.02;
/// Iteration counts may differ by one, and by more in this share of the frames, where a step ends on the threshold.
const OTHER_COUNTS: f64 = 0.1;
/// Frames of a track.
const FRAMES: usize = 30;

fn main() -> ExitCode {
    support::gpu::main(vec![
        trial("final_poses/relief", || final_poses(SceneKind::Relief, 0)),
        trial("final_poses/relief_4_modes", || final_poses(SceneKind::Relief, 4)),
        trial("final_poses/box", || final_poses(SceneKind::Box, 0)),
        trial("final_poses/control_frame", a_shifted_patch_is_noticed),
        trial("final_poses/control_chart", a_shifted_chart_is_noticed),
        trial("track/relief", || whole_track(SceneKind::Relief, 0)),
        trial("track/relief_4_modes", || whole_track(SceneKind::Relief, 4)),
        trial("track/box", || whole_track(SceneKind::Box, 0)),
        trial("track/lost", lost_and_found_alike),
        trial("track/rig", two_cameras_alike),
        trial("track/control_frame", a_disturbed_frame_is_noticed),
    ])
}

fn gpu() -> Box<dyn Backend> {
    Box::new(open(GpuOptions::default()))
}

/// The first sequence of a scene, and a model of the second; modes are trained on changing light.
fn scene(kind: SceneKind, modes: usize) -> (Sequence, Model) {
    let options = TrainOptions { modes, ..TrainOptions::default() };
    let lit = |number| {
        let options = *sequence(kind, number, 2.0).options();
        let options = aam6d::simulate::SequenceOptions { light: modes > 0, ..options };
        Sequence::new(options).expect("good options")
    };
    (lit(1), trained(&lit(2), &sixteen(), &options))
}

/// Largest difference of two poses in millimetres of the centre, degrees, and pixels of the corners.
fn difference(sequence: &Sequence, model: &Model, a: &Pose, b: &Pose) -> [f64; 3] {
    let centre = &model.shape.centre;
    [
        (a.transform_point(centre) - b.transform_point(centre)).norm() * 1e3,
        a.compose(&b.inverse()).rotation_vector().norm().to_degrees(),
        distance_px(sequence.camera(), &model.shape.corners, a, b),
    ]
}

/// All starts on one backend with a fixed number of steps per level.
fn finals(
    backend: Box<dyn Backend>,
    sequence: &Sequence,
    model: &Model,
    image: &GrayImage,
) -> Vec<PoseEstimate> {
    let options = Options { max_iterations: 7, stop_px: vec![0.0], ..Options::default() };
    let mut disturbance = Disturbance::new(31, *sequence.camera(), &model.shape.corners, model.shape.centre);
    let truth = sequence.pose(FRAMES);
    let starts: Vec<_> = (0..8).map(|_| start(model, disturbance.apply(&truth, 4.0))).collect();
    let mut tracker = tracker_with(model, *sequence.camera(), backend, options);
    tracker.align(image, &starts).expect("good starts")
}

/// Lists every pair of final poses that differs.
fn compare_finals(
    sequence: &Sequence,
    model: &Model,
    a: &[PoseEstimate],
    b: &[PoseEstimate],
) -> Result<(), String> {
    let (mut failures, mut worst) = (Vec::new(), [0.0; 3]);
    for (k, (a, b)) in a.iter().zip(b).enumerate() {
        let d = difference(sequence, model, &a.camera_from_object, &b.camera_from_object);
        worst = std::array::from_fn(|i| f64::max(worst[i], d[i]));
        // Written so that NaN is reported.
        let near = d[0] <= FINAL_MM && d[1] <= FINAL_DEG && d[2] <= FINAL_PX;
        if !near || a.iterations != b.iterations || a.score.is_lost() || b.score.is_lost() {
            failures.push(format!(
                "start {k}: {:.1e} mm, {:.1e} deg, {:.1e} px apart after {} and {} steps, lost {} and {}",
                d[0],
                d[1],
                d[2],
                a.iterations,
                b.iterations,
                a.score.is_lost(),
                b.score.is_lost()
            ));
        }
    }
    say(format_args!("finals: {:.1e} mm, {:.1e} deg, {:.1e} px", worst[0], worst[1], worst[2]));
    if failures.is_empty() && a.len() == b.len() { Ok(()) } else { Err(failures.join("\n")) }
}

fn final_poses(kind: SceneKind, modes: usize) -> Result<(), Failed> {
    let (sequence, model) = scene(kind, modes);
    let image = sequence.image(FRAMES);
    let on_cpu = finals(cpu(), &sequence, &model, &image);
    let on_gpu = finals(gpu(), &sequence, &model, &image);
    Ok(compare_finals(&sequence, &model, &on_cpu, &on_gpu)?)
}

/// The report of a comparison that must fail.
fn noticed(result: Result<(), String>, expected: &str) -> Result<(), Failed> {
    match result {
        Err(report) if report.contains(expected) => Ok(()),
        other => Err(format!("the disturbance was reported as {other:?}").into()),
    }
}

/// The image with a patch in its middle moved to the right by one pixel.
fn shifted_patch(image: &GrayImage) -> GrayImage {
    let (mut out, (w, h)) = (image.clone(), image.dimensions());
    for (u, v) in (w / 2 - 20..w / 2 + 20).flat_map(|u| (h / 2 - 20..h / 2 + 20).map(move |v| (u, v))) {
        out.put_pixel(u, v, *image.get_pixel(u - 1, v));
    }
    out
}

fn a_shifted_patch_is_noticed() -> Result<(), Failed> {
    let (sequence, model) = scene(SceneKind::Relief, 0);
    let image = sequence.image(FRAMES);
    let on_cpu = finals(cpu(), &sequence, &model, &image);
    let on_gpu = finals(gpu(), &sequence, &model, &shifted_patch(&image));
    noticed(compare_finals(&sequence, &model, &on_cpu, &on_gpu), "start 0:")
}

/// One chart of the device's model is darker on its right side, as if the texture had moved.
fn a_shifted_chart_is_noticed() -> Result<(), Failed> {
    let (sequence, model) = scene(SceneKind::Relief, 0);
    let image = sequence.image(FRAMES);
    let mut disturbed = model.clone();
    let level = &mut disturbed.levels[0];
    let chart = *level.charts.iter().max_by_key(|c| c.range().len()).ok_or("no chart")?;
    for p in chart.range() {
        level.pixels.intensity[p] += 0.2 * level.pixels.gradient[p][0];
    }
    let on_cpu = finals(cpu(), &sequence, &model, &image);
    let on_gpu = finals(gpu(), &sequence, &disturbed, &image);
    noticed(compare_finals(&sequence, &model, &on_cpu, &on_gpu), "start 0:")
}

/// Lists every frame in which two tracks differ.
fn compare_tracks(sequence: &Sequence, model: &Model, a: &[Tracked], b: &[Tracked]) -> Result<(), String> {
    let (mut failures, mut worst, mut other_counts) = (Vec::new(), 0.0, 0.0);
    for (k, (a, b)) in a.iter().zip(b).enumerate() {
        let (p, q) = (&a.estimate, &b.estimate);
        let px = distance_px(
            sequence.camera(),
            &model.shape.corners,
            &p.camera_from_object,
            &q.camera_from_object,
        );
        let believed = a.status == Status::Tracking;
        worst = if believed { f64::max(worst, px) } else { worst };
        other_counts += f64::from(u8::from(believed && p.iterations.abs_diff(q.iterations) > 1));
        // Where the object is lost there is no pose to agree on. Written so that NaN is reported.
        let near = px <= TRACK_PX || !believed;
        if a.status != b.status || !near {
            failures.push(format!("frame {k}: {px:.1e} px apart, {:?} and {:?}", a.status, b.status));
        }
    }
    say(format_args!("track: {worst:.1e} px, {other_counts} other counts of iterations"));
    #[expect(clippy::cast_precision_loss, reason = "frame counts are small")]
    if other_counts > OTHER_COUNTS * a.len() as f64 {
        failures.push(format!("{other_counts} frames differ by more than one iteration"));
    }
    if failures.is_empty() && a.len() == b.len() { Ok(()) } else { Err(failures.join("\n")) }
}

/// Tracks frames on both backends from a start some pixels off.
fn both(
    sequence: &Sequence,
    model: &Model,
    on_cpu: &[GrayImage],
    on_gpu: &[GrayImage],
) -> Result<(), String> {
    let mut disturbance = Disturbance::new(37, *sequence.camera(), &model.shape.corners, model.shape.centre);
    let begin = disturbance.apply(&sequence.pose(0), 3.0);
    let run = |backend, frames| track(&mut tracker(model, *sequence.camera(), backend), begin, frames);
    compare_tracks(sequence, model, &run(cpu(), on_cpu), &run(gpu(), on_gpu))
}

fn frames(sequence: &Sequence, count: usize) -> Vec<GrayImage> {
    (0..count).map(|k| sequence.image(k)).collect()
}

fn whole_track(kind: SceneKind, modes: usize) -> Result<(), Failed> {
    let (sequence, model) = scene(kind, modes);
    let frames = frames(&sequence, FRAMES);
    Ok(both(&sequence, &model, &frames, &frames)?)
}

/// A few frames without the object in the middle.
fn lost_and_found_alike() -> Result<(), Failed> {
    let (sequence, model) = scene(SceneKind::Box, 0);
    let mut frames = frames(&sequence, 8);
    let away = Pose::from_quaternion(sequence.pose(0).quaternion(), nalgebra::Vector3::new(9.0, 0.0, 0.5));
    frames[3] = sequence.renderer().render(&away);
    frames[4] = frames[3].clone();
    Ok(both(&sequence, &model, &frames, &frames)?)
}

/// Two cameras, each with a model of its own on its backend; the control is a second camera half a millimetre off.
fn two_cameras_alike() -> Result<(), Failed> {
    let pair = Pair::new(SceneKind::Box, 8);
    let run = |backend, off: f64| {
        let shift = Pose::from_quaternion(Pose::identity().quaternion(), nalgebra::Vector3::x() * off);
        let camera_from_reference = shift.compose(&pair.other.camera_from_reference);
        let model = Some(pair.model.clone());
        let mut rig = pair.rig_on(backend, RigCamera { camera_from_reference, model, ..pair.other.clone() });
        rig.start_at(pair.start());
        let track = |[a, b]: &[GrayImage; 2]| rig.track(&[a, b]).expect("good frames");
        pair.frames.iter().map(track).collect::<Vec<_>>()
    };
    let on_cpu = run(cpu(), 0.0);
    compare_tracks(&pair.sequence, &pair.model, &on_cpu, &run(gpu(), 0.0))?;
    noticed(compare_tracks(&pair.sequence, &pair.model, &on_cpu, &run(gpu(), 5e-4)), "frame 0:")
}

fn a_disturbed_frame_is_noticed() -> Result<(), Failed> {
    let (sequence, model) = scene(SceneKind::Relief, 0);
    let frames = frames(&sequence, 4);
    let mut disturbed = frames.clone();
    // The object some pixels farther on.
    disturbed[2] = sequence.image(3);
    noticed(both(&sequence, &model, &frames, &disturbed), "frame 2:")
}
