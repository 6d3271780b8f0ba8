//! The measurements: CPU time of the whole process, of which neighbours take nothing away, and wall time.

use std::hint::black_box;
use std::time::Instant;

use cpu_time::ProcessTime;
use image::GrayImage;
use serde::Serialize;

use super::Effort;
use super::bandwidth;
use super::workload::Workload;
use crate::align::Method;
use crate::backend::cpu::downsample::downsample;
use crate::backend::{Backend, CpuBackend, Linearization, ModelId, Request};
use crate::error::Result;
use crate::model::Model;
use crate::track::Tracker;

/// Calls in a row that are timed together: what threads of a software adapter are at when the clock is read is not in the time
/// of the process yet.
const CALLS: usize = 4;

/// A backend to measure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Candidate {
    Twin,
    Fast,
    #[cfg(feature = "gpu")]
    Gpu(String),
}

impl Candidate {
    /// All there are; the GPU only where an adapter opens.
    pub(super) fn all(adapter: &str) -> Vec<Self> {
        let mut all = vec![Self::Twin, Self::Fast];
        #[cfg(feature = "gpu")]
        if adapter != "none" && open_gpu(adapter).is_some() {
            all.push(Self::Gpu(adapter.to_owned()));
        }
        #[cfg(not(feature = "gpu"))]
        let _ = adapter;
        all.shrink_to_fit();
        all
    }

    pub(super) fn is_twin(&self) -> bool {
        *self == Self::Twin
    }

    fn open(&self) -> Result<Box<dyn Backend>> {
        Ok(match self {
            Self::Twin => Box::new(CpuBackend::twin()),
            Self::Fast => Box::new(CpuBackend::new()),
            #[cfg(feature = "gpu")]
            Self::Gpu(adapter) => {
                let Ok(selection) = adapter.parse();
                Box::new(crate::backend::GpuBackend::open(&selection)?)
            }
        })
    }
}

#[cfg(feature = "gpu")]
pub(super) fn open_gpu(adapter: &str) -> Option<crate::backend::GpuBackend> {
    let Ok(selection) = adapter.parse();
    crate::backend::GpuBackend::open(&selection).ok()
}

/// CPU and wall time of something.
#[derive(Debug, Clone, Copy, Serialize)]
pub(super) struct Times {
    pub(super) cpu_ms: f64,
    pub(super) wall_ms: f64,
}

pub(super) fn timed<T>(work: impl FnOnce() -> T) -> (T, Times) {
    let (wall, cpu) = (Instant::now(), ProcessTime::now());
    let value = work();
    let (cpu, wall) = (cpu.elapsed(), wall.elapsed());
    (value, Times { cpu_ms: cpu.as_secs_f64() * 1e3, wall_ms: wall.as_secs_f64() * 1e3 })
}

/// CPU time of a call among others like it, milliseconds; the first, which finds the cache full of something else, does not count.
fn cpu_ms(mut call: impl FnMut() -> Result<()>) -> Result<f64> {
    call()?;
    let (done, times) = timed(|| (0..CALLS).try_for_each(|_| call()));
    done?;
    #[expect(clippy::cast_precision_loss, reason = "a handful")]
    let calls = CALLS as f64;
    Ok(times.cpu_ms / calls)
}

/// CPU time of a stage, ns per pixel.
#[derive(Debug, Serialize)]
pub(super) struct StageFigure {
    pub(super) stage: &'static str,
    pub(super) backend: String,
    pub(super) ns_per_px: f64,
}

/// One pass over the full size with `modes` modes.
#[derive(Debug, Serialize)]
pub(super) struct PassFigures {
    pub(super) modes: usize,
    pub(super) pixels: usize,
    pub(super) stages: Vec<StageFigure>,
    /// Bytes of template that the fast implementation reads per pixel, padding included.
    pub(super) bytes_per_px: f64,
    /// Reading as many bytes and doing nothing else, measured in the same rounds.
    pub(super) limit_ns_per_px: f64,
}

/// A candidate with everything in place for a pass.
struct Runner {
    backend: Box<dyn Backend>,
    model: ModelId,
    out: Linearization,
}

