//! The current frame: one texture per pyramid level.

use image::GrayImage;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout, BindingResource,
    CommandEncoderDescriptor, Extent3d, SamplerDescriptor, TexelCopyBufferInfo, TexelCopyBufferLayout,
    Texture, TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureViewDescriptor,
};

use super::context::Context;
use super::halving::Halver;
use super::readback::Readback;
use crate::error::Result;
use crate::imaging::Pyramid;

/// Rows in buffers that are copied to or from textures are multiples of this, bytes.
pub(super) const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// Textures of all levels of one image size.
#[derive(Debug)]
pub(super) struct Frame {
    /// Full size.
    size: (u32, u32),
    levels: Vec<FrameLevel>,
    /// Present if the device builds the pyramid.
    halver: Option<Halver>,
}

/// One level: a texture (of at least one pixel) and the bind group that shows it to `accumulate`.
#[derive(Debug)]
struct FrameLevel {
    size: (u32, u32),
    texture: Texture,
    bind_group: BindGroup,
}

impl Frame {
    /// Textures for images of this size.
    pub(super) fn new(
        context: &Context,
        layout: &BindGroupLayout,
        size: (u32, u32),
        levels: usize,
        halver: Option<Halver>,
    ) -> Result<Self> {
        let side = u64::from(size.0.max(size.1));
        context.require_below("image side (pixels)", side, u64::from(context.adapter.max_image_side))?;
        let levels = context.scoped("creating the frame", || {
            let sampler = context.device.create_sampler(&SamplerDescriptor::default());
            let level = |k: usize| FrameLevel::new(context, layout, &sampler, level_size(size, k));
            (0..levels.max(1)).map(level).collect()
        })?;
        Ok(Self { size, levels, halver })
    }

    /// True if images of this size with this many levels fit without new textures.
    pub(super) fn fits(&self, size: (u32, u32), levels: usize) -> bool {
        self.size == size && self.levels.len() == levels.max(1)
    }

    /// Number of levels.
    pub(super) fn len(&self) -> usize {
        self.levels.len()
    }

    /// Group 2 of `accumulate`.
    pub(super) fn bind_group(&self, level: usize) -> &BindGroup {
        &self.levels[level].bind_group
    }

    /// Fills all levels from a full-size image.
    pub(super) fn upload(&mut self, context: &Context, image: &GrayImage) -> Result<()> {
        context.scoped("uploading the frame", || {
            let mut encoder = context.device.create_command_encoder(&CommandEncoderDescriptor::default());
            if let Some(halver) = &mut self.halver {
                halver.upload(context, image);
                halver.encode(&mut encoder);
                for (level, (buffer, stride)) in self.levels.iter().zip(halver.packed()) {
                    let source = TexelCopyBufferInfo { buffer, layout: rows(stride, level.size.1) };
                    if let Some(extent) = level.extent() {
                        encoder.copy_buffer_to_texture(source, level.texture.as_image_copy(), extent);
                    }
                }
            } else {
                self.write(context, &Pyramid::new(image.clone(), self.levels.len()));
            }
            // Also where nothing is encoded: otherwise uploads of frames nobody looks at would pile up.
            context.submit(encoder);
        })
    }

    fn write(&self, context: &Context, pyramid: &Pyramid) {
        for (k, level) in self.levels.iter().enumerate() {
            if let Some(extent) = level.extent() {
                let layout = rows(extent.width, extent.height);
                let target = level.texture.as_image_copy();
                context.queue.write_texture(target, pyramid.level(k).as_raw(), layout, extent);
            }
        }
    }

    /// Reads a level back.
    pub(super) fn read(&self, context: &Context, readback: &mut Readback, level: usize) -> Result<GrayImage> {
        let FrameLevel { size: (width, height), texture, .. } = &self.levels[level];
        let Some(extent) = self.levels[level].extent() else { return Ok(GrayImage::new(*width, *height)) };
        let stride = width.next_multiple_of(ROW_ALIGNMENT);
        let bytes = u64::from(stride) * u64::from(*height);
        let buffer = readback.buffer(context, bytes)?;
        let submission = context.scoped("reading a pyramid level", || {
            let mut encoder = context.device.create_command_encoder(&CommandEncoderDescriptor::default());
            let target = TexelCopyBufferInfo { buffer, layout: rows(stride, *height) };
            encoder.copy_texture_to_buffer(texture.as_image_copy(), target, extent);
            context.submit(encoder)
        })?;
        readback.read(context, submission, bytes, |data| {
            GrayImage::from_fn(*width, *height, |x, y| image::Luma([data[(y * stride + x) as usize]]))
        })
    }
}

impl FrameLevel {
    fn new(context: &Context, layout: &BindGroupLayout, sampler: &wgpu::Sampler, size: (u32, u32)) -> Self {
        // Textures have pixels; one that stands for an empty image is a single black one, where nothing is inside.
        let extent = Extent3d { width: size.0.max(1), height: size.1.max(1), depth_or_array_layers: 1 };
        let texture = context.device.create_texture(&TextureDescriptor {
            label: Some("frame"),
            size: extent,
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: TextureFormat::R8Unorm,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST | TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&TextureViewDescriptor::default());
        let resources = [BindingResource::TextureView(&view), BindingResource::Sampler(sampler)];
        let entries: Vec<_> =
            (0..).zip(resources).map(|(binding, resource)| BindGroupEntry { binding, resource }).collect();
        let bind_group = context.device.create_bind_group(&BindGroupDescriptor {
            label: Some("frame"),
            layout,
            entries: &entries,
        });
        Self { size, texture, bind_group }
    }

    /// What there is to copy; `None` for an image without pixels.
    fn extent(&self) -> Option<Extent3d> {
        let (width, height) = self.size;
        (width > 0 && height > 0).then_some(Extent3d { width, height, depth_or_array_layers: 1 })
    }
}

/// Size of a pyramid level.
pub(super) fn level_size((width, height): (u32, u32), level: usize) -> (u32, u32) {
    let half = |n: u32| u32::try_from(level).ok().and_then(|k| n.checked_shr(k)).unwrap_or(0);
    (half(width), half(height))
}

fn rows(stride: u32, height: u32) -> TexelCopyBufferLayout {
    TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(stride), rows_per_image: Some(height) }
}
