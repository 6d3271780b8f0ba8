//! `aam6d simulate`: a BOP dataset with exact ground truth.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::progress;
use super::summary::JsonArg;
use crate::simulate::{CellOptions, SceneKind, SequenceOptions, write_cell, write_dataset};

/// What can be simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Choice {
    /// A relief of 76 landmarks that tilts and rolls
    Relief,
    /// A box that turns about its vertical axis
    Box,
    /// The same box going round by 360 degrees in 240 frames
    Turntable,
    /// A stereo camera on a robot's end-effector that moves around the relief, with all files of the paper's experiment
    Cell,
}

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Folder to write; must be new or empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// What to show
    #[arg(long, value_enum, default_value = "relief")]
    scene: Choice,
    /// Frames of each of the two sequences (scenes 1 and 2)
    #[arg(long, default_value_t = 120)]
    frames: usize,
    /// Seed of print, clutter, motion and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Let exposure and direction of light change
    #[arg(long)]
    light: bool,
    /// Factor on all light, 0.1 to 10; from about 1.1 on bright parts saturate
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    exposure: f64,
    /// Share of the object behind a moving occluder, 0 to 0.6
    #[arg(long, value_name = "F", default_value_t = 0.0)]
    occlusion: f64,
    /// Standard deviation of the noise in grey levels of 255
    #[arg(long, value_name = "SIGMA", default_value_t = 2.0)]
    noise: f64,
    /// Standard deviation of the optical blur in pixels
    #[arg(long, value_name = "PX", default_value_t = 0.0)]
    blur: f64,
    /// Cell: standard deviation of a click in pixels, per coordinate
    #[arg(long, value_name = "PX", default_value_t = 0.3)]
    click_noise: f64,
    /// Cell: standard deviation of the robot's poses, millimetres and degrees per axis
    #[arg(long, value_name = "MM,DEG", value_delimiter = ',', num_args = 1, default_value = "0,0")]
    kinematic_noise: Vec<f64>,
    /// Cell: annotated training frames of each sequence
    #[arg(long, value_name = "N", default_value_t = 16)]
    training_views: usize,
    #[command(flatten)]
    json: JsonArg,
}

#[derive(Debug, Serialize)]
struct Summary {
    out: PathBuf,
    scenes: Vec<u32>,
    frames_per_scene: usize,
    options: Options,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Options {
    Sequence(SequenceOptions),
    Cell(CellOptions),
}

impl Args {
    fn sequence(&self, scene: SceneKind) -> SequenceOptions {
        SequenceOptions {
            scene,
            frames: self.frames,
            seed: self.seed,
            light: self.light,
            exposure: self.exposure,
            occlusion: self.occlusion,
            noise: self.noise,
            blur: self.blur,
            ..SequenceOptions::default()
        }
    }

    fn cell(&self) -> anyhow::Result<CellOptions> {
        let [kinematic_noise_mm, kinematic_noise_deg] = self.kinematic_noise[..] else {
            anyhow::bail!("--kinematic-noise takes two numbers, e.g. 1,0.05 for 1 mm and 0.05 degrees");
        };
        anyhow::ensure!(
            self.occlusion == 0.0 && self.blur == 0.0 && self.exposure == 1.0,
            "--occlusion, --blur and --exposure are not for the cell; use another --scene"
        );
        Ok(CellOptions {
            frames: self.frames,
            seed: self.seed,
            light: self.light,
            noise: self.noise,
            click_noise_px: self.click_noise,
            kinematic_noise_mm,
            kinematic_noise_deg,
            training_views: self.training_views,
        })
    }

    fn options(&self) -> anyhow::Result<Options> {
        Ok(match self.scene {
            Choice::Relief => Options::Sequence(self.sequence(SceneKind::Relief)),
            Choice::Box => Options::Sequence(self.sequence(SceneKind::Box)),
            Choice::Turntable => Options::Sequence(self.sequence(SceneKind::Turntable)),
            Choice::Cell => Options::Cell(self.cell()?),
        })
    }
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let options = args.options()?;
    let bar = progress::frames(0, "rendering");
    let progress = |done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    };
    match &options {
        Options::Sequence(options) => {
            let sequences = [1, 2].map(|sequence| SequenceOptions { sequence, ..*options });
            write_dataset(&args.out, &sequences, progress)?;
        }
        Options::Cell(options) => write_cell(&args.out, options, progress)?,
    }
    bar.finish_and_clear();
    let more = if args.scene == Choice::Cell {
        "; the frontal pair is scenes 3 and 4; stereo.json, clicks.json; annotations.json, scene_robot.json, \
         hand_eye.json per scene; exact values in *_gt.json"
    } else {
        ""
    };
    let text = format!(
        "{}: scenes 1 and 2 with {} frames each, poses in scene_gt.json{more}",
        args.out.display(),
        args.frames
    );
    let summary =
        Summary { out: args.out.clone(), scenes: vec![1, 2], frames_per_scene: args.frames, options };
    args.json.write(&text, &summary)
}
