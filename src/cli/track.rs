//! `aam6d track`: an object through a scene.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;

use super::backend::BackendArgs;
use super::decode::{Decoded, Latency, each_frame};
use super::follow::{Follow, StereoArgs};
use super::frames::SceneArgs;
use super::init::InitArgs;
use super::method::MethodArgs;
use super::records::{DetailsFile, FrameRecord, ResultsFile, row};
use super::smoothed::{SmoothArgs, SmoothedFile, Smoothing};
use super::summary::JsonArg;
use super::{overlay, progress};
use crate::align::Method;
use crate::dataset::Scene;
use crate::eval::Estimate;
use crate::eval::statistics::{median, percentile};
use crate::model::Model;
use crate::track::{Status, Tracker};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Model file of `aam6d train`
    model: PathBuf,
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    stereo: StereoArgs,
    #[command(flatten)]
    init: InitArgs,
    /// Results file to write (BOP CSV; score 0 means lost)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Also write everything known about each frame (JSON lines)
    #[arg(long, value_name = "FILE")]
    details: Option<PathBuf>,
    /// Also write the poses as a TUM trajectory, frame numbers as time stamps, lost frames left out
    #[arg(long, value_name = "FILE")]
    tum: Option<PathBuf>,
    /// Also write pictures of the estimated pose
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    #[command(flatten)]
    smooth: SmoothArgs,
    #[command(flatten)]
    method: MethodArgs,
    /// When the next frame is read; the results are the same
    #[arg(long, value_enum, default_value_t)]
    latency: Latency,
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    json: JsonArg,
}

/// What is written while a scene is tracked.
#[derive(Debug, Clone, Copy)]
pub(super) struct Outputs<'a> {
    pub(super) results: &'a Path,
    pub(super) details: Option<&'a Path>,
    pub(super) smoothing: Option<&'a Smoothing>,
    pub(super) overlay: Option<&'a Path>,
    /// Every how many frames a picture is written.
    pub(super) overlay_every: usize,
    /// When frames are read.
    pub(super) latency: Latency,
    /// Shown beside the progress bar.
    pub(super) what: &'a str,
}

/// A scene after tracking.
#[derive(Debug)]
pub(super) struct Track {
    pub(super) estimates: Vec<Estimate>,
    /// Frames with a pose that is not certain.
    uncertain: usize,
}

#[derive(Debug, Serialize)]
struct Summary {
    frames: usize,
    /// Frames with a pose.
    tracked: usize,
    /// Those of them whose pose is followed but not certain.
    uncertain: usize,
    lost: usize,
    lost_frames: Vec<u32>,
    ms_per_frame: Times,
    iterations_mean: Option<f64>,
    method: Method,
    backend: String,
    results: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    smoothed: Option<Smoothing>,
    /// What the model lacks for the method.
    #[serde(skip_serializing_if = "Option::is_none")]
    warning: Option<String>,
}

#[derive(Debug, Serialize)]
struct Times {
    median: Option<f64>,
    p95: Option<f64>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let model = Model::load(&args.model)?;
    let (dataset, scene) = args.scene.open()?;
    let aligner = args.method.aligner()?;
    let warning = args.method.misfit(&model);
    let smoothing = args.smooth.smoothing()?;
    let opened = args.backend.open()?;
    let first = &scene.frames[0];
    let mut tracker = Tracker::new(model, first.camera, opened.backend, aligner)?;
    args.init.start(&mut tracker, &args.model, &dataset, scene.id, first)?;
    let outputs = Outputs {
        results: &args.out,
        details: args.details.as_deref(),
        smoothing: smoothing.as_ref(),
        overlay: args.overlay.as_deref(),
        overlay_every: 1,
        latency: args.latency,
        what: "tracking",
    };
    let mut tracker = args.stereo.follow(tracker, &dataset, &scene, args.method.method)?;
    let track = track_scene(tracker.as_mut(), &scene, &outputs)?;
    if let Some(path) = &args.tum {
        write_trajectory(path, &track.estimates)?;
    }
    let summary = summarise(&track, args.method.method, tracker.backend_name(), args.out.clone());
    let summary = Summary { warning, smoothed: smoothing, ..summary };
    let times = [summary.ms_per_frame.median, summary.ms_per_frame.p95].map(|t| t.unwrap_or(0.0));
    let mut text = format!(
        "{}: {} of {} frames tracked ({} of them uncertain), {} lost {:?}\nmethod {}, backend {} ({}), {:.1} ms per frame (95 %: {:.1} ms)",
        args.out.display(),
        summary.tracked,
        summary.frames,
        summary.uncertain,
        summary.lost,
        summary.lost_frames,
        summary.method,
        summary.backend,
        opened.why,
        times[0],
        times[1],
    );
    if let Some(smoothed) = &summary.smoothed {
        text += &format!("\n{smoothed}");
    }
    if let Some(warning) = &summary.warning {
        text += &format!("\nwarning: {warning}");
    }
    args.json.write(&text, &summary)
}

