//! Tests that need a graphics adapter: ignored where there is none, unless `AAM6D_REQUIRE_GPU=1`.

use std::process::ExitCode;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};

use aam6d::backend::gpu::GpuOptions;
use aam6d::backend::{AdapterSelection, Backend, GpuBackend, Linearization, Sums, adapters};
use libtest_mimic::{Arguments, Failed, Trial};

use super::Scene;

/// The adapter under test: `AAM6D_ADAPTER` (name or index), else the best.
pub(crate) fn selection() -> AdapterSelection {
    std::env::var("AAM6D_ADAPTER").unwrap_or_default().parse().unwrap_or_default()
}

/// Opens a backend of its own.
pub(crate) fn open(options: GpuOptions) -> GpuBackend {
    GpuBackend::open_with(&selection(), options).expect("an adapter was found before")
}

/// The backend all tests of a program share, so that every shader is compiled once.
pub(crate) fn shared() -> MutexGuard<'static, GpuBackend> {
    static SHARED: LazyLock<Mutex<GpuBackend>> = LazyLock::new(|| Mutex::new(open(GpuOptions::default())));
    SHARED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Sums of a scene.
pub(crate) fn sums(gpu: &mut GpuBackend, scene: &Scene) -> Result<Sums, Failed> {
    let model = gpu.load(&scene.model)?;
    gpu.set_frame(&scene.image, 1)?;
    let mut sums = Sums::default();
    gpu.accumulate(&scene.request(model), &mut sums)?;
    Ok(sums)
}

/// Linearization of a scene.
pub(crate) fn linearization(gpu: &mut GpuBackend, scene: &Scene) -> Result<Linearization, Failed> {
    let model = gpu.load(&scene.model)?;
    gpu.set_frame(&scene.image, 1)?;
    let mut out = Linearization::default();
    gpu.linearize(&scene.request(model), &mut out)?;
    Ok(out)
}

/// A test that needs an adapter.
pub(crate) fn trial(
    name: impl Into<String>,
    test: impl FnOnce() -> Result<(), Failed> + Send + 'static,
) -> Trial {
    static PRESENT: LazyLock<bool> = LazyLock::new(|| !adapters().is_empty());
    let required = std::env::var("AAM6D_REQUIRE_GPU").is_ok_and(|v| v == "1");
    let run = move || if *PRESENT { test() } else { Err("no adapter, and AAM6D_REQUIRE_GPU=1".into()) };
    Trial::test(name, run).with_kind("gpu").with_ignored_flag(!*PRESENT && !required)
}

/// Runs the tests.
pub(crate) fn main(trials: Vec<Trial>) -> ExitCode {
    libtest_mimic::run(&Arguments::from_args(), trials).exit_code()
}
