//! Records that a shader reads by number: in a buffer, or in a texture where the adapter is a software one, as
//! `shaders/parts/on_software.wgsl` explains.

use wgpu::{
    BindingResource, Buffer, BufferUsages, Extent3d, Origin3d, TexelCopyBufferLayout, TexelCopyTextureInfo,
    Texture, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView,
};

use super::context::Context;
use super::shaders::{AdapterClass, TABLE_WIDTH};
use crate::error::Result;

/// What a shader reads at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unit {
    /// `vec2u`.
    TwoWords,
    /// `vec4u` or `vec4f`.
    FourWords,
}

impl Unit {
    const fn bytes(self) -> u32 {
        match self {
            Self::TwoWords => 8,
            Self::FourWords => 16,
        }
    }

    const fn format(self) -> TextureFormat {
        match self {
            Self::TwoWords => TextureFormat::Rg32Uint,
            Self::FourWords => TextureFormat::Rgba32Uint,
        }
    }

    /// Bytes of a row of a texture.
    const fn row(self) -> u32 {
        TABLE_WIDTH * self.bytes()
    }
}

/// Records on the device.
#[derive(Debug)]
pub(super) enum Table {
    Buffer(Buffer),
    Texture { unit: Unit, texture: Texture, view: TextureView },
}

impl Table {
    /// Room for `bytes`, in a scope of the caller's.
    ///
    /// # Errors
    /// [`crate::Error::AdapterTooSmall`] if no buffer or texture of the device has as much.
    pub(super) fn new(
        context: &Context,
        class: AdapterClass,
        (label, unit): (&str, Unit),
        bytes: u64,
    ) -> Result<Self> {
        context.require_below(&format!("{label} (bytes)"), bytes, most_bytes(context, class, unit))?;
        if class == AdapterClass::Gpu {
            return Ok(Self::Buffer(context.buffer(label, bytes, BufferUsages::STORAGE)));
        }
        #[expect(clippy::cast_possible_truncation, reason = "below the device's largest image side")]
        let height = bytes.div_ceil(u64::from(unit.row())).max(1) as u32;
        let texture = context.device.create_texture(&TextureDescriptor {
            label: Some(label),
            size: Extent3d { width: TABLE_WIDTH, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: unit.format(),
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        Ok(Self::Texture { unit, texture, view })
    }

    /// Bytes there is room for.
    pub(super) fn room(&self) -> u64 {
        match self {
            Self::Buffer(buffer) => buffer.size(),
            Self::Texture { unit, texture, .. } => u64::from(unit.row()) * u64::from(texture.height()),
        }
    }

    /// Replaces the first records by these, whole units, before the next submission.
    pub(super) fn write(&self, context: &Context, bytes: &[u8]) {
        match self {
            Self::Buffer(buffer) => context.queue.write_buffer(buffer, 0, bytes),
            Self::Texture { unit, texture, .. } => {
                let row = unit.row() as usize;
                let (whole, rest) = bytes.split_at(bytes.len() / row * row);
                write_rows(context, (*unit, texture), 0, whole);
                write_rows(context, (*unit, texture), whole.len() / row, rest);
            }
        }
    }

    pub(super) fn resource(&self) -> BindingResource<'_> {
        match self {
            Self::Buffer(buffer) => buffer.as_entire_binding(),
            Self::Texture { view, .. } => BindingResource::TextureView(view),
        }
    }
}

/// Largest table of an adapter, bytes.
pub(super) fn most_bytes(context: &Context, class: AdapterClass, unit: Unit) -> u64 {
    match class {
        AdapterClass::Gpu => context.max_bytes(),
        AdapterClass::Software => {
            let texture = u64::from(context.adapter.max_image_side) * u64::from(unit.row());
            texture.min(context.max_bytes())
        }
    }
}

/// Writes whole rows or a part of one.
#[expect(clippy::cast_possible_truncation, reason = "below the device's largest image side")]
fn write_rows(context: &Context, (unit, texture): (Unit, &Texture), first: usize, bytes: &[u8]) {
    if bytes.is_empty() {
        return;
    }
    let row = unit.row() as usize;
    let (width, height) = (bytes.len().min(row) / unit.bytes() as usize, bytes.len().div_ceil(row));
    let size = Extent3d { width: width as u32, height: height as u32, depth_or_array_layers: 1 };
    let origin = Origin3d { y: first as u32, ..Origin3d::ZERO };
    let layout = TexelCopyBufferLayout {
        offset: 0,
        bytes_per_row: Some(size.width * unit.bytes()),
        rows_per_image: Some(size.height),
    };
    let target = TexelCopyTextureInfo { origin, ..texture.as_image_copy() };
    context.queue.write_texture(target, bytes, layout, size);
}
