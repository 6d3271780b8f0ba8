//! The seam between host and device: a backend of your own, here one that counts what another is asked to do.
//! `cargo run --release --example 02_custom_backend`.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use aam6d::Result;
use aam6d::align::{InverseCompositional, Start};
use aam6d::backend::{Backend, CpuBackend, Linearization, ModelId, Request, Sums};
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{Sequence, SequenceOptions};
use aam6d::track::Tracker;
use aam6d::train::{TrainOptions, TrainingImage, train};

/// Calls and poses of the `accumulate` stage.
#[derive(Debug, Default)]
struct Counts {
    calls: AtomicUsize,
    poses: AtomicUsize,
}

#[derive(Debug)]
struct Counting {
    inner: CpuBackend,
    counts: Arc<Counts>,
}

impl Backend for Counting {
    fn name(&self) -> String {
        format!("counting {}", self.inner.name())
    }

    fn load(&mut self, model: &Model) -> Result<ModelId> {
        self.inner.load(model)
    }

    fn set_frame(&mut self, image: &GrayImage, levels: usize) -> Result<()> {
        self.inner.set_frame(image, levels)
    }

    fn accumulate(&mut self, request: &Request<'_>, sums: &mut Sums) -> Result<()> {
        self.counts.calls.fetch_add(1, Ordering::Relaxed);
        self.counts.poses.fetch_add(request.items, Ordering::Relaxed);
        self.inner.accumulate(request, sums)
    }

    fn linearize(&mut self, request: &Request<'_>, out: &mut Linearization) -> Result<()> {
        self.inner.linearize(request, out)
    }
}

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let sequence = Sequence::new(SequenceOptions { frames: 9, ..SequenceOptions::default() })?;
    let (camera, truth) = (*sequence.camera(), sequence.pose(8));
    let view = TrainingImage { image: sequence.image(0), camera, camera_from_object: sequence.pose(0) };
    let model = train(&sequence.object().mesh, &[view], &TrainOptions::default())?;

    let counts = Arc::new(Counts::default());
    let backend = Box::new(Counting { inner: CpuBackend::new(), counts: Arc::clone(&counts) });
    let mut tracker = Tracker::new(model, camera, backend, Box::new(InverseCompositional::default()))?;
    // The pose of the first frame, many times: all starts of a call go through the levels in step.
    let start = Start { camera_from_object: sequence.pose(0), appearance: Vec::new() };
    let estimates = tracker.align(&sequence.image(8), &vec![start; 64])?;
    let off = (estimates[0].camera_from_object.translation() - truth.translation()).norm() * 1e3;
    let (calls, poses) = (counts.calls.load(Ordering::Relaxed), counts.poses.load(Ordering::Relaxed));
    writeln!(std::io::stdout().lock(), "64 alignments, {off:.3} mm off: {poses} poses in {calls} calls")?;
    Ok(())
}
