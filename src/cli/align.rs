//! `aam6d align`: every start pose on its own.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use serde::Serialize;

use super::backend::BackendArgs;
use super::frames::{self, SceneArgs};
use super::method::MethodArgs;
use super::progress;
use super::records::{ResultsFile, row};
use super::summary::JsonArg;
use crate::align::{Method, Start};
use crate::dataset::{ResultRow, Scene, results};
use crate::model::Model;
use crate::track::{Status, Tracker};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Model file of `aam6d train`
    model: PathBuf,
    #[command(flatten)]
    scene: SceneArgs,
    /// Start poses (BOP CSV); a frame may occur many times
    #[arg(long, value_name = "FILE")]
    starts: PathBuf,
    /// Results file to write (BOP CSV; score 0 means lost), one line per start in the same order
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    method: MethodArgs,
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    json: JsonArg,
}

#[derive(Debug, Serialize)]
struct Summary {
    starts: usize,
    aligned: usize,
    lost: usize,
    iterations_mean: f64,
    method: Method,
    backend: String,
    results: PathBuf,
    /// What the model lacks for the method.
    #[serde(skip_serializing_if = "Option::is_none")]
    warning: Option<String>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let model = Model::load(&args.model)?;
    let (_, scene) = args.scene.open()?;
    let starts = read_starts(args, &scene, model.object_id)?;
    let aligner = args.method.aligner()?;
    let warning = args.method.misfit(&model);
    let opened = args.backend.open()?;
    let mut tracker = Tracker::new(model, scene.frames[0].camera, opened.backend, aligner)?;
    let (rows, iterations) = align_all(&mut tracker, &scene, &starts)?;
    let mut out = ResultsFile::create(&args.out)?;
    rows.iter().try_for_each(|row| out.write(row))?;
    out.finish()?;
    let lost = rows.iter().filter(|r| r.score <= 0.0).count();
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    let iterations_mean = iterations as f64 / rows.len() as f64;
    let summary = Summary {
        starts: rows.len(),
        aligned: rows.len() - lost,
        lost,
        iterations_mean,
        method: args.method.method,
        backend: tracker.backend_name(),
        results: args.out.clone(),
        warning,
    };
    let mut text = format!(
        "{}: {} of {} starts aligned, {} lost; {:.1} iterations on average; method {}, backend {} ({})",
        args.out.display(),
        summary.aligned,
        summary.starts,
        summary.lost,
        summary.iterations_mean,
        summary.method,
        summary.backend,
        opened.why
    );
    if let Some(warning) = &summary.warning {
        text += &format!("\nwarning: {warning}");
    }
    args.json.write(&text, &summary)
}

fn read_starts(args: &Args, scene: &Scene, object: u32) -> anyhow::Result<Vec<ResultRow>> {
    let starts = results::read(&args.starts)?;
    let file = args.starts.display();
    anyhow::ensure!(!starts.is_empty(), "{file}: it has no start pose; give BOP result lines");
    for (k, start) in starts.iter().enumerate() {
        let which = format!("{file}: start {} (scene {}, image {})", k + 1, start.scene_id, start.im_id);
        anyhow::ensure!(
            start.scene_id == scene.id,
            "{which}: the scene asked for is {}; choose another --scene or remove the line",
            scene.id
        );
        anyhow::ensure!(
            start.obj_id == object,
            "{which}: object {}, the model is of {object}; give the model of that object",
            start.obj_id
        );
        anyhow::ensure!(
            scene.frames.iter().any(|f| f.id == start.im_id),
            "{which}: the scene has no such image; its images go from {} to {}",
            scene.frames[0].id,
            scene.frames[scene.frames.len() - 1].id
        );
    }
    Ok(starts)
}

/// Aligns frame by frame, all starts of a frame in one batch. Returns the rows in the order of the starts and the
/// sum of their iterations.
fn align_all(
    tracker: &mut Tracker,
    scene: &Scene,
    starts: &[ResultRow],
) -> anyhow::Result<(Vec<ResultRow>, usize)> {
    let mut of_frame: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (k, start) in starts.iter().enumerate() {
        of_frame.entry(start.im_id).or_default().push(k);
    }
    let bar = progress::frames(of_frame.len(), "aligning");
    let mut rows: Vec<Option<ResultRow>> = vec![None; starts.len()];
    let mut iterations = 0;
    let modes = tracker.model().modes();
    for frame in scene.frames.iter().filter(|f| of_frame.contains_key(&f.id)) {
        let members = &of_frame[&frame.id];
        let image = frames::read(frame)?;
        tracker.set_camera(frame.camera)?;
        let batch: Vec<Start> = members
            .iter()
            .map(|&k| Start { camera_from_object: starts[k].pose, appearance: vec![0.0; modes] })
            .collect();
        let began = Instant::now();
        let estimates = tracker.align(&image, &batch)?;
        // BOP asks for the time of the whole image on each of its lines.
        let time_ms = began.elapsed().as_secs_f64() * 1e3;
        for (&k, estimate) in members.iter().zip(&estimates) {
            iterations += estimate.iterations;
            let probability = tracker.probability(estimate);
            let believed = (Status::of_probability(probability), probability);
            rows[k] = Some(row((scene.id, frame.id, starts[k].obj_id), estimate, believed, time_ms));
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let rows: Option<Vec<ResultRow>> = rows.into_iter().collect();
    Ok((rows.context("a start was not aligned")?, iterations))
}
