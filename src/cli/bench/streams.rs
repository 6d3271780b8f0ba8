//! Many streams of one object: a tracker each, one model for all.

use serde::Serialize;

use super::machine::memory_mb;
use super::measure::{Candidate, timed, tracker};
use super::workload::Workload;
use crate::align::Method;
use crate::error::Result;
use crate::model::Model;
use crate::track::Tracker;

/// Rounds of frames per figure, after one to get going.
const ROUNDS: usize = 2;

#[derive(Debug, Serialize)]
pub(super) struct StreamFigures {
    pub(super) backend: String,
    pub(super) streams: usize,
    /// Frames of all streams together per second of wall time, all cores in use.
    pub(super) per_second: f64,
    pub(super) cpu_ms_per_frame: f64,
    /// Times that work is handed to the device, per frame.
    pub(super) submits_per_frame: f64,
    /// Times that results are waited for, per frame.
    pub(super) maps_per_frame: f64,
    /// Read back from the device, per frame, kB.
    pub(super) kb_read_per_frame: f64,
    /// Memory of the process that one more stream takes (for a software adapter that of the device, too), MB;
    /// not known where the process has freed more than that meanwhile.
    pub(super) mb_per_stream: Option<f64>,
}

/// Tracks batches of every size; the best round of each counts.
#[expect(clippy::cast_precision_loss, reason = "small counts")]
pub(super) fn streams(
    workload: &Workload,
    model: &Model,
    candidate: &Candidate,
    sizes: &[usize],
) -> Result<Vec<StreamFigures>> {
    let mut trackers = vec![tracker(workload, model, candidate, Method::default())?];
    trackers[0].start_at(workload.poses[0]);
    trackers[0].track(&workload.images[0])?;
    let (alone, mut figures) = (memory_mb("VmRSS:"), Vec::new());
    for &streams in sizes {
        while trackers.len() < streams {
            trackers.push(trackers[0].another()?);
        }
        // Every stream is at another point of the sequence.
        let first = |stream: usize| stream % (workload.images.len() - ROUNDS);
        trackers.iter_mut().enumerate().for_each(|(s, t)| t.start_at(workload.poses[first(s)]));
        let (mut cpu, mut wall) = (f64::INFINITY, f64::INFINITY);
        let before = trackers[0].traffic();
        for k in 0..=ROUNDS {
            let images: Vec<_> = (0..streams).map(|s| &workload.images[first(s) + k]).collect();
            let (batch, times) = timed(|| Tracker::track_batch(&mut trackers, &images));
            batch?.into_iter().collect::<Result<Vec<_>>>()?;
            if k > 0 {
                (cpu, wall) = (cpu.min(times.cpu_ms), wall.min(times.wall_ms));
            }
        }
        let (after, frames) = (trackers[0].traffic(), ((ROUNDS + 1) * streams) as f64);
        let per_frame = |after: u64, before: u64| (after - before) as f64 / frames;
        let grown = memory_mb("VmRSS:").zip(alone).map(|(now, alone)| now - alone);
        figures.push(StreamFigures {
            backend: trackers[0].backend_name(),
            streams,
            per_second: streams as f64 / wall * 1e3,
            cpu_ms_per_frame: cpu / streams as f64,
            submits_per_frame: per_frame(after.submits, before.submits),
            maps_per_frame: per_frame(after.maps, before.maps),
            kb_read_per_frame: per_frame(after.bytes_read, before.bytes_read) / 1e3,
            mb_per_stream: grown.filter(|mb| streams > 1 && *mb > 0.0).map(|mb| mb / (streams - 1) as f64),
        });
    }
    Ok(figures)
}