/// Tracks all frames of a scene and writes the results as they come.
pub(super) fn track_scene(
    tracker: &mut dyn Follow,
    scene: &Scene,
    outputs: &Outputs<'_>,
) -> anyhow::Result<Track> {
    let mut results = ResultsFile::create(outputs.results)?;
    let mut details = outputs.details.map(DetailsFile::create).transpose()?;
    let smoothing = outputs.smoothing.map(|s| SmoothedFile::create(s, tracker.model()));
    let mut smoothed = smoothing.transpose()?;
    let bar = progress::frames(scene.frames.len(), outputs.what);
    let mut track = Track { estimates: Vec::with_capacity(scene.frames.len()), uncertain: 0 };
    let object = tracker.model().object_id;
    each_frame(scene, outputs.latency, |k, frame, decoded| {
        let so_far = || format!("{k} finished frames are in {}.partial", outputs.results.display());
        let Decoded { image, decode_ms } = decoded.with_context(so_far)?;
        let tracked = tracker.track(frame, &image).with_context(so_far)?;
        let believed = (tracked.status, tracked.probability);
        let row = row((scene.id, frame.id, object), &tracked.estimate, believed, tracked.time_ms);
        results.write(&row)?;
        if let Some(smoothed) = &mut smoothed {
            smoothed.push(&row, &tracked)?;
        }
        if let Some(details) = &mut details {
            let place = (scene.id, frame.id);
            details.write(&FrameRecord::new(tracker.model(), place, &tracked, decode_ms))?;
        }
        if let Some(folder) = outputs.overlay.filter(|_| k % outputs.overlay_every == 0) {
            let path = folder.join(format!("{:06}.png", frame.id));
            overlay::write(&path, &image, &frame.camera, &row.pose, &tracker.model().shape, tracked.status)?;
        }
        #[expect(clippy::cast_precision_loss, reason = "iteration counts are small")]
        let iterations = Some(tracked.estimate.iterations as f64);
        track.uncertain += usize::from(tracked.status == Status::Uncertain);
        track.estimates.push(Estimate {
            frame: frame.id,
            pose: row.pose,
            score: row.score,
            time_s: row.time_s,
            iterations,
        });
        bar.inc(1);
        Ok(())
    })?;
    bar.finish_and_clear();
    results.finish()?;
    details.map_or(Ok(()), DetailsFile::finish)?;
    smoothed.map_or(Ok(()), SmoothedFile::finish)?;
    Ok(track)
}

fn write_trajectory(path: &Path, estimates: &[Estimate]) -> anyhow::Result<()> {
    let tracked = estimates.iter().filter(|e| e.score > 0.0);
    let poses =
        tracked.map(|e| crate::dataset::StampedPose { time_s: f64::from(e.frame), pose: e.pose }).collect();
    Ok(crate::dataset::Trajectory { poses }.write(path)?)
}

fn summarise(track: &Track, method: Method, backend: String, results: PathBuf) -> Summary {
    let estimates = &track.estimates;
    let lost_frames: Vec<u32> = estimates.iter().filter(|e| e.score <= 0.0).map(|e| e.frame).collect();
    let times: Vec<f64> = estimates.iter().filter_map(|e| e.time_s).map(|t| t * 1e3).collect();
    #[expect(clippy::cast_precision_loss, reason = "frame counts are small")]
    let mean = |sum: f64| (!estimates.is_empty()).then(|| sum / estimates.len() as f64);
    Summary {
        frames: estimates.len(),
        tracked: estimates.len() - lost_frames.len(),
        uncertain: track.uncertain,
        lost: lost_frames.len(),
        lost_frames,
        ms_per_frame: Times { median: median(&times), p95: percentile(&times, 95.0) },
        iterations_mean: mean(estimates.iter().filter_map(|e| e.iterations).sum()),
        method,
        backend,
        results,
        smoothed: None,
        warning: None,
    }
}
