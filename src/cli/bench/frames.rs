//! Frames of one stream: all candidates and methods in turns, sequence by sequence, as nobody tracks with other data in the cache.

use serde::Serialize;

use super::measure::{Candidate, Times, timed, tracker};
use super::workload::Workload;
use crate::align::Method;
use crate::error::Result;
use crate::eval::statistics::median;
use crate::model::Model;
use crate::track::Tracker;

/// Times that the sequence is tracked; the best time of every frame counts.
const PASSES: usize = 12;

/// Loading a model, warm-up included.
#[derive(Debug, Serialize)]
pub(super) struct LoadFigures {
    pub(super) backend: String,
    pub(super) modes: usize,
    pub(super) open_and_load: Times,
}

/// Tracking one stream.
#[derive(Debug, Serialize)]
pub(super) struct FrameFigures {
    pub(super) method: Method,
    pub(super) backend: String,
    pub(super) modes: usize,
    /// Median over the frames.
    pub(super) per_frame: Times,
    pub(super) iterations: f64,
    pub(super) lost: usize,
}

/// A tracker, and what its frames took so far.
struct Run {
    method: Method,
    tracker: Tracker,
    open_and_load: Times,
    best: Vec<Times>,
    iterations: usize,
    lost: usize,
}

impl Run {
    fn new(workload: &Workload, model: &Model, candidate: &Candidate, method: Method) -> Result<Self> {
        let (tracker, open_and_load) = timed(|| tracker(workload, model, candidate, method));
        let never = Times { cpu_ms: f64::INFINITY, wall_ms: f64::INFINITY };
        let best = vec![never; workload.images.len()];
        Ok(Self { method, tracker: tracker?, open_and_load, best, iterations: 0, lost: 0 })
    }

    fn track(&mut self, workload: &Workload, frame: usize) -> Result<()> {
        if frame == 0 {
            self.tracker.start_at(workload.poses[0]);
        }
        let (tracked, times) = timed(|| self.tracker.track(&workload.images[frame]));
        let tracked = tracked?;
        let best = &mut self.best[frame];
        (best.cpu_ms, best.wall_ms) = (best.cpu_ms.min(times.cpu_ms), best.wall_ms.min(times.wall_ms));
        self.iterations += tracked.estimate.iterations;
        self.lost += usize::from(!tracked.status.has_pose());
        Ok(())
    }

    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    fn figures(&self, modes: usize) -> (LoadFigures, FrameFigures) {
        let backend = self.tracker.backend_name();
        let middle = |time: fn(&Times) -> f64| {
            median(&self.best.iter().map(time).collect::<Vec<_>>()).unwrap_or(f64::NAN)
        };
        let per_frame = Times { cpu_ms: middle(|t| t.cpu_ms), wall_ms: middle(|t| t.wall_ms) };
        let iterations = self.iterations as f64 / (PASSES * self.best.len()) as f64;
        // The same in every pass.
        let lost = self.lost / PASSES;
        let Self { method, open_and_load, .. } = *self;
        (
            LoadFigures { backend: backend.clone(), modes, open_and_load },
            FrameFigures { method, backend, modes, per_frame, iterations, lost },
        )
    }
}

/// Tracks all frames of the workload with every candidate by every method.
pub(super) fn frames(
    workload: &Workload,
    model: &Model,
    candidates: &[Candidate],
    methods: &[Method],
) -> Result<Vec<(LoadFigures, FrameFigures)>> {
    let mut runs = Vec::new();
    for &method in methods {
        for candidate in candidates {
            runs.push(Run::new(workload, model, candidate, method)?);
        }
    }
    for _ in 0..PASSES {
        for run in &mut runs {
            (0..workload.images.len()).try_for_each(|frame| run.track(workload, frame))?;
        }
    }
    Ok(runs.iter().map(|run| run.figures(model.modes())).collect())
}
