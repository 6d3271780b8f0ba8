//! The current frames, all of one size: one texture per pyramid level, one layer per frame.

use image::GrayImage;
use rayon::prelude::*;
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout, BindingResource,
    CommandEncoderDescriptor, Extent3d, Origin3d, SamplerDescriptor, TexelCopyBufferInfo,
    TexelCopyBufferLayout, TexelCopyTextureInfo, Texture, TextureDescriptor, TextureDimension, TextureFormat,
    TextureUsages, TextureViewDescriptor, TextureViewDimension,
};

use super::GpuBackend;
use super::buffers::small;
use super::context::Context;
use super::halving::{Halver, padded_bytes};
use super::readback::Readback;
use crate::error::{Error, Result};
use crate::imaging::Pyramid;

/// Rows in buffers that are copied to or from textures are multiples of this, bytes.
pub(super) const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// Textures of all levels of one image size.
#[derive(Debug)]
pub(super) struct Frames {
    /// Full size.
    size: (u32, u32),
    /// Frames there is room for.
    layers: u32,
    /// Frames that are current.
    count: u32,
    levels: Vec<FrameLevel>,
    /// Present if the device builds the pyramid.
    halver: Option<Halver>,
}

/// One level: a texture (of at least one pixel and layer) and the bind group that shows it to `accumulate`.
#[derive(Debug)]
struct FrameLevel {
    size: (u32, u32),
    texture: Texture,
    bind_group: BindGroup,
}

impl Frames {
    /// Textures for `layers` images of this size.
    pub(super) fn new(
        context: &Context,
        layout: &BindGroupLayout,
        (size, layers): ((u32, u32), u32),
        levels: usize,
        halver: Option<Halver>,
    ) -> Result<Self> {
        let side = u64::from(size.0.max(size.1));
        context.require_below("image side (pixels)", side, u64::from(context.adapter.max_image_side))?;
        let levels = context.scoped("creating the frame", || {
            let sampler = context.device.create_sampler(&SamplerDescriptor::default());
            let level = |k: usize| FrameLevel::new(context, layout, &sampler, (level_size(size, k), layers));
            (0..levels.max(1)).map(level).collect()
        })?;
        Ok(Self { size, layers, count: 0, levels, halver })
    }

    /// True if so many images of this size with this many levels fit without new textures.
    pub(super) fn fits(&self, (size, layers): ((u32, u32), u32), levels: usize) -> bool {
        self.size == size && self.layers >= layers && self.levels.len() == levels.max(1)
    }

    /// Number of frames, and of their levels.
    pub(super) fn counts(&self) -> (usize, usize) {
        (self.count as usize, self.levels.len())
    }

    /// Group 2 of `accumulate`.
    pub(super) fn bind_group(&self, level: usize) -> &BindGroup {
        &self.levels[level].bind_group
    }

    /// Makes full-size images the current frames.
    pub(super) fn upload(&mut self, context: &Context, images: &[&GrayImage]) -> Result<()> {
        self.count = small(images.len());
        context.scoped("uploading the frames", || {
            let mut encoder = context.device.create_command_encoder(&CommandEncoderDescriptor::default());
            if let Some(halver) = &self.halver {
                each(images, |frame, image| halver.upload(context, frame, image))?;
                halver.encode(&mut encoder, self.count);
                for (level, (buffer, stride)) in self.levels.iter().zip(halver.packed()) {
                    let source = TexelCopyBufferInfo { buffer, layout: rows(stride, level.size.1) };
                    if let Some(extent) = level.extent(self.count) {
                        encoder.copy_buffer_to_texture(source, level.texture.as_image_copy(), extent);
                    }
                }
            } else {
                each(images, |frame, image| {
                    self.write(context, small(frame), &Pyramid::new(image.clone(), self.levels.len()));
                    Ok(())
                })?;
            }
            // Also where nothing is encoded: otherwise uploads of frames nobody looks at would pile up.
            context.submit(encoder);
            Ok(())
        })?
    }

    fn write(&self, context: &Context, frame: u32, pyramid: &Pyramid) {
        for (k, level) in self.levels.iter().enumerate() {
            if let Some(extent) = level.extent(1) {
                let layout = rows(extent.width, extent.height);
                context.queue.write_texture(level.layer(frame), pyramid.level(k).as_raw(), layout, extent);
            }
        }
    }

    /// Reads a level of a frame back.
    pub(super) fn read(
        &self,
        context: &Context,
        readback: &mut Readback,
        (frame, level): (usize, usize),
    ) -> Result<GrayImage> {
        let FrameLevel { size: (width, height), .. } = &self.levels[level];
        let Some(extent) = self.levels[level].extent(1) else { return Ok(GrayImage::new(*width, *height)) };
        let stride = width.next_multiple_of(ROW_ALIGNMENT);
        let bytes = u64::from(stride) * u64::from(*height);
        let buffer = readback.buffer(context, bytes)?;
        let submission = context.scoped("reading a pyramid level", || {
            let mut encoder = context.device.create_command_encoder(&CommandEncoderDescriptor::default());
            let target = TexelCopyBufferInfo { buffer, layout: rows(stride, *height) };
            encoder.copy_texture_to_buffer(self.levels[level].layer(small(frame)), target, extent);
            context.submit(encoder)
        })?;
        readback.read(context, submission, bytes, |data| {
            GrayImage::from_fn(*width, *height, |x, y| image::Luma([data[(y * stride + x) as usize]]))
        })
    }
}

