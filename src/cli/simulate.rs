//! `aam6d simulate`: a BOP dataset with exact ground truth.

use std::path::PathBuf;

use serde::Serialize;

use super::progress;
use super::summary::JsonArg;
use crate::simulate::{SceneKind, SequenceOptions, write_dataset};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder to write; must be new or empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What to show
    #[arg(long, value_enum, default_value = "relief")]
    scene: SceneKind,
    /// Frames of each of the two sequences (scenes 1 and 2)
    #[arg(long, default_value_t = 120)]
    frames: usize,
    /// Seed of print, clutter, motion and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Let exposure and direction of light change
    #[arg(long)]
    light: bool,
    /// Share of the object behind a moving occluder, 0 to 0.6
    #[arg(long, value_name = "F", default_value_t = 0.0)]
    occlusion: f64,
    /// Standard deviation of the noise in grey levels of 255
    #[arg(long, value_name = "SIGMA", default_value_t = 2.0)]
    noise: f64,
    /// Standard deviation of the optical blur in pixels
    #[arg(long, value_name = "PX", default_value_t = 0.0)]
    blur: f64,
    #[command(flatten)]
    json: JsonArg,
}

#[derive(Debug, Serialize)]
struct Summary {
    out: PathBuf,
    scenes: Vec<u32>,
    frames_per_scene: usize,
    options: SequenceOptions,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let options = SequenceOptions {
        scene: args.scene,
        frames: args.frames,
        seed: args.seed,
        light: args.light,
        occlusion: args.occlusion,
        noise: args.noise,
        blur: args.blur,
        ..SequenceOptions::default()
    };
    let sequences = [1, 2].map(|sequence| SequenceOptions { sequence, ..options });
    let bar = progress::frames(0, "rendering");
    write_dataset(&args.out, &sequences, |done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    let text = format!(
        "{}: scenes 1 and 2 with {} frames each, poses in scene_gt.json",
        args.out.display(),
        args.frames
    );
    let summary =
        Summary { out: args.out.clone(), scenes: vec![1, 2], frames_per_scene: args.frames, options };
    args.json.write(&text, &summary)
}
