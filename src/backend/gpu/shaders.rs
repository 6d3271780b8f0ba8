//! The stages as the device sees them: source text, bindings, pipelines.

use wgpu::{
    BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntry, BindingType, BufferBindingType,
    ComputePipeline, ComputePipelineDescriptor, PipelineCompilationOptions, PipelineLayoutDescriptor,
    SamplerBindingType, ShaderModuleDescriptor, ShaderSource, ShaderStages, TextureSampleType,
    TextureViewDimension,
};

use super::context::Context;
use crate::error::Result;

/// Memory of a workgroup every WebGPU device has, bytes.
pub const WORKGROUP_BYTES: u32 = 16384;

/// Workgroup sizes are multiples of this: `REDUCE` in `shaders/parts/on_gpu.wgsl`.
pub const REDUCE: u32 = 8;

/// Texels per row of a table in a texture: `TABLE_WIDTH` in `shaders/parts/on_software.wgsl`.
pub const TABLE_WIDTH: u32 = 2048;

/// What an adapter is good at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AdapterClass {
    /// Many invocations at a time, shared memory.
    Gpu,
    /// The CPU in its place.
    Software,
}

/// What a binding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A struct of constants.
    Uniform,
    /// A buffer that is read.
    Read,
    /// A buffer that is written.
    Write,
    /// Records that are read by number: a buffer on a real GPU, a texture of unsigned numbers on a software adapter.
    Table,
    /// Grey images of one size, one per layer.
    Image,
    /// A sampler; it only gathers.
    Sampler,
}

/// A stage: shader file, entry point, pipeline label and twin have its name.
#[derive(Debug, Clone, Copy)]
pub struct Stage {
    /// The one name.
    pub name: &'static str,
    source: &'static str,
    /// What stands beside the source on a class of adapters.
    part: fn(AdapterClass) -> &'static str,
    /// Names and kinds of the bindings, group by group.
    pub groups: &'static [&'static [(&'static str, Kind)]],
}

/// Image level k to k+1.
pub const DOWNSAMPLE: Stage = Stage {
    name: "downsample",
    source: concat!(
        include_str!("../../../shaders/common.wgsl"),
        include_str!("../../../shaders/downsample.wgsl")
    ),
    part: |_| "",
    groups: &[&[("halving", Kind::Uniform), ("larger", Kind::Read), ("smaller", Kind::Write)]],
};

/// Templates at every position of an image.
pub const SCAN: Stage = Stage {
    name: "scan",
    source: concat!(include_str!("../../../shaders/common.wgsl"), include_str!("../../../shaders/scan.wgsl")),
    part: |_| "",
    groups: &[&[
        ("scanned", Kind::Uniform),
        ("gradient", Kind::Read),
        ("points", Kind::Read),
        ("templates", Kind::Read),
        ("peaks", Kind::Write),
    ]],
};

/// The bindings of the stages that add up chunks of charts, `shaders/parts/chart_sums.wgsl`.
const CHART_SUMS: &[&[(&str, Kind)]] = &[
    &[("level", Kind::Uniform), ("chunks", Kind::Table), ("pixels", Kind::Table), ("modes", Kind::Table)],
    &[("warps", Kind::Table), ("appearance", Kind::Table), ("sums", Kind::Write)],
    &[("image", Kind::Image), ("image_sampler", Kind::Sampler)],
];

/// How they read tables and add up.
const fn chart_sums_on(class: AdapterClass) -> &'static str {
    match class {
        AdapterClass::Gpu => include_str!("../../../shaders/parts/on_gpu.wgsl"),
        AdapterClass::Software => include_str!("../../../shaders/parts/on_software.wgsl"),
    }
}

/// Warp, sample, residual, weight, sums.
pub const ACCUMULATE: Stage = Stage {
    name: "accumulate",
    source: concat!(
        include_str!("../../../shaders/common.wgsl"),
        include_str!("../../../shaders/parts/chart_sums.wgsl"),
        include_str!("../../../shaders/accumulate.wgsl")
    ),
    part: chart_sums_on,
    groups: CHART_SUMS,
};

/// The same with the frame's gradient, and second-order sums.
pub const LINEARIZE: Stage = Stage {
    name: "linearize",
    source: concat!(
        include_str!("../../../shaders/common.wgsl"),
        include_str!("../../../shaders/parts/chart_sums.wgsl"),
        include_str!("../../../shaders/linearize.wgsl")
    ),
    part: chart_sums_on,
    groups: CHART_SUMS,
};

impl Stage {
    /// The shader for a class of adapters and `mode_planes` planes of four modes. The count is part of the text and not a pipeline constant
    /// because local arrays have it as their length.
    pub fn text(&self, class: AdapterClass, mode_planes: u32) -> String {
        format!("const MODE_PLANES: u32 = {mode_planes}u;\n{}{}", self.source, (self.part)(class))
    }

