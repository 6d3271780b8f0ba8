//! What was measured on.

use std::process::Command;

use serde::Serialize;

#[cfg(feature = "gpu")]
use crate::backend::Backend as _;
use crate::backend::CpuBackend;

#[derive(Debug, Serialize)]
pub(super) struct Machine {
    pub(super) version: &'static str,
    pub(super) commit: Option<String>,
    pub(super) profile: &'static str,
    pub(super) cpu: String,
    pub(super) cores: usize,
    pub(super) instructions: String,
    pub(super) adapter: Option<String>,
    pub(super) driver: Option<String>,
}

impl Machine {
    pub(super) fn new(adapter: &str) -> Self {
        let (adapter, driver) = gpu(adapter).unzip();
        Self {
            version: env!("CARGO_PKG_VERSION"),
            commit: commit(),
            profile: if cfg!(debug_assertions) { "dev" } else { "release" },
            cpu: cpu(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            instructions: CpuBackend::new().instructions(),
            adapter,
            driver,
        }
    }
}

fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| std::env::consts::ARCH.to_owned(), |(_, name)| name.trim().to_owned())
}

/// The commit of the working folder, marked if files differ from it.
fn commit() -> Option<String> {
    let git = Command::new("git").args(["describe", "--always", "--dirty"]).output().ok()?;
    let text = String::from_utf8(git.stdout).ok()?.trim().to_owned();
    (git.status.success() && !text.is_empty()).then_some(text)
}

#[cfg(feature = "gpu")]
fn gpu(adapter: &str) -> Option<(String, String)> {
    if adapter == "none" {
        return None;
    }
    let name = super::measure::open_gpu(adapter)?.name();
    let summary = crate::backend::adapters().into_iter().find(|a| a.name == name)?;
    Some((format!("{} ({}, {})", name, summary.device_type, summary.backend), summary.driver))
}

#[cfg(not(feature = "gpu"))]
fn gpu(_adapter: &str) -> Option<(String, String)> {
    None
}

/// Memory of this process, MB, where the system tells: `VmRSS:` now, `VmHWM:` at most.
pub(super) fn memory_mb(which: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(which))?;
    let kib: f64 = line.trim().trim_end_matches("kB").trim().parse().ok()?;
    Some(kib * 1024.0 / 1e6)
}
