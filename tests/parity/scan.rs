//! Parity of stage `scan`: device and fast path against the twin.

use aam6d::backend::gpu::GpuOptions;
use aam6d::backend::{Backend, CpuBackend, ScanPeak};
use libtest_mimic::Failed;

use super::support::gpu::open;
use super::support::scan::{ScanScene, compare_peaks};

/// Sizes around that of a tile, of a run of vectors and of a workgroup, with one template and with many.
const SCANNED: [(usize, usize, usize); 5] = [(80, 60, 40), (21, 19, 3), (20, 20, 1), (161, 7, 9), (1, 1, 2)];

fn peaks(backend: &mut dyn Backend, scene: &ScanScene) -> Result<Vec<ScanPeak>, Failed> {
    let mut peaks = Vec::new();
    backend.scan(&scene.request(), &mut peaks)?;
    Ok(peaks)
}

pub(super) fn scan_agrees() -> Result<(), Failed> {
    let mut gpu = open(GpuOptions { as_software: Some(false), ..GpuOptions::default() });
    for (seed, (width, height, templates)) in (40..).step_by(2).zip(SCANNED) {
        let scene = ScanScene::new(seed, width, height, templates);
        let expected = peaks(&mut CpuBackend::twin(), &scene)?;
        compare_peaks(&expected, &peaks(&mut gpu, &scene)?).map_err(|e| format!("{width}x{height}: {e}"))?;
    }
    Ok(())
}

pub(super) fn fast_scan_agrees() -> Result<(), Failed> {
    for (seed, (width, height, templates)) in (40..).step_by(2).zip(SCANNED) {
        let scene = ScanScene::new(seed, width, height, templates);
        let expected = peaks(&mut CpuBackend::twin(), &scene)?;
        let found = peaks(&mut CpuBackend::new(), &scene)?;
        compare_peaks(&expected, &found).map_err(|e| format!("{width}x{height}: {e}"))?;
    }
    Ok(())
}

/// A single point of a template moved by a pixel.
pub(super) fn a_changed_template_is_noticed() -> Result<(), Failed> {
    let scene = ScanScene::new(60, 80, 60, 2);
    let expected = peaks(&mut CpuBackend::twin(), &scene)?;
    let mut moved = ScanScene::new(60, 80, 60, 2);
    let mut points = scene.templates.get(1).0.to_vec();
    points[0].offset[0] += 1;
    moved.templates = Default::default();
    moved.templates.push(scene.templates.get(0).0);
    moved.templates.push(&points);
    let mut gpu = open(GpuOptions { as_software: Some(false), ..GpuOptions::default() });
    for backend in [&mut gpu as &mut dyn Backend, &mut CpuBackend::new()] {
        if compare_peaks(&expected, &peaks(backend, &moved)?).is_ok() {
            return Err("a moved point went unnoticed".into());
        }
    }
    Ok(())
}
