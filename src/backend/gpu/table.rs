//! Records that a shader reads by number: in a buffer, or in a texture where the adapter is a software one, as
//! `shaders/parts/on_software.wgsl` explains.

use wgpu::{
    BindingResource, Buffer, BufferUsages, Extent3d, Origin3d, TexelCopyBufferLayout, TexelCopyTextureInfo,
    Texture, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView,
};

use super::context::Context;
use super::shaders::{AdapterClass, TABLE_WIDTH};
use crate::error::Result;

/// Bytes of a texel: four words.
const TEXEL: u32 = 16;
/// Bytes of a row of a texture.
const ROW: u32 = TABLE_WIDTH * TEXEL;

/// Records on the device.
#[derive(Debug)]
pub(super) enum Table {
    Buffer(Buffer),
    Texture { texture: Texture, view: TextureView },
}

impl Table {
    /// Room for `bytes`, in an error scope of the caller's.
    ///
    /// # Errors
    /// [`crate::Error::AdapterTooSmall`] if no buffer or texture of the device has as much.
    pub(super) fn new(context: &Context, class: AdapterClass, label: &str, bytes: u64) -> Result<Self> {
        context.require_below(&format!("{label} (bytes)"), bytes, most_bytes(context, class))?;
        if class == AdapterClass::Gpu {
            return Ok(Self::Buffer(context.buffer(label, bytes, BufferUsages::STORAGE)));
        }
        #[expect(clippy::cast_possible_truncation, reason = "below the device's largest image side")]
        let height = bytes.div_ceil(u64::from(ROW)).max(1) as u32;
        let texture = context.device.create_texture(&TextureDescriptor {
            label: Some(label),
            size: Extent3d { width: TABLE_WIDTH, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: TextureFormat::Rgba32Uint,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        Ok(Self::Texture { texture, view })
    }

    /// Bytes there is room for.
    pub(super) fn room(&self) -> u64 {
        match self {
            Self::Buffer(buffer) => buffer.size(),
            Self::Texture { texture, .. } => u64::from(ROW) * u64::from(texture.height()),
        }
    }

    /// Replaces the first records by these, in whole texels, before the next submission.
    pub(super) fn write(&self, context: &Context, bytes: &[u8]) {
        match self {
            Self::Buffer(buffer) => context.queue.write_buffer(buffer, 0, bytes),
            Self::Texture { texture, .. } => {
                let rows = bytes.len() / ROW as usize;
                let (whole, rest) = bytes.split_at(rows * ROW as usize);
                write_rows(context, texture, 0, whole);
                write_rows(context, texture, rows, rest);
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
pub(super) fn most_bytes(context: &Context, class: AdapterClass) -> u64 {
    match class {
        AdapterClass::Gpu => context.max_bytes(),
        AdapterClass::Software => {
            let texture = u64::from(context.adapter.max_image_side) * u64::from(ROW);
            texture.min(context.max_bytes())
        }
    }
}

/// Writes whole rows or a part of one.
#[expect(clippy::cast_possible_truncation, reason = "below the device's largest image side")]
fn write_rows(context: &Context, texture: &Texture, first: usize, bytes: &[u8]) {
    if bytes.is_empty() {
        return;
    }
    let (width, height) =
        (bytes.len().min(ROW as usize) / TEXEL as usize, bytes.len().div_ceil(ROW as usize));
    let size = Extent3d { width: width as u32, height: height as u32, depth_or_array_layers: 1 };
    let origin = Origin3d { y: first as u32, ..Origin3d::ZERO };
    let layout = TexelCopyBufferLayout {
        offset: 0,
        bytes_per_row: Some(size.width * TEXEL),
        rows_per_image: Some(size.height),
    };
    let target = TexelCopyTextureInfo { origin, ..texture.as_image_copy() };
    context.queue.write_texture(target, bytes, layout, size);
}
