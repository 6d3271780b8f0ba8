//! What an experiment found, as it is written to `results.json` and read for tables, plots and the report.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::methods::{BackendChoice, Engine};
use super::published::Published;
use crate::align::{Method, Order};
use crate::cli::simulate::Choice;
use crate::dataset::write_atomically;
use crate::eval::{ErrorStatistics, Evaluation};

/// Everything about the sequences (`results.json`).
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Report {
    /// Version of the program.
    pub(super) version: String,
    /// False while runs are missing, as after a kill.
    pub(super) complete: bool,
    /// Seconds so far.
    pub(super) seconds: f64,
    /// What was asked for.
    pub(super) options: Options,
    /// The backends, those that are absent included.
    pub(super) backends: Vec<Engine>,
    /// What was tracked.
    pub(super) sequences: Vec<SequenceRecord>,
    /// One per method, backend and sequence.
    pub(super) runs: Vec<Run>,
    /// The paper's Table 1.
    pub(super) published: PublishedTable,
}

/// The options that decide about the numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Options {
    pub(super) scene: Choice,
    pub(super) frames: u32,
    pub(super) seed: u64,
    pub(super) light: bool,
    pub(super) modes: usize,
    /// Of the clicks and annotations of the cell.
    pub(super) click_noise_px: f64,
    pub(super) methods: Vec<Method>,
    pub(super) backend: BackendChoice,
    /// Of the method `paper`.
    #[serde(default)]
    pub(super) paper_order: Order,
}

/// One of the two sequences and the model it is tracked with.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct SequenceRecord {
    /// Number, as in the paper: 1 or 2.
    pub(super) number: u32,
    /// The sequence that the training images are from.
    pub(super) trained_on: u32,
    pub(super) frames: usize,
    pub(super) training_images: usize,
    pub(super) landmarks: usize,
    pub(super) triangles: usize,
    pub(super) template_px: usize,
    /// Of the true motion since the first frame.
    pub(super) truth: Vec<Coefficients>,
}

/// The six coefficients of the end-effector's motion in a frame: x y z in millimetres, rx ry rz in degrees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Coefficients {
    pub(super) frame: u32,
    pub(super) values: [f64; 6],
}

/// One method on one backend in one sequence.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Run {
    pub(super) sequence: u32,
    pub(super) method: Method,
    /// `cpu` or `gpu`.
    pub(super) backend: String,
    /// The paper's method beside which it stands.
    pub(super) counterpart: Published,
    /// Errors of the end-effector's motion since the first tracked frame, in the order x y z (mm), rx ry rz (degrees).
    pub(super) motion_errors: [ErrorStatistics; 6],
    /// How many times the paper's average, and maximum, is larger at least; over the six.
    pub(super) below_published: Option<Below>,
    pub(super) lost_frames: Vec<u32>,
    /// Errors of the object's pose.
    pub(super) evaluation: Evaluation,
    /// Of the tracked frames.
    pub(super) coefficients: Vec<Coefficients>,
    /// Error of every frame's pose.
    pub(super) frames: Vec<FrameError>,
    /// Pictures with the estimated outline, below the folder of the experiment.
    pub(super) overlays: Vec<String>,
}

/// Smallest ratio of a published error to ours.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Below {
    pub(super) avg: f64,
    pub(super) max: f64,
}

impl Below {
    /// Over the six coefficients; nothing where one is unknown.
    pub(super) fn of(published: &[ErrorStatistics; 6], ours: &[ErrorStatistics; 6]) -> Option<Self> {
        let least = |pick: fn(&ErrorStatistics) -> Option<f64>| -> Option<f64> {
            let ratios: Option<Vec<f64>> =
                published.iter().zip(ours).map(|(p, o)| Some(pick(p)? / pick(o)?)).collect();
            ratios?.into_iter().reduce(f64::min)
        };
        Some(Self { avg: least(|e| e.avg)?, max: least(|e| e.max)? })
    }
}

/// Length of the error of the object's centre and angle of the error of its rotation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct FrameError {
    pub(super) frame: u32,
    pub(super) lost: bool,
    pub(super) t_mm: Option<f64>,
    pub(super) r_deg: Option<f64>,
}

/// The paper's Table 1 and where it is from.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct PublishedTable {
    pub(super) source: String,
    pub(super) rows: Vec<PublishedRow>,
}

/// One method of the paper in one sequence.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct PublishedRow {
    pub(super) sequence: u32,
    pub(super) method: Published,
    /// In the order x y z (mm), rx ry rz (degrees).
    pub(super) motion_errors: [ErrorStatistics; 6],
}

impl PublishedTable {
    pub(super) fn new() -> Self {
        let rows = [1, 2].into_iter().flat_map(|sequence| {
            super::published::ALL.into_iter().filter_map(move |method| {
                let motion_errors = super::published::errors(sequence, method)?;
                Some(PublishedRow { sequence, method, motion_errors })
            })
        });
        Self { source: super::published::SOURCE.to_owned(), rows: rows.collect() }
    }
}

impl Report {
    /// The runs of a sequence on the backend that comes first: where backends agree, plots show one.
    pub(super) fn shown(&self, sequence: u32) -> impl Iterator<Item = &Run> {
        let first = self.backends.iter().find(|b| b.absent.is_none()).map(|b| b.name.as_str());
        self.runs.iter().filter(move |r| r.sequence == sequence && Some(r.backend.as_str()) == first)
    }
}

/// Writes a record as JSON.
pub(super) fn write_json(path: &Path, value: &impl Serialize) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(value)?;
    Ok(write_atomically(path, |out| writeln!(out, "{text}"))?)
}

/// Writes a text.
pub(super) fn write_text(path: &Path, text: &str) -> anyhow::Result<()> {
    write_bytes(path, text.as_bytes())
}

/// Writes a file.
pub(super) fn write_bytes(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    Ok(write_atomically(path, |out| out.write_all(bytes))?)
}
