//! One call of `accumulate`: many poses of one model, as few dispatches as the device's limits allow.

use nalgebra::Vector2;
use wgpu::{
    BindGroup, BindGroupLayout, Buffer, BufferUsages, CommandEncoderDescriptor, ComputePassDescriptor,
    ComputePipeline,
};

use super::buffers::{DeviceLevel, Warp, small};
use super::context::Context;
use super::readback::Readback;
use super::shaders::{ACCUMULATE, sum_planes};
use crate::backend::{Request, Sums};
use crate::error::Result;

/// Workgroups per dimension that every device has.
const MAX_GROUPS: u32 = 65535;

/// Numbers of a row before the modes, on the host and, padded, on the device.
const HEAD: usize = Sums::row_len(0);
const DEVICE_HEAD: usize = 12;

/// A level that can be dispatched.
#[derive(Debug)]
pub(super) struct LoadedLevel {
    pub(super) level: DeviceLevel,
    /// Group 0.
    pub(super) bind_group: BindGroup,
    pub(super) pipeline: ComputePipeline,
    /// Poses per dispatch.
    pub(super) max_items: usize,
}

/// Everything a request runs on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Target<'a> {
    pub(super) context: &'a Context,
    /// Layout of group 1.
    pub(super) layout: &'a BindGroupLayout,
    pub(super) level: &'a LoadedLevel,
    /// Group 2.
    pub(super) image: &'a BindGroup,
}

/// What one dispatch of `items` poses reads and writes, bytes.
struct Sizes {
    warps: u64,
    appearance: u64,
    sums: u64,
}

impl Sizes {
    fn new(level: &DeviceLevel, items: usize) -> Self {
        let planes = small(level.modes.div_ceil(4));
        let bytes = |vectors: usize| 16 * (vectors as u64) * (items as u64);
        Self {
            warps: bytes(3 * level.centres.len()),
            appearance: bytes(planes as usize),
            sums: bytes(level.chunks.len() * sum_planes(planes) as usize),
        }
    }
}

/// Poses per dispatch so that no buffer is larger than `limit` bytes.
///
/// # Errors
/// [`crate::Error::AdapterTooSmall`] if not even one fits the device.
pub(super) fn max_items(context: &Context, level: &DeviceLevel, limit: u64) -> Result<usize> {
    let one = Sizes::new(level, 1);
    context.require("warps of one pose (bytes)", one.warps)?;
    context.require("sums of one pose (bytes)", one.sums)?;
    let items = limit / one.warps.max(one.sums).max(one.appearance).max(1);
    Ok(usize::try_from(items.clamp(1, u64::from(MAX_GROUPS))).unwrap_or(1))
}

/// Buffers of the poses, kept between calls.
#[derive(Debug, Default)]
pub(super) struct Batch {
    buffers: Option<Bound>,
    warps: Vec<Warp>,
    appearance: Vec<f32>,
}

#[derive(Debug)]
struct Bound {
    /// `warps`, `appearance`, `sums`: the bindings of group 1.
    buffers: [Buffer; 3],
    bind_group: BindGroup,
}

impl Batch {
    /// Runs a request whose sizes have been checked.
    pub(super) fn run(
        &mut self,
        target: Target<'_>,
        readback: &mut Readback,
        request: &Request<'_>,
        sums: &mut Sums,
    ) -> Result<()> {
        let Target { context, level: loaded, .. } = target;
        let (triangles, modes) = (loaded.level.centres.len(), loaded.level.modes);
        sums.reset(request.items, triangles, modes);
        if loaded.level.chunks.is_empty() {
            return context.check();
        }
        let row_len = Sums::row_len(modes);
        for first in (0..request.items).step_by(loaded.max_items) {
            let items = loaded.max_items.min(request.items - first);
            let part = Request {
                items,
                warps: &request.warps[first * triangles..][..items * triangles],
                appearance: &request.appearance[first * modes..][..items * modes],
                ..*request
            };
            let rows = &mut sums.data_mut()[first * triangles * row_len..][..items * triangles * row_len];
            self.dispatch(target, readback, &part, rows)?;
        }
        Ok(())
    }

