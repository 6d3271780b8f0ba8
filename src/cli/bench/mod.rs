//! `aam6d bench`: time per pixel, per frame and per pose on every backend, beside what the memory allows.

mod bandwidth;
mod frames;
mod machine;
mod measure;
mod report;
mod streams;
mod workload;

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::summary::JsonArg;
use crate::align::Method;
use crate::dataset::write_atomically;
use frames::{FrameFigures, LoadFigures};
use machine::Machine;
use measure::{Candidate, PassFigures, ThroughputFigures};
use streams::StreamFigures;
use workload::Workload;

/// Where `--write` writes.
const DOCUMENT: &str = "docs/benchmarks.md";
/// Appearance modes of the standard workloads.
const MODES: [usize; 4] = [0, 4, 8, 16];
/// Template pixels of the standard workloads, and of those that show how cost grows with them.
const PIXELS: usize = 72_000;
const SIZES: [usize; 4] = [4_500, 18_000, 72_000, 288_000];
/// Modes where one number has to do.
const STANDARD_MODES: usize = 4;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// A few seconds instead of minutes: fewer rounds, frames and poses
    #[arg(long)]
    quick: bool,
    /// GPU adapter to use: part of its name or its number; `none` leaves the GPU out
    #[arg(long, value_name = "NAME|INDEX|none", default_value = "auto")]
    adapter: String,
    /// Also write the tables to this file
    #[arg(long, value_name = "FILE")]
    markdown: Option<PathBuf>,
    /// Also write the tables to docs/benchmarks.md
    #[arg(long)]
    write: bool,
    #[command(flatten)]
    json: JsonArg,
}

/// How much is measured.
#[derive(Debug, Clone, Copy, Serialize)]
struct Effort {
    /// Rounds in which all candidates take turns.
    rounds: usize,
    /// Frames tracked per figure.
    frames: usize,
    /// Poses aligned with one frame.
    poses: &'static [usize],
}

const FULL: Effort = Effort { rounds: 30, frames: 30, poses: &[1, 8, 64, 512] };
const QUICK: Effort = Effort { rounds: 5, frames: 6, poses: &[1, 8] };

/// All that is measured.
#[derive(Debug, Serialize)]
struct Summary {
    machine: Machine,
    effort: Effort,
    template_px: Vec<usize>,
    triangles: usize,
    passes: Vec<PassFigures>,
    /// As `passes`, for different numbers of pixels.
    sizes: Vec<PassFigures>,
    frames: Vec<FrameFigures>,
    throughput: Vec<ThroughputFigures>,
    streams: Vec<StreamFigures>,
    loads: Vec<LoadFigures>,
    peak_memory_mb: Option<f64>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let effort = if args.quick { QUICK } else { FULL };
    // One thread for all but the throughput of many poses: its time is what the work costs.
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let workload = Workload::new(effort.frames)?;
    let standard = workload.model(STANDARD_MODES, PIXELS)?;
    let mut summary = Summary {
        machine: Machine::new(&args.adapter),
        effort,
        template_px: standard.levels.iter().map(|level| level.pixels.len()).collect(),
        triangles: standard.shape.triangles(),
        passes: Vec::new(),
        sizes: Vec::new(),
        frames: Vec::new(),
        throughput: Vec::new(),
        streams: Vec::new(),
        loads: Vec::new(),
        peak_memory_mb: None,
    };
    let candidates = Candidate::all(&args.adapter);
    for modes in MODES {
        let model = workload.model(modes, PIXELS)?;
        summary.passes.push(one.install(|| measure::passes(&workload, &model, &candidates, effort))?);
        let compared = [Method::default(), Method::ForwardAdditive];
        let methods = if modes == STANDARD_MODES { &compared[..] } else { &compared[..1] };
        for (load, frame) in one.install(|| frames::frames(&workload, &model, &candidates, methods))? {
            summary.loads.extend((frame.method == Method::default()).then_some(load));
            summary.frames.push(frame);
        }
    }
    for pixels in SIZES {
        let model = workload.model(STANDARD_MODES, pixels)?;
        summary.sizes.push(one.install(|| measure::passes(&workload, &model, &candidates, effort))?);
    }
    for candidate in candidates.iter().filter(|c| !c.is_twin()) {
        summary.throughput.extend(measure::throughput(&workload, &standard, candidate, effort.poses)?);
        summary.streams.extend(streams::streams(&workload, &standard, candidate, effort.poses)?);
    }
    summary.peak_memory_mb = machine::memory_mb("VmHWM:");
    let text = report::markdown(&summary)?;
    let document = args.write.then(|| Path::new(DOCUMENT));
    for path in args.markdown.as_deref().into_iter().chain(document) {
        write_atomically(path, |out| out.write_all(text.as_bytes()))?;
    }
    args.json.write(&text, &summary)
}
