//! The pyramid built by the device: the `downsample` stage from packed rows to packed rows.

use image::GrayImage;
use wgpu::{BindGroup, Buffer, BufferSize, BufferUsages, CommandEncoder, ComputePipeline};

use super::buffers::Halving;
use super::context::Context;
use super::frame::{ROW_ALIGNMENT, level_size};
use super::shaders::{DOWNSAMPLE, Partition};
use crate::error::Result;

/// Packed images of all levels and frames and the steps between the levels.
#[derive(Debug)]
pub(super) struct Halver {
    pipeline: ComputePipeline,
    workgroup: u32,
    images: Vec<Packed>,
    steps: Vec<(Halving, BindGroup)>,
}

/// Images of some frames one after the other in a buffer, one byte per pixel, rows padded for copies to textures.
#[derive(Debug)]
struct Packed {
    buffer: Buffer,
    stride: u32,
}

/// Bytes that a full-size image takes in its buffer.
pub(super) fn padded_bytes((width, height): (u32, u32)) -> u64 {
    u64::from(width.next_multiple_of(ROW_ALIGNMENT)) * u64::from(height)
}

impl Halver {
    /// Buffers for so many images of this size.
    pub(super) fn new(
        context: &Context,
        pipeline: &ComputePipeline,
        partition: Partition,
        (size, frames): ((u32, u32), u32),
        levels: usize,
    ) -> Result<Self> {
        context.require("frames (bytes)", padded_bytes(size) * u64::from(frames))?;
        let layout = pipeline.get_bind_group_layout(0);
        let (images, steps) = context.scoped("creating the pyramid", || {
            let packed = |k: usize| Packed::new(context, level_size(size, k), frames);
            let images: Vec<_> = (0..levels.max(1)).map(packed).collect();
            let step = |(k, pair): (usize, &[Packed])| {
                let (words, rows) = level_size(size, k + 1);
                let constants = Halving {
                    stride_in: pair[0].stride / 4,
                    stride_out: pair[1].stride / 4,
                    words: words.div_ceil(4),
                    rows,
                    rows_in: level_size(size, k).1,
                };
                let uniform = context.buffer("halving", size_of::<Halving>() as u64, BufferUsages::UNIFORM);
                context.queue.write_buffer(&uniform, 0, bytemuck::bytes_of(&constants));
                let buffers = [&uniform, &pair[0].buffer, &pair[1].buffer].map(Buffer::as_entire_binding);
                (constants, context.bind(DOWNSAMPLE.name, &layout, buffers))
            };
            let steps = images.windows(2).enumerate().map(step).collect();
            (images, steps)
        })?;
        let workgroup = partition.workgroup;
        Ok(Self { pipeline: pipeline.clone(), workgroup, images, steps })
    }

    /// Puts the full-size image of a frame into its place in the buffer.
    ///
    /// # Errors
    /// [`crate::Error::Gpu`] if the device has no memory for it on its way.
    pub(super) fn upload(&self, context: &Context, frame: usize, image: &GrayImage) -> Result<()> {
        let (bytes, Packed { buffer, stride }) = (padded_bytes(image.dimensions()), &self.images[0]);
        let Some(size) = BufferSize::new(bytes) else { return Ok(()) };
        let view = context.queue.write_buffer_with(buffer, frame as u64 * bytes, size);
        let mut view = view.ok_or_else(|| context.fault("uploading a frame", "no memory to write to"))?;
        let (width, stride) = (image.width() as usize, *stride as usize);
        for (k, row) in image.as_raw().chunks_exact(width).enumerate() {
            view.slice(k * stride..k * stride + width).copy_from_slice(row);
        }
        Ok(())
    }

    /// Computes all smaller levels of the first `frames` frames.
    pub(super) fn encode(&self, encoder: &mut CommandEncoder, frames: u32) {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&self.pipeline);
        for (halving, bind_group) in &self.steps {
            pass.set_bind_group(0, bind_group, &[]);
            if halving.words * halving.rows > 0 {
                pass.dispatch_workgroups(halving.words.div_ceil(self.workgroup), halving.rows, frames);
            }
        }
    }

    /// Buffer and bytes per row of every level.
    pub(super) fn packed(&self) -> impl Iterator<Item = (&Buffer, u32)> {
        self.images.iter().map(|image| (&image.buffer, image.stride))
    }
}

impl Packed {
    fn new(context: &Context, (width, height): (u32, u32), frames: u32) -> Self {
        let stride = width.next_multiple_of(ROW_ALIGNMENT);
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let bytes = padded_bytes((width, height)) * u64::from(frames);
        let buffer = context.buffer("packed images", bytes, usage);
        Self { buffer, stride }
    }
}