    /// One submit and one map.
    fn dispatch(
        &mut self,
        target: Target<'_>,
        readback: &mut Readback,
        part: &Request<'_>,
        rows: &mut [f64],
    ) -> Result<()> {
        let Target { context, layout, level: loaded, image } = target;
        let sizes = Sizes::new(&loaded.level, part.items);
        self.encode_poses(&loaded.level, part);
        self.grow(context, layout, &sizes)?;
        let Some(bound) = &self.buffers else { return Ok(()) };
        let staging = readback.buffer(context, sizes.sums)?;
        let submission = context.scoped(ACCUMULATE.name, || {
            context.queue.write_buffer(&bound.buffers[0], 0, bytemuck::cast_slice(&self.warps));
            context.queue.write_buffer(&bound.buffers[1], 0, bytemuck::cast_slice(&self.appearance));
            let mut encoder = context.device.create_command_encoder(&CommandEncoderDescriptor::default());
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
            pass.set_pipeline(&loaded.pipeline);
            for (group, bind_group) in (0..).zip([&loaded.bind_group, &bound.bind_group, image]) {
                pass.set_bind_group(group, bind_group, &[]);
            }
            let chunks = small(loaded.level.chunks.len());
            pass.dispatch_workgroups(chunks.min(MAX_GROUPS), small(part.items), chunks.div_ceil(MAX_GROUPS));
            drop(pass);
            encoder.copy_buffer_to_buffer(&bound.buffers[2], 0, staging, 0, sizes.sums);
            context.queue.submit([encoder.finish()])
        });
        readback.read(context, submission?, sizes.sums, |data| {
            add_chunks(&loaded.level, bytemuck::cast_slice(data), rows);
        })
    }

    /// Fills the host copies of the poses.
    fn encode_poses(&mut self, level: &DeviceLevel, part: &Request<'_>) {
        let (triangles, modes) = (level.centres.len(), level.modes);
        self.warps.clear();
        for warps in part.warps.chunks_exact(triangles.max(1)) {
            self.warps
                .extend(warps.iter().zip(&level.centres).map(|(warp, centre)| Warp::new(warp, *centre)));
        }
        self.appearance.clear();
        for lambda in part.appearance.chunks_exact(modes.max(1)) {
            self.appearance.extend(lambda);
            self.appearance.resize(self.appearance.len().next_multiple_of(4), 0.0);
        }
    }

    /// Makes the buffers large enough, with room to spare.
    fn grow(&mut self, context: &Context, layout: &BindGroupLayout, sizes: &Sizes) -> Result<()> {
        let needed = [sizes.warps, sizes.appearance, sizes.sums];
        let fits = |b: &Bound| b.buffers.iter().zip(needed).all(|(buffer, bytes)| buffer.size() >= bytes);
        if self.buffers.as_ref().is_some_and(fits) {
            return Ok(());
        }
        let limit = context.max_bytes();
        let old = self.buffers.take().map_or([0; 3], |bound| bound.buffers.map(|buffer| buffer.size()));
        let bound = context.scoped("creating the pose buffers", || {
            let create = |k: usize, label: &str| {
                let bytes = needed[k].next_power_of_two().min(limit).max(old[k]);
                context.buffer(label, bytes, BufferUsages::STORAGE | BufferUsages::COPY_SRC)
            };
            let buffers = [create(0, "warps"), create(1, "appearance"), create(2, "sums")];
            let bind_group = context.bind(ACCUMULATE.name, layout, &buffers);
            Bound { buffers, bind_group }
        })?;
        self.buffers = Some(bound);
        Ok(())
    }
}

/// Adds the rows of chunks to the rows of their triangles, in f64.
fn add_chunks(level: &DeviceLevel, chunk_rows: &[f32], rows: &mut [f64]) {
    let (row_len, triangles) = (Sums::row_len(level.modes), level.centres.len());
    let device_len = DEVICE_HEAD + level.modes.next_multiple_of(4);
    let of_items = chunk_rows.chunks_exact(device_len * level.chunks.len());
    for (item, rows) in of_items.zip(rows.chunks_exact_mut(row_len * triangles)) {
        for (chunk, partial) in level.chunks.iter().zip(item.chunks_exact(device_len)) {
            let row = &mut rows[chunk.triangle as usize * row_len..][..row_len];
            let parts = partial[..HEAD].iter().chain(&partial[DEVICE_HEAD..]);
            for (sum, part) in row.iter_mut().zip(parts) {
                *sum += f64::from(*part);
            }
        }
        for (row, centre) in rows.chunks_exact_mut(row_len).zip(&level.centres) {
            move_to_origin(row, centre);
        }
    }
}

/// Makes positions in the gradient sums relative to the chart's origin instead of its centre.
fn move_to_origin(row: &mut [f64], centre: &Vector2<f64>) {
    for slope in row[..6].chunks_exact_mut(3) {
        slope[0] += centre.x * slope[2];
        slope[1] += centre.y * slope[2];
    }
}
