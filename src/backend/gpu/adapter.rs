//! Which graphics adapters there are, and which one to take.

use std::str::FromStr;

use serde::Serialize;
use wgpu::{Backends, DeviceType, DownlevelFlags, RequestAdapterError, RequestAdapterOptions};

use crate::error::{Error, Result};

/// Which adapter to open.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum AdapterSelection {
    /// The first of the fastest kind: discrete, integrated, virtual, unknown, software.
    #[default]
    Auto,
    /// The first whose name contains this, whatever the case.
    Name(String),
    /// The one with this [`AdapterSummary::index`].
    Index(usize),
}

impl FromStr for AdapterSelection {
    type Err = std::convert::Infallible;

    /// `auto`, an index, or part of a name.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match (text, text.parse()) {
            ("" | "auto", _) => Self::Auto,
            (_, Ok(index)) => Self::Index(index),
            (name, Err(_)) => Self::Name(name.to_owned()),
        })
    }
}

/// What there is to know about an adapter before it is opened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AdapterSummary {
    /// Position in the list, for [`AdapterSelection::Index`].
    pub index: usize,
    /// Name given by the driver.
    pub name: String,
    /// Graphics interface: `vulkan`, `metal` or `dx12`.
    pub backend: String,
    /// `discrete`, `integrated`, `virtual`, `software` or `other`.
    pub device_type: String,
    /// Driver name and version.
    pub driver: String,
    /// True if the CPU does the work; the CPU backend is faster then.
    pub is_software: bool,
    /// Largest buffer a shader can see, bytes.
    pub max_binding_bytes: u64,
    /// Largest buffer, bytes.
    pub max_buffer_bytes: u64,
    /// Largest image side, pixels.
    pub max_image_side: u32,
    /// Largest number of frames of one size that can be current at a time.
    pub max_layers: u32,
    /// Memory shared by a workgroup, bytes.
    pub max_workgroup_bytes: u32,
}

impl AdapterSummary {
    fn new(index: usize, adapter: &wgpu::Adapter) -> Self {
        let (info, limits) = (adapter.get_info(), adapter.limits());
        let device_type = match info.device_type {
            DeviceType::DiscreteGpu => "discrete",
            DeviceType::IntegratedGpu => "integrated",
            DeviceType::VirtualGpu => "virtual",
            DeviceType::Cpu => "software",
            DeviceType::Other => "other",
        };
        Self {
            index,
            name: info.name,
            backend: info.backend.to_string(),
            device_type: device_type.into(),
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
            is_software: info.device_type == DeviceType::Cpu,
            max_binding_bytes: limits.max_storage_buffer_binding_size,
            max_buffer_bytes: limits.max_buffer_size,
            max_image_side: limits.max_texture_dimension_2d,
            max_layers: limits.max_texture_array_layers,
            max_workgroup_bytes: limits.max_compute_workgroup_storage_size,
        }
    }
}

/// All adapters that can run the shaders; empty where there is no driver.
pub fn adapters() -> Vec<AdapterSummary> {
    let adapters = usable(&instance());
    adapters.iter().enumerate().map(|(i, adapter)| AdapterSummary::new(i, adapter)).collect()
}

/// Finds the selected adapter.
pub(super) fn select(selection: &AdapterSelection) -> Result<(wgpu::Adapter, AdapterSummary)> {
    let instance = instance();
    let adapters = usable(&instance);
    let list: Vec<_> = adapters.iter().enumerate().map(|(i, a)| AdapterSummary::new(i, a)).collect();
    if list.is_empty() {
        return Err(Error::NoAdapter { reason: why_there_is_none(&instance) });
    }
    let chosen = match selection {
        AdapterSelection::Auto => adapters.iter().map(rank).enumerate().min_by_key(|&(i, rank)| (rank, i)),
        AdapterSelection::Name(part) => {
            let part = part.to_lowercase();
            list.iter().position(|a| a.name.to_lowercase().contains(&part)).map(|i| (i, 0))
        }
        AdapterSelection::Index(index) => (*index < list.len()).then_some((*index, 0)),
    };
    let Some((index, _)) = chosen else {
        let present: Vec<_> = list.iter().map(|a| format!("{}: {}", a.index, a.name)).collect();
        let reason = format!("no device matches {selection:?}, present are [{}]", present.join(", "));
        return Err(Error::NoAdapter { reason });
    };
    Ok((adapters[index].clone(), list[index].clone()))
}

fn instance() -> wgpu::Instance {
    wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle().with_env())
}

fn usable(instance: &wgpu::Instance) -> Vec<wgpu::Adapter> {
    let mut adapters = pollster::block_on(instance.enumerate_adapters(Backends::all()));
    let can_compute =
        |a: &wgpu::Adapter| a.get_downlevel_capabilities().flags.contains(DownlevelFlags::COMPUTE_SHADERS);
    adapters.retain(can_compute);
    adapters
}

fn rank(adapter: &wgpu::Adapter) -> u32 {
    match adapter.get_info().device_type {
        DeviceType::DiscreteGpu => 0,
        DeviceType::IntegratedGpu => 1,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    }
}

/// Tells a missing driver from a driver without device.
fn why_there_is_none(instance: &wgpu::Instance) -> String {
    match pollster::block_on(instance.request_adapter(&RequestAdapterOptions::default())) {
        Err(RequestAdapterError::NotFound { active_backends, .. }) if active_backends.is_empty() => {
            "no Vulkan loader or driver could be loaded".into()
        }
        Err(error) => format!("drivers were loaded, but no device was found ({error})"),
        Ok(_) => "no device of this machine runs compute shaders".into(),
    }
}
