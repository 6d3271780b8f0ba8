//! One method on one backend through one sequence.

use std::path::Path;

use super::cases::Case;
use super::methods::{Engine, counterpart};
use super::motion;
use super::published;
use super::record::{Below, FrameError, Run};
use crate::align::{Method, Order};
use crate::cli::decode::Latency;
use crate::cli::method::aligner;
use crate::cli::track::{Outputs, track_scene};
use crate::eval::frames::frame_errors;
use crate::eval::{Estimate, evaluate};
use crate::track::Tracker;

/// Pictures per run.
const OVERLAYS: usize = 3;

/// What is run, and where its files go.
pub(super) struct Plan<'a> {
    pub(super) case: &'a Case,
    pub(super) method: Method,
    pub(super) order: Order,
    pub(super) engine: &'a Engine,
    pub(super) adapter: Option<&'a str>,
    pub(super) out: &'a Path,
    /// Shown beside the progress bar.
    pub(super) label: String,
}

impl Plan<'_> {
    /// The name of everything this run writes.
    fn name(&self) -> String {
        format!("{}-{}-{}", self.case.record.number, self.method.name(), self.engine.name)
    }

    /// Tracks the sequence, writes `runs/<name>.csv`, `.jsonl` and pictures, and judges the result.
    pub(super) fn run(&self) -> anyhow::Result<Run> {
        let Case { scene, truth, object, models, start, .. } = self.case;
        let backend = self.engine.open(self.adapter)?;
        let camera = scene.frames[0].camera;
        let mut tracker =
            Tracker::new(models.of(self.method).clone(), camera, backend, aligner(self.method, self.order))?;
        tracker.start_at(*start);
        let results = self.out.join("runs").join(format!("{}.csv", self.name()));
        let details = results.with_extension("jsonl");
        let overlay = self.out.join("overlays").join(self.name());
        let every = scene.frames.len().div_ceil(OVERLAYS);
        let outputs = Outputs {
            results: &results,
            details: Some(&details),
            smoothing: None,
            overlay: Some(&overlay),
            overlay_every: every,
            latency: Latency::Low,
            what: &self.label,
        };
        let estimates = track_scene(&mut tracker, scene, &outputs)?.estimates;
        let evaluation = evaluate(&estimates, truth, object, &scene.cameras())?;
        let drawn = scene.frames.iter().step_by(every);
        let overlays = drawn.map(|f| format!("overlays/{}/{:06}.png", self.name(), f.id)).collect();
        Ok(Run { evaluation, overlays, ..self.judge(&estimates) })
    }

    /// Everything that follows from the estimates.
    fn judge(&self, estimates: &[Estimate]) -> Run {
        let Case { scene, truth, object, record, robot, .. } = self.case;
        let judged = frame_errors(estimates, truth, object, &scene.cameras());
        let lost_frames: Vec<u32> = judged.iter().filter(|f| f.lost).map(|f| f.frame).collect();
        let first = scene.frames[0].id;
        let coefficients = motion::of_estimates(estimates, &lost_frames, robot, first);
        let motion_errors = motion::errors(estimates, &lost_frames, robot);
        let counterpart = counterpart(self.method);
        let below_published = published::errors(record.number, counterpart)
            .and_then(|published| Below::of(&published, &motion_errors));
        let frames = judged.iter().map(|f| FrameError {
            frame: f.frame,
            lost: f.lost,
            t_mm: f.errors.map(|e| e.translation_mm.norm()),
            r_deg: f.errors.map(|e| e.rotation_deg.norm()),
        });
        Run {
            sequence: record.number,
            method: self.method,
            backend: self.engine.name.clone(),
            counterpart,
            motion_errors,
            below_published,
            lost_frames,
            evaluation: Default::default(),
            coefficients,
            frames: frames.collect(),
            overlays: Vec::new(),
        }
    }
}
