//! `track --smooth`: smoothed poses in a file of their own, beside the tracked ones.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::records::ResultsFile;
use crate::dataset::ResultRow;
use crate::error::Error;
use crate::model::Model;
use crate::track::Tracked;
use crate::track::smooth::{Smoothed, Smoother};

/// Without `--fps`.
const FPS: f64 = 30.0;
/// Without `--lag`, milliseconds.
const LAG_MS: f64 = 100.0;

#[derive(Debug, Clone, clap::Args)]
pub(super) struct SmoothArgs {
    /// Also write smoothed poses (BOP CSV); those of --out stay as they are
    #[arg(long, value_name = "FILE")]
    smooth: Option<PathBuf>,
    /// How late a smoothed pose may come, milliseconds; 0: at once [default: 100]
    #[arg(long, value_name = "MS", requires = "smooth", allow_negative_numbers = true)]
    lag: Option<f64>,
    /// Frames per second, for --smooth [default: 30]
    #[arg(long, value_name = "FPS", requires = "smooth", allow_negative_numbers = true)]
    fps: Option<f64>,
}

/// Where smoothed poses go, and how late they come.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Smoothing {
    results: PathBuf,
    lag_ms: f64,
    lag_frames: usize,
    fps: f64,
}

impl SmoothArgs {
    /// What is wished, if anything is.
    pub(super) fn smoothing(&self) -> Result<Option<Smoothing>, Error> {
        let Some(path) = &self.smooth else { return Ok(None) };
        let (lag_ms, fps) = (self.lag.unwrap_or(LAG_MS), self.fps.unwrap_or(FPS));
        // Written so that NaN is refused.
        if !(fps > 0.0 && fps <= 1e5) {
            return Err(Error::invalid("--fps", fps.to_string(), "give the frames per second, more than 0"));
        }
        let frames = lag_ms * fps / 1e3;
        if !(0.0..=1000.0).contains(&frames) {
            let problem = format!("{lag_ms} ms at {fps} frames per second");
            return Err(Error::invalid("--lag", problem, "give milliseconds, 0 to 1000 frames"));
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1000")]
        let lag_frames = (frames + 1e-9).floor() as usize;
        #[expect(clippy::cast_precision_loss, reason = "at most 1000")]
        let lag_ms = lag_frames as f64 / fps * 1e3;
        Ok(Some(Smoothing { results: path.clone(), lag_ms, lag_frames, fps }))
    }
}

impl std::fmt::Display for Smoothing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { results, lag_ms, lag_frames, fps } = self;
        let path = results.display();
        write!(f, "{path}: smoothed poses, {lag_frames} frames late ({lag_ms:.1} ms at {fps} per second)")
    }
}

/// The file while a scene is tracked.
#[derive(Debug)]
pub(super) struct SmoothedFile {
    smoother: Smoother,
    fps: f64,
    /// Rows of the tracked poses whose smoothed one is not ready.
    waiting: VecDeque<ResultRow>,
    results: ResultsFile,
}

impl SmoothedFile {
    pub(super) fn create(smoothing: &Smoothing, model: &Model) -> Result<Self, Error> {
        let path: &Path = &smoothing.results;
        let smoother = Smoother::new(model, smoothing.lag_frames);
        Ok(Self {
            smoother,
            fps: smoothing.fps,
            waiting: VecDeque::new(),
            results: ResultsFile::create(path)?,
        })
    }

    /// After a frame and its row; a row without a pose stays as it is.
    pub(super) fn push(&mut self, row: &ResultRow, tracked: &Tracked) -> Result<(), Error> {
        let ready = self.smoother.push(f64::from(row.im_id) / self.fps, tracked)?;
        if tracked.status.has_pose() {
            self.waiting.push_back(*row);
            self.write(&ready)
        } else {
            self.write(&ready)?;
            self.results.write(row)
        }
    }

    fn write(&mut self, ready: &[Smoothed]) -> Result<(), Error> {
        for (smoothed, row) in ready.iter().zip(self.waiting.drain(..ready.len().min(self.waiting.len()))) {
            self.results.write(&ResultRow { pose: smoothed.camera_from_object, ..row })?;
        }
        Ok(())
    }

    pub(super) fn finish(mut self) -> Result<(), Error> {
        let ready = self.smoother.finish();
        self.write(&ready)?;
        self.results.finish()
    }
}
