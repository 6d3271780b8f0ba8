//! `aam6d info`: adapters, the choice of `--backend auto`, and a short test of CPU against GPU.

use std::fmt::Write as _;

use serde::Serialize;

use super::backend::BackendArgs;
use super::summary::JsonArg;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    json: JsonArg,
}

#[derive(Debug, Serialize)]
struct Summary {
    version: &'static str,
    #[cfg(feature = "gpu")]
    adapters: Vec<crate::backend::gpu::AdapterSummary>,
    chosen: Option<Chosen>,
    #[cfg(feature = "gpu")]
    self_test: Option<self_test::Outcome>,
}

#[derive(Debug, Serialize)]
struct Chosen {
    backend: String,
    why: String,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let chosen = args.backend.open()?;
    let chosen = Chosen { backend: chosen.backend.name(), why: chosen.why };
    let mut text = format!("aam6d {}\n", env!("CARGO_PKG_VERSION"));
    #[cfg(feature = "gpu")]
    let adapters = crate::backend::gpu::adapters();
    #[cfg(feature = "gpu")]
    describe(&mut text, &adapters)?;
    writeln!(text, "used: {} ({})", chosen.backend, chosen.why)?;
    #[cfg(feature = "gpu")]
    let self_test = self_test::run(args.backend.gpu_adapter(), &adapters)?;
    #[cfg(feature = "gpu")]
    match &self_test {
        Some(outcome) => writeln!(text, "{outcome}")?,
        None => writeln!(text, "self-test: left out, there is no GPU adapter")?,
    }
    let summary = Summary {
        version: env!("CARGO_PKG_VERSION"),
        #[cfg(feature = "gpu")]
        adapters,
        chosen: Some(chosen),
        #[cfg(feature = "gpu")]
        self_test,
    };
    args.json.write(&text, &summary)?;
    #[cfg(feature = "gpu")]
    anyhow::ensure!(
        summary.self_test.is_none_or(|t| t.passed),
        "the self-test failed: do not trust this adapter"
    );
    Ok(())
}

#[cfg(feature = "gpu")]
fn describe(text: &mut String, adapters: &[crate::backend::gpu::AdapterSummary]) -> std::fmt::Result {
    if adapters.is_empty() {
        writeln!(
            text,
            "no GPU adapter (Debian/Ubuntu: apt-get install mesa-vulkan-drivers gives a software one)"
        )?;
    }
    for a in adapters {
        writeln!(text, "adapter {}: {} ({}, {}, {})", a.index, a.name, a.device_type, a.backend, a.driver)?;
        writeln!(
            text,
            "  buffers up to {} MiB, {} MiB in one binding; images up to {} px; {} B shared by a workgroup",
            a.max_buffer_bytes >> 20,
            a.max_binding_bytes >> 20,
            a.max_image_side,
            a.max_workgroup_bytes
        )?;
    }
    Ok(())
}

#[cfg(feature = "gpu")]
mod self_test {
    use std::fmt;

    use nalgebra::{Point3, Vector3};
    use serde::Serialize;

    use crate::align::{InverseCompositional, PoseEstimate, Start};
    use crate::backend::gpu::{AdapterSelection, AdapterSummary};
    use crate::backend::{Backend, CpuBackend, GpuBackend};
    use crate::error::Result;
    use crate::geometry::Pose;
    use crate::simulate::{Sequence, SequenceOptions};
    use crate::track::Tracker;
    use crate::train::{TrainOptions, TrainingImage, train};

    /// Poses of the two backends may differ by this much: f32 against f64 at the same stop rule.
    const TOLERANCE_MM: f64 = 1e-2;
    const TOLERANCE_DEG: f64 = 1e-3;

    /// The same alignments on both backends, compared.
    #[derive(Debug, Serialize)]
    pub(super) struct Outcome {
        adapter: String,
        alignments: usize,
        difference_mm: f64,
        difference_deg: f64,
        pub(super) passed: bool,
    }

    impl fmt::Display for Outcome {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(
                f,
                "self-test: {} alignments, CPU against {}: {:.1e} mm, {:.1e} deg apart: {}",
                self.alignments,
                self.adapter,
                self.difference_mm,
                self.difference_deg,
                if self.passed { "passed" } else { "FAILED" }
            )
        }
    }

    /// Runs on the given adapter, or on the one `--backend gpu` would take; nothing without any.
    pub(super) fn run(adapter: Option<&str>, adapters: &[AdapterSummary]) -> Result<Option<Outcome>> {
        if adapters.is_empty() {
            return Ok(None);
        }
        let Ok(selection): std::result::Result<AdapterSelection, _> = adapter.unwrap_or("auto").parse();
        let gpu = GpuBackend::open(&selection)?;
        let adapter = gpu.name();
        let (on_cpu, centre) = alignments(Box::new(CpuBackend::new()))?;
        let (on_gpu, _) = alignments(Box::new(gpu))?;
        let (mut mm, mut deg) = (0.0, 0.0);
        for (a, b) in on_cpu.iter().zip(&on_gpu) {
            let (a, b) = (a.camera_from_object, b.camera_from_object);
            mm = f64::max(mm, (a.transform_point(&centre) - b.transform_point(&centre)).norm() * 1e3);
            deg = f64::max(deg, a.compose(&b.inverse()).rotation_vector().norm().to_degrees());
        }
        let tracked = on_cpu.iter().chain(&on_gpu).all(|e| !e.score.is_lost());
        let passed = tracked && mm <= TOLERANCE_MM && deg <= TOLERANCE_DEG;
        Ok(Some(Outcome {
            adapter,
            alignments: on_cpu.len(),
            difference_mm: mm,
            difference_deg: deg,
            passed,
        }))
    }

    /// Aligns a simulated frame from a few starts.
    fn alignments(backend: Box<dyn Backend>) -> Result<(Vec<PoseEstimate>, Point3<f64>)> {
        let sequence =
            Sequence::new(SequenceOptions { frames: 9, supersampling: 2, ..SequenceOptions::default() })?;
        let image = |k| TrainingImage {
            image: sequence.image(k),
            camera: *sequence.camera(),
            camera_from_object: sequence.pose(k),
        };
        let model = train(&sequence.object().mesh, &[image(0)], &TrainOptions::default())?;
        let centre = model.shape.centre;
        let mut tracker =
            Tracker::new(model, *sequence.camera(), backend, Box::new(InverseCompositional::default()))?;
        let start = |(turn, shift): (Vector3<f64>, Vector3<f64>)| Start {
            camera_from_object: sequence.pose(8).compose(&Pose::about(turn, shift, &centre)),
            appearance: Vec::new(),
        };
        let starts =
            [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| start((axis * 0.02, -axis * 0.002)));
        Ok((tracker.align(&sequence.image(8), &starts)?, centre))
    }
}
