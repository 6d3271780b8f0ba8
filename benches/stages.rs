//! Time per stage on the CPU (fast and twin) and on the best adapter; bench ids are `<stage>/<backend>/<size>`.
//!
//! Wall time on a shared machine means little; compare the two backends within one run.

use std::hint::black_box;

use aam6d::backend::cpu::downsample::downsample;
use aam6d::backend::gpu::{GpuOptions, PyramidPlace};
use aam6d::backend::{AdapterSelection, Backend, CpuBackend, GpuBackend, Linearization, Sums};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

#[allow(dead_code, reason = "shared with the tests")]
#[path = "../tests/support/scene.rs"]
mod scene;
use scene::Scene;

const PIXELS: usize = 72_000;
const MODES: [usize; 3] = [0, 4, 8];

/// Both implementations on the CPU, and the best adapter where there is one.
fn backends() -> Vec<(&'static str, Box<dyn Backend>)> {
    let mut backends: Vec<(&str, Box<dyn Backend>)> =
        vec![("cpu", Box::new(CpuBackend::new())), ("twin", Box::new(CpuBackend::twin()))];
    if let Ok(gpu) = GpuBackend::open(&AdapterSelection::Auto) {
        backends.push(("gpu", Box::new(gpu)));
    }
    backends
}

fn bench_accumulate(c: &mut Criterion) {
    let mut group = c.benchmark_group("accumulate");
    group.throughput(Throughput::Elements(PIXELS as u64));
    for modes in MODES {
        let scene = Scene::new(1, PIXELS, modes, 1);
        for (name, mut backend) in backends() {
            let model = backend.load(&scene.model).expect("the scene fits");
            backend.set_frame(&scene.image, 1).expect("the frame fits");
            let mut sums = Sums::default();
            group.bench_function(BenchmarkId::new(name, format!("{modes}modes")), |b| {
                b.iter(|| backend.accumulate(black_box(&scene.request(model)), &mut sums));
            });
        }
    }
    group.finish();
}

fn bench_linearize(c: &mut Criterion) {
    let mut group = c.benchmark_group("linearize");
    group.throughput(Throughput::Elements(PIXELS as u64));
    for modes in MODES {
        let scene = Scene::new(1, PIXELS, modes, 1);
        for (name, mut backend) in backends() {
            let model = backend.load(&scene.model).expect("the scene fits");
            backend.set_frame(&scene.image, 1).expect("the frame fits");
            let mut out = Linearization::default();
            group.bench_function(BenchmarkId::new(name, format!("{modes}modes")), |b| {
                b.iter(|| backend.linearize(black_box(&scene.request(model)), &mut out));
            });
        }
    }
    group.finish();
}

fn bench_downsample(c: &mut Criterion) {
    let image = scene::image(&mut ChaCha8Rng::seed_from_u64(1), 640, 480);
    let mut group = c.benchmark_group("downsample");
    group.throughput(Throughput::Elements(u64::from(image.width() * image.height())));
    group.bench_function(BenchmarkId::new("cpu", "640x480"), |b| b.iter(|| downsample(black_box(&image))));
    let options = GpuOptions { pyramid: PyramidPlace::Device, ..GpuOptions::default() };
    if let Ok(mut gpu) = GpuBackend::open_with(&AdapterSelection::Auto, options) {
        group.bench_function(BenchmarkId::new("gpu", "640x480"), |b| {
            b.iter(|| {
                gpu.set_frame(black_box(&image), 2).expect("the frame fits");
                // Waits for the device by the one way there is.
                gpu.read_level(0, 1)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, bench_accumulate, bench_linearize, bench_downsample);
criterion_main!(benches);
