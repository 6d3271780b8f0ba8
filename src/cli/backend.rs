//! `--backend` and `--adapter`: which backend does the image work, and why.

use anyhow::Context;
use clap::ValueEnum;

use crate::backend::{Backend, CpuBackend};

/// Where the image work is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
enum Choice {
    /// A real GPU if there is one, else the CPU backend
    #[default]
    Auto,
    /// The CPU backend
    Cpu,
    /// A GPU; an error if there is none
    Gpu,
}

#[derive(Debug, Clone, Default, clap::Args)]
pub(super) struct BackendArgs {
    /// Where the image work is done
    #[arg(long, value_enum, default_value = "auto")]
    backend: Choice,
    /// GPU adapter to use: part of its name or its number (see `aam6d info`)
    #[arg(long, value_name = "NAME|INDEX")]
    adapter: Option<String>,
}

/// A backend and the reason why it was chosen.
pub(super) struct Opened {
    pub(super) backend: Box<dyn Backend>,
    pub(super) why: String,
}

impl BackendArgs {
    /// The adapter asked for.
    #[cfg(feature = "gpu")]
    pub(super) fn gpu_adapter(&self) -> Option<&str> {
        self.adapter.as_deref()
    }

    /// Opens the chosen backend.
    pub(super) fn open(&self) -> anyhow::Result<Opened> {
        match (self.backend, self.adapter.as_deref()) {
            (Choice::Cpu, Some(_)) => {
                anyhow::bail!("--adapter chooses a GPU; leave it out with --backend cpu")
            }
            (Choice::Cpu, None) => Ok(cpu("asked for")),
            (Choice::Gpu, adapter) => gpu(adapter.unwrap_or("auto"), "asked for"),
            (Choice::Auto, Some(adapter)) => gpu(adapter, "adapter asked for"),
            (Choice::Auto, None) => auto(),
        }
    }
}

fn cpu(why: &str) -> Opened {
    Opened { backend: Box::new(CpuBackend::new()), why: why.to_owned() }
}

#[cfg(feature = "gpu")]
fn gpu(adapter: &str, why: &str) -> anyhow::Result<Opened> {
    let Ok(selection) = adapter.parse();
    let backend = crate::backend::GpuBackend::open(&selection).context("cannot open the GPU backend")?;
    Ok(Opened { backend: Box::new(backend), why: why.to_owned() })
}

#[cfg(not(feature = "gpu"))]
fn gpu(_adapter: &str, _why: &str) -> anyhow::Result<Opened> {
    Err(anyhow::anyhow!("this program was built without the feature `gpu`; use --backend cpu"))
        .context("cannot open the GPU backend")
}

#[cfg(feature = "gpu")]
fn auto() -> anyhow::Result<Opened> {
    let adapters = crate::backend::gpu::adapters();
    match adapters.iter().find(|a| !a.is_software) {
        Some(real) => gpu(&real.index.to_string(), "a real GPU is present"),
        None if adapters.is_empty() => Ok(cpu("no GPU adapter is present")),
        None => Ok(cpu("only a software adapter is present, and the CPU backend is faster")),
    }
}

#[cfg(not(feature = "gpu"))]
fn auto() -> anyhow::Result<Opened> {
    Ok(cpu("built without the feature `gpu`"))
}
