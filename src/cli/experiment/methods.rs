//! What is compared: methods, and the backends they run on.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use super::published::Published;
use crate::align::{
    Aligner, Edge, EdgeOptions, ForwardAdditive, ForwardOptions, Grouping, InverseCompositional, Method,
    Options, Order, Paper, PaperOptions,
};
use crate::backend::{Backend, CpuBackend};
use crate::train::TrainOptions;

/// The method of the paper's Table 1 beside which ours stands.
pub(super) fn counterpart(method: Method) -> Published {
    match method {
        Method::InverseCompositional | Method::Paper => Published::Proposed,
        Method::ForwardAdditive => Published::Previous,
        Method::Edge => Published::Geometric,
    }
}

/// Steps per level or phase at most in the basin study: enough that the basin decides and not the limit.
pub(super) const PATIENT_STEPS: usize = 50;

/// The method with its default choices but for a limit of steps that is out of the way. Without a pyramid gain and bias
/// are shared per face at full size too: per triangle they are for the last stage only.
pub(super) fn patient(method: Method, order: Order, pyramid: bool) -> Box<dyn Aligner> {
    let max_iterations = PATIENT_STEPS;
    let full_size_grouping = if pyramid { Grouping::Triangle } else { Grouping::FaceAndView };
    match method {
        Method::InverseCompositional => Box::new(InverseCompositional::new(Options {
            max_iterations,
            full_size_grouping,
            ..Options::default()
        })),
        Method::Paper => {
            Box::new(Paper::new(PaperOptions { order, max_iterations, ..PaperOptions::default() }))
        }
        Method::ForwardAdditive => Box::new(ForwardAdditive::new(ForwardOptions {
            max_iterations,
            full_size_grouping,
            ..ForwardOptions::default()
        })),
        Method::Edge => Box::new(Edge::new(EdgeOptions { max_iterations, ..EdgeOptions::default() })),
    }
}

/// True if the method goes from coarse to fine.
pub(super) fn has_pyramid(method: Method) -> bool {
    method != Method::Paper
}

/// A value for methods that take the triangles between landmarks as they are, and one for the others.
#[derive(Debug, Clone)]
pub(super) struct PerShape<T> {
    pub(super) cut: T,
    pub(super) whole: T,
}

impl<T> PerShape<T> {
    /// Makes one value per kind of shape, from the options that train it.
    pub(super) fn train(
        options: &TrainOptions,
        make: impl Fn(&TrainOptions) -> anyhow::Result<T>,
    ) -> anyhow::Result<Self> {
        let whole = TrainOptions { max_edge_px: f64::INFINITY, ..options.clone() };
        Ok(Self { cut: make(options)?, whole: make(&whole)? })
    }

    /// The one for a method.
    pub(super) fn of(&self, method: Method) -> &T {
        if method.wants_whole_triangles() { &self.whole } else { &self.cut }
    }
}

/// Which backends take part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum BackendChoice {
    /// The CPU backend, and the GPU backend where there is an adapter
    #[default]
    Both,
    /// The CPU backend
    Cpu,
    /// The GPU backend; an error if there is no adapter
    Gpu,
}

/// A backend that takes part, or why it does not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Engine {
    /// `cpu` or `gpu`.
    pub(super) name: String,
    /// The adapter behind it; for the CPU backend its own name.
    pub(super) device: Option<String>,
    /// True where the GPU backend runs on a software adapter.
    pub(super) software: bool,
    /// Why it takes no part.
    pub(super) absent: Option<String>,
}

impl Engine {
    fn cpu() -> Self {
        Self { name: "cpu".into(), device: Some(CpuBackend::new().name()), software: false, absent: None }
    }

    fn absent(why: String) -> Self {
        Self { name: "gpu".into(), device: None, software: false, absent: Some(why) }
    }

    /// Opens it.
    pub(super) fn open(&self, adapter: Option<&str>) -> anyhow::Result<Box<dyn Backend>> {
        if self.name == "cpu" { Ok(Box::new(CpuBackend::new())) } else { open_gpu(adapter) }
    }
}

/// The engines of a choice, those that are absent included.
pub(super) fn engines(choice: BackendChoice, adapter: Option<&str>) -> anyhow::Result<Vec<Engine>> {
    match choice {
        BackendChoice::Cpu => {
            anyhow::ensure!(adapter.is_none(), "--adapter chooses a GPU; leave it out with --backend cpu");
            Ok(vec![Engine::cpu()])
        }
        BackendChoice::Gpu => Ok(vec![gpu(adapter)?]),
        BackendChoice::Both if adapter.is_some() => Ok(vec![Engine::cpu(), gpu(adapter)?]),
        BackendChoice::Both => {
            let gpu = gpu(None).unwrap_or_else(|why| Engine::absent(format!("{why:#}")));
            Ok(vec![Engine::cpu(), gpu])
        }
    }
}

#[cfg(feature = "gpu")]
fn gpu(adapter: Option<&str>) -> anyhow::Result<Engine> {
    let device = open_gpu(adapter)?.name();
    let software = crate::backend::gpu::adapters().iter().any(|a| a.is_software && device.contains(&a.name));
    Ok(Engine { name: "gpu".into(), device: Some(device), software, absent: None })
}

#[cfg(feature = "gpu")]
fn open_gpu(adapter: Option<&str>) -> anyhow::Result<Box<dyn Backend>> {
    let Ok(selection) = adapter.unwrap_or("auto").parse();
    Ok(Box::new(crate::backend::GpuBackend::open(&selection)?))
}

#[cfg(not(feature = "gpu"))]
fn gpu(adapter: Option<&str>) -> anyhow::Result<Engine> {
    open_gpu(adapter).map(|_| Engine::absent(String::new()))
}

#[cfg(not(feature = "gpu"))]
fn open_gpu(_adapter: Option<&str>) -> anyhow::Result<Box<dyn Backend>> {
    anyhow::bail!("this program was built without the feature `gpu`")
}