    /// The layouts of its bind groups.
    pub(super) fn layouts(&self, context: &Context, class: AdapterClass) -> Vec<BindGroupLayout> {
        let layout = |bindings: &&[(&str, Kind)]| {
            let entries: Vec<_> = (0..).zip(*bindings).map(|(i, &(_, kind))| entry(i, kind, class)).collect();
            context.device.create_bind_group_layout(&BindGroupLayoutDescriptor {
                label: Some(self.name),
                entries: &entries,
            })
        };
        self.groups.iter().map(layout).collect()
    }

    /// Compiles it for a workgroup size.
    pub(super) fn pipeline(
        &self,
        context: &Context,
        layouts: &[BindGroupLayout],
        (class, mode_planes): (AdapterClass, u32),
        workgroup: u32,
    ) -> Result<ComputePipeline> {
        let groups: Vec<_> = layouts.iter().map(Some).collect();
        context.scoped(&format!("compiling {}", self.name), || {
            let module = context.device.create_shader_module(ShaderModuleDescriptor {
                label: Some(self.name),
                source: ShaderSource::Wgsl(self.text(class, mode_planes).into()),
            });
            let layout = context.device.create_pipeline_layout(&PipelineLayoutDescriptor {
                label: Some(self.name),
                bind_group_layouts: &groups,
                immediate_size: 0,
            });
            context.device.create_compute_pipeline(&ComputePipelineDescriptor {
                label: Some(self.name),
                layout: Some(&layout),
                module: &module,
                entry_point: Some(self.name),
                compilation_options: PipelineCompilationOptions {
                    constants: &[("WORKGROUP", f64::from(workgroup))],
                    // Every value is written before it is read.
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            })
        })
    }
}

/// How work is cut into pieces on a kind of adapter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Partition {
    /// Where tables are and who adds up the sums of a chunk.
    pub class: AdapterClass,
    /// Invocations per workgroup.
    pub workgroup: u32,
    /// Largest number of pixels per workgroup.
    pub chunk_pixels: u32,
}

impl Partition {
    /// Software adapters want the SIMD width and long loops, real ones many invocations.
    pub const fn of_adapter(is_software: bool) -> Self {
        if is_software {
            Self { class: AdapterClass::Software, workgroup: 8, chunk_pixels: 512 }
        } else {
            Self { class: AdapterClass::Gpu, workgroup: 128, chunk_pixels: 512 }
        }
    }

    /// Workgroup size of a stage with that many planes of sums: smaller where they would not fit.
    pub const fn workgroup_for(self, planes: u32) -> u32 {
        let mut workgroup = self.workgroup;
        while workgroup > REDUCE && self.shared_bytes(workgroup, planes) > WORKGROUP_BYTES {
            workgroup /= 2;
        }
        workgroup
    }

    /// Memory that a workgroup of that size shares for that many planes of sums, bytes.
    pub const fn shared_bytes(self, workgroup: u32, planes: u32) -> u32 {
        match self.class {
            AdapterClass::Gpu => workgroup * planes * 16,
            AdapterClass::Software => 0,
        }
    }

    /// Rows of sums of a chunk that come back to the host.
    pub(super) const fn rows_per_chunk(self) -> usize {
        match self.class {
            AdapterClass::Gpu => 1,
            AdapterClass::Software => self.workgroup as usize,
        }
    }
}

/// Planes of four sums per chunk: `SUM_PLANES` in `shaders/accumulate.wgsl`.
pub const fn accumulate_planes(mode_planes: u32) -> u32 {
    3 + mode_planes
}

/// Planes of four sums per chunk: `SUM_PLANES` in `shaders/linearize.wgsl`.
pub const fn linearize_planes(mode_planes: u32) -> u32 {
    11 + 7 * mode_planes
}

fn entry(binding: u32, kind: Kind, class: AdapterClass) -> BindGroupLayoutEntry {
    let buffer = |ty| BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    let texture = |sample_type, view_dimension| BindingType::Texture {
        sample_type,
        view_dimension,
        multisampled: false,
    };
    let ty = match kind {
        Kind::Uniform => buffer(BufferBindingType::Uniform),
        Kind::Read => buffer(BufferBindingType::Storage { read_only: true }),
        Kind::Write => buffer(BufferBindingType::Storage { read_only: false }),
        Kind::Table => match class {
            AdapterClass::Gpu => buffer(BufferBindingType::Storage { read_only: true }),
            AdapterClass::Software => texture(TextureSampleType::Uint, TextureViewDimension::D2),
        },
        Kind::Image => texture(TextureSampleType::Float { filterable: true }, TextureViewDimension::D2Array),
        Kind::Sampler => BindingType::Sampler(SamplerBindingType::Filtering),
    };
    BindGroupLayoutEntry { binding, visibility: ShaderStages::COMPUTE, ty, count: None }
}