/// Measures all candidates and the limit in turns; the best round of each counts.
#[expect(clippy::cast_precision_loss, reason = "pixel counts are far below 2^52")]
pub(super) fn passes(
    workload: &Workload,
    model: &Model,
    candidates: &[Candidate],
    effort: Effort,
) -> Result<PassFigures> {
    let (warps, image) = (workload.warps(model), &workload.images[0]);
    let appearance = vec![0.3; model.modes()];
    let mut runners = Vec::new();
    for candidate in candidates {
        let mut backend = candidate.open()?;
        let model = backend.load(model)?;
        backend.set_frame(image, 1)?;
        runners.push(Runner { backend, model, out: Linearization::default() });
    }
    let mut fast = CpuBackend::new();
    let id = fast.load(model)?;
    let bytes = fast.bytes_per_pass(id, 0);
    let data = vec![1_u32; bytes / 4];
    let level = fearless_simd::Level::new();
    let mut best = vec![f64::INFINITY; runners.len() + 2];
    let mut best_linearize = vec![f64::INFINITY; runners.len()];
    for _ in 0..effort.rounds {
        for ((best, linearize), r) in best.iter_mut().zip(&mut best_linearize).zip(&mut runners) {
            let (model, warps, appearance) = (r.model, &*warps, &*appearance);
            let request =
                Request { model, level: 0, image_level: 0, items: 1, frames: &[], warps, appearance };
            // One stage after the other: in turns each would find the other's data in the cache.
            *best = best.min(cpu_ms(|| r.backend.accumulate(&request, &mut r.out.sums))?);
            *linearize = linearize.min(cpu_ms(|| r.backend.linearize(&request, &mut r.out))?);
        }
        let [limit, halving] = [runners.len(), runners.len() + 1];
        let read = || {
            black_box(bandwidth::read(level, black_box(&data)));
            Ok(())
        };
        best[limit] = best[limit].min(cpu_ms(read)?);
        let halve = || {
            black_box(downsample(black_box(image)));
            Ok(())
        };
        best[halving] = best[halving].min(cpu_ms(halve)?);
    }
    let pixels = model.levels[0].pixels.len();
    let per_px = |ms: f64| ms * 1e6 / pixels as f64;
    let figure =
        |stage, r: &Runner, ms: f64| StageFigure { stage, backend: r.backend.name(), ns_per_px: per_px(ms) };
    let mut stages: Vec<_> = runners.iter().zip(&best).map(|(r, ms)| figure("accumulate", r, *ms)).collect();
    stages.extend(runners.iter().zip(&best_linearize).map(|(r, ms)| figure("linearize", r, *ms)));
    let of_image = best[runners.len() + 1] * 1e6 / image_pixels(image);
    stages.push(StageFigure { stage: "downsample", backend: "cpu".into(), ns_per_px: of_image });
    Ok(PassFigures {
        modes: model.modes(),
        pixels,
        stages,
        bytes_per_px: bytes as f64 / pixels as f64,
        limit_ns_per_px: per_px(best[runners.len()]),
    })
}

fn image_pixels(image: &GrayImage) -> f64 {
    f64::from(image.width()) * f64::from(image.height())
}

pub(super) fn tracker(
    workload: &Workload,
    model: &Model,
    candidate: &Candidate,
    method: Method,
) -> Result<Tracker> {
    Tracker::new(model.clone(), workload.camera, candidate.open()?, method.aligner())
}

/// Many poses of one object in one frame.
#[derive(Debug, Serialize)]
pub(super) struct ThroughputFigures {
    pub(super) backend: String,
    pub(super) poses: usize,
    /// Poses aligned per second of wall time, all cores in use.
    pub(super) per_second: f64,
    pub(super) cpu_ms_per_pose: f64,
}

/// Aligns batches of every size with the first frame; the better of two runs counts.
#[expect(clippy::cast_precision_loss, reason = "small counts")]
pub(super) fn throughput(
    workload: &Workload,
    model: &Model,
    candidate: &Candidate,
    sizes: &[usize],
) -> Result<Vec<ThroughputFigures>> {
    let mut tracker = tracker(workload, model, candidate, Method::default())?;
    let mut figures = Vec::new();
    for &poses in sizes {
        let starts = workload.starts(model, poses);
        let (mut cpu, mut wall) = (f64::INFINITY, f64::INFINITY);
        for _ in 0..2 {
            let (done, times) = timed(|| tracker.align(&workload.images[0], &starts));
            done?;
            (cpu, wall) = (cpu.min(times.cpu_ms), wall.min(times.wall_ms));
        }
        figures.push(ThroughputFigures {
            backend: tracker.backend_name(),
            poses,
            per_second: poses as f64 / wall * 1e3,
            cpu_ms_per_pose: cpu / poses as f64,
        });
    }
    Ok(figures)
}