/// Does something with every image and its number, on all cores where there are several.
fn each(images: &[&GrayImage], task: impl Fn(usize, &GrayImage) -> Result<()> + Sync) -> Result<()> {
    match images {
        [image] => task(0, image),
        _ => images.par_iter().enumerate().try_for_each(|(k, image)| task(k, image)),
    }
}

impl GpuBackend {
    /// Images of a size that fit into one texture, and into one buffer where the device builds the pyramid.
    pub(super) fn most_frames(&self, size: (u32, u32)) -> usize {
        let layers = u64::from(self.context.adapter.max_layers);
        let in_a_buffer = self.context.max_bytes() / padded_bytes(size).max(1);
        let frames = if self.downsample.is_some() { layers.min(in_a_buffer) } else { layers };
        usize::try_from(frames.max(1)).unwrap_or(1)
    }

    /// Reads a pyramid level of a current frame back, for tests and pictures.
    ///
    /// # Errors
    /// [`Error::Invalid`] without such a frame or level, [`Error::DeviceLost`] or [`Error::Gpu`] if the device fails.
    pub fn read_level(&mut self, frame: usize, level: usize) -> Result<GrayImage> {
        let (count, levels) = self.counts();
        let Some(frames) = self.frames.as_ref().filter(|_| frame < count && level < levels) else {
            let problem = format!("there is no level {level} of frame {frame}");
            return Err(Error::invalid("pyramid level", problem, "call set_frame first"));
        };
        frames.read(&self.context, &mut self.readback, (frame, level))
    }

    /// Number of current frames and of their levels.
    pub(super) fn counts(&self) -> (usize, usize) {
        self.frames.as_ref().map_or((0, 0), Frames::counts)
    }

    /// Room for a number of frames of a size.
    pub(super) fn new_frames(&self, images: ((u32, u32), u32), levels: usize) -> Result<Frames> {
        let halver = |pipeline| Halver::new(&self.context, pipeline, self.partition, images, levels);
        let halver = self.downsample.as_ref().map(halver).transpose()?;
        Frames::new(&self.context, &self.layouts[2], images, levels, halver)
    }

    /// Makes images the current frames.
    pub(super) fn take_frames(&mut self, images: &[&GrayImage], levels: usize) -> Result<()> {
        self.context.check()?;
        let Some(size) = images.first().map(|image| image.dimensions()) else {
            self.frames = None;
            return Ok(());
        };
        if let Some(other) = images.iter().map(|i| i.dimensions()).find(|other| *other != size) {
            let problem = format!("one of {size:?} pixels and one of {other:?}");
            return Err(Error::invalid("frames", problem, "frames of one call have one size"));
        }
        let most = self.most_frames(size);
        if images.len() > most {
            let problem = format!("{} of {size:?} pixels, the device takes {most}", images.len());
            return Err(Error::invalid("frames", problem, "ask frames_at_once first"));
        }
        let needed = (size, small(images.len()));
        let frames = match self.frames.take().filter(|frames| frames.fits(needed, levels)) {
            Some(frames) => frames,
            None => self.new_frames(needed, levels)?,
        };
        self.frames.insert(frames).upload(&self.context, images)
    }
}

impl FrameLevel {
    fn new(
        context: &Context,
        layout: &BindGroupLayout,
        sampler: &wgpu::Sampler,
        (size, layers): ((u32, u32), u32),
    ) -> Self {
        // Textures have pixels; one that stands for an empty image is a single black one, where nothing is inside.
        let (width, height) = (size.0.max(1), size.1.max(1));
        let extent = Extent3d { width, height, depth_or_array_layers: layers };
        let texture = context.device.create_texture(&TextureDescriptor {
            label: Some("frames"),
            size: extent,
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: TextureFormat::R8Unorm,
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST | TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let dimension = Some(TextureViewDimension::D2Array);
        let view = texture.create_view(&TextureViewDescriptor { dimension, ..Default::default() });
        let resources = [BindingResource::TextureView(&view), BindingResource::Sampler(sampler)];
        let entries: Vec<_> =
            (0..).zip(resources).map(|(binding, resource)| BindGroupEntry { binding, resource }).collect();
        let bind_group = context.device.create_bind_group(&BindGroupDescriptor {
            label: Some("frames"),
            layout,
            entries: &entries,
        });
        Self { size, texture, bind_group }
    }

    /// What there is to copy of some frames; `None` for images without pixels.
    fn extent(&self, frames: u32) -> Option<Extent3d> {
        let (width, height) = self.size;
        (width > 0 && height > 0).then_some(Extent3d { width, height, depth_or_array_layers: frames })
    }

    /// Where the image of a frame is copied to or from.
    fn layer(&self, frame: u32) -> TexelCopyTextureInfo<'_> {
        let origin = Origin3d { z: frame, ..Origin3d::ZERO };
        TexelCopyTextureInfo { origin, ..self.texture.as_image_copy() }
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
