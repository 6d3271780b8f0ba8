//! `aam6d demo`: the whole way on simulated images, no input needed.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context;
use nalgebra::{Point3, Vector3};
use serde::Serialize;

use super::backend::BackendArgs;
use super::decode::Latency;
use super::frames::{self, training_images};
use super::method::MethodArgs;
use super::progress;
use super::summary::JsonArg;
use super::track::{Outputs, track_scene};
use crate::align::Method;
use crate::dataset::{PoseSource, write_atomically};
use crate::eval::{EvalObject, Evaluation, evaluate};
use crate::geometry::Pose;
use crate::simulate::{SceneKind, SequenceOptions, write_dataset};
use crate::track::{Tracker, calibrate};
use crate::train::{TrainOptions, train};

/// Names a folder that an earlier demo wrote and this one may replace.
const MARKER: &str = "aam6d-demo.json";
/// Training images per sequence, as many as in the paper.
const TRAINING_IMAGES: usize = 16;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder for data, models, results and pictures
    #[arg(long, value_name = "DIR", default_value = "demo")]
    out: PathBuf,
    /// What to show
    #[arg(long, value_enum, default_value = "relief")]
    scene: SceneKind,
    /// Frames of each of the two sequences
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u32).range(2..))]
    frames: u32,
    /// Seed of the simulation
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of appearance modes
    #[arg(long, value_name = "L", default_value_t = 0)]
    modes: usize,
    #[command(flatten)]
    method: MethodArgs,
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    json: JsonArg,
}

#[derive(Debug, Serialize)]
struct Summary {
    sequences: Vec<SequenceSummary>,
}

#[derive(Debug, Serialize)]
struct SequenceSummary {
    name: String,
    method: Method,
    backend: String,
    #[serde(flatten)]
    evaluation: Evaluation,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    // A wrong choice is named before anything is removed or rendered.
    args.method.aligner()?;
    clear(&args.out)?;
    let data = args.out.join("data");
    let options = SequenceOptions {
        scene: args.scene,
        frames: args.frames as usize,
        seed: args.seed,
        ..SequenceOptions::default()
    };
    // The marker comes first: a demo that was interrupted can be started again.
    write_atomically(args.out.join(MARKER), |out| {
        writeln!(out, "{}", serde_json::to_string_pretty(&options)?)
    })?;
    let bar = progress::frames(0, "rendering");
    write_dataset(&data, &[1, 2].map(|sequence| SequenceOptions { sequence, ..options }), |done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    let mut text = String::new();
    let mut summary = Summary { sequences: Vec::new() };
    for (trained_on, tracked) in [(2, 1), (1, 2)] {
        let (sequence, why) = run_direction(args, &data, trained_on, tracked)?;
        writeln!(text, "{} [{}, backend {} ({why})]", sequence.name, sequence.method, sequence.backend)?;
        writeln!(text, "{}", sequence.evaluation)?;
        summary.sequences.push(sequence);
    }
    let out = args.out.display();
    write!(
        text,
        "{out}: data/ (BOP dataset), scene-*.csv (results), scene-*.jsonl (details), overlay-*/ (pictures)"
    )?;
    args.json.write(&text, &summary)
}

/// Removes what an earlier demo left; refuses to touch anything else.
fn clear(out: &Path) -> anyhow::Result<()> {
    let occupied = std::fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_some());
    if occupied {
        anyhow::ensure!(
            out.join(MARKER).is_file(),
            "{}: the folder is not empty and not from an earlier demo; choose another with --out",
            out.display()
        );
        std::fs::remove_dir_all(out).with_context(|| format!("{}: cannot be removed", out.display()))?;
    }
    Ok(())
}

fn run_direction(
    args: &Args,
    data: &Path,
    trained_on: u32,
    tracked: u32,
) -> anyhow::Result<(SequenceSummary, String)> {
    let (dataset, training_scene) = frames::open(data, trained_on)?;
    let truth = PoseSource::GroundTruth;
    let poses = dataset.poses(trained_on, 1, &truth)?;
    let ids = spread(args.frames, TRAINING_IMAGES);
    let mesh = dataset.mesh(1)?;
    let mut options = TrainOptions { modes: args.modes, ..TrainOptions::default() };
    if args.method.method.wants_whole_triangles() {
        options.max_edge_px = f64::INFINITY;
    }
    let images = training_images(&training_scene, &poses, &truth, &ids)?;
    let mut model = train(&mesh, &images, &options)?;
    calibrate(&mut model, &images)?;
    model.save(&args.out.join(format!("scene-{trained_on}.aam6d")))?;

    let scene = dataset.scene(tracked)?;
    let poses = dataset.poses(tracked, 1, &truth)?;
    let opened = args.backend.open()?;
    let centre = model.shape.centre;
    let camera = scene.frames[0].camera;
    let mut tracker = Tracker::new(model, camera, opened.backend, args.method.aligner()?)?;
    // A start at the true pose would hide a tracker that does not converge.
    tracker.start_at(disturbed(&frames::pose_of(&poses, scene.frames[0].id, &truth)?, &centre));
    let results = args.out.join(format!("scene-{tracked}.csv"));
    let details = results.with_extension("jsonl");
    let overlay = args.out.join(format!("overlay-{tracked}"));
    let outputs = Outputs {
        results: &results,
        details: Some(&details),
        smoothing: None,
        overlay: Some(&overlay),
        overlay_every: 10,
        latency: Latency::Low,
        what: "tracking",
    };
    let estimates = track_scene(&mut tracker, &scene, &outputs)?.estimates;
    let evaluation = evaluate(&estimates, &poses, &EvalObject::new(&mesh)?, &scene.cameras())?;
    let name =
        format!("{:?}, trained on scene {trained_on}, tracked in scene {tracked}", args.scene).to_lowercase();
    let method = args.method.method;
    Ok((SequenceSummary { name, method, backend: tracker.backend_name(), evaluation }, opened.why))
}

/// About `count` frame numbers spread over `0..frames`, first and last included.
fn spread(frames: u32, count: usize) -> Vec<u32> {
    let count = u32::try_from(count).map_or(frames, |c| c.min(frames));
    (0..count).map(|k| k * (frames - 1) / (count - 1).max(1)).collect()
}

/// The pose moved by 2 mm and 1 degree about the object's centre.
fn disturbed(pose: &Pose, centre: &Point3<f64>) -> Pose {
    let turn = Vector3::new(1.0, -1.0, 1.0).normalize() * 1.0_f64.to_radians();
    let shift = Vector3::new(1.0, 1.0, -1.0).normalize() * 0.002;
    pose.compose(&Pose::about(turn, shift, centre))
}
