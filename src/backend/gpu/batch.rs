//! One call of a stage that adds up charts: many poses of one model, as few dispatches as the device's limits allow.

use std::ops::Range;

use bytemuck::Zeroable;
use rayon::prelude::*;
use wgpu::{
    BindGroup, BindGroupLayout, Buffer, BufferUsages, CommandEncoderDescriptor, ComputePassDescriptor,
    ComputePipeline,
};

use super::buffers::{DeviceLevel, Warp, small};
use super::context::Context;
use super::readback::Readback;
use super::rows::{MANY, PER_THREAD};
use super::shaders::{AdapterClass, Stage};
use super::table::{Table, most_bytes};
use crate::backend::{Request, TriangleWarp};
use crate::error::Result;

/// Workgroups per dimension that every device has.
const MAX_GROUPS: u32 = 65535;

/// A stage, compiled for a number of mode planes.
#[derive(Debug, Clone)]
pub(super) struct Pass {
    pub(super) stage: &'static Stage,
    pub(super) pipeline: ComputePipeline,
    /// Planes of four sums per chunk.
    pub(super) planes: u32,
}

/// A level that can be dispatched.
#[derive(Debug)]
pub(super) struct LoadedLevel {
    pub(super) level: DeviceLevel,
    /// Group 0.
    pub(super) bind_group: BindGroup,
}

/// Everything a request runs on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Target<'a> {
    pub(super) context: &'a Context,
    /// Layout of group 1.
    pub(super) layout: &'a BindGroupLayout,
    pub(super) level: &'a LoadedLevel,
    pub(super) pass: &'a Pass,
    /// Group 2.
    pub(super) image: &'a BindGroup,
    /// Largest buffer or table of a dispatch, bytes.
    pub(super) limit: u64,
}

/// What one dispatch of `items` poses reads and writes, bytes.
struct Sizes {
    warps: u64,
    appearance: u64,
    sums: u64,
}

impl Sizes {
    fn new(level: &DeviceLevel, planes: u32, items: usize) -> Self {
        let bytes = |vectors: usize| 16 * (vectors as u64) * (items as u64);
        Self {
            warps: (size_of::<Warp>() * level.centres.len() * items) as u64,
            appearance: bytes(level.modes.div_ceil(4)),
            sums: bytes(level.chunks.len() * level.partition.rows_per_chunk() * planes as usize),
        }
    }
}

/// Poses per dispatch so that no buffer is larger than `limit` bytes.
///
/// # Errors
/// [`crate::Error::AdapterTooSmall`] if not even one fits the device.
pub(super) fn max_items(context: &Context, level: &DeviceLevel, planes: u32, limit: u64) -> Result<usize> {
    let one = Sizes::new(level, planes, 1);
    let most = most_bytes(context, level.partition.class);
    context.require_below("warps of one pose (bytes)", one.warps, most)?;
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
    /// With `sums` the bindings of group 1.
    warps: Table,
    appearance: Table,
    sums: Buffer,
    bind_group: BindGroup,
}

impl Batch {
    /// Runs a request whose sizes have been checked. For every dispatch `write` gets the range of its poses and the
    /// planes of all their chunks.
    pub(super) fn run(
        &mut self,
        target: Target<'_>,
        readback: &mut Readback,
        request: &Request<'_>,
        mut write: impl FnMut(Range<usize>, &[f32]),
    ) -> Result<()> {
        let Target { context, level: loaded, pass, limit, .. } = target;
        let (triangles, modes) = (loaded.level.centres.len(), loaded.level.modes);
        if loaded.level.chunks.is_empty() {
            return context.check();
        }
        let at_once = max_items(context, &loaded.level, pass.planes, limit)?;
        for first in (0..request.items).step_by(at_once) {
            let items = at_once.min(request.items - first);
            let part = Request {
                items,
                frames: request.frames.get(first..first + items).unwrap_or_default(),
                warps: &request.warps[first * triangles..][..items * triangles],
                appearance: &request.appearance[first * modes..][..items * modes],
                ..*request
            };
            self.dispatch(target, readback, &part, |data| write(first..first + items, data))?;
        }
        Ok(())
    }

    /// One submit and one map.
    fn dispatch(
        &mut self,
        target: Target<'_>,
        readback: &mut Readback,
        part: &Request<'_>,
        write: impl FnOnce(&[f32]),
    ) -> Result<()> {
        let Target { context, layout, level: loaded, pass: Pass { stage, pipeline, planes }, image, .. } =
            target;
        let sizes = Sizes::new(&loaded.level, *planes, part.items);
        self.encode_poses(&loaded.level, part);
        self.grow(context, layout, (&sizes, loaded.level.partition.class))?;
        let Some(bound) = &self.buffers else { return Ok(()) };
        let staging = readback.buffer(context, sizes.sums)?;
        let submission = context.scoped(stage.name, || {
            bound.warps.write(context, bytemuck::cast_slice(&self.warps));
            bound.appearance.write(context, bytemuck::cast_slice(&self.appearance));
            let mut encoder = context.device.create_command_encoder(&CommandEncoderDescriptor::default());
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
            pass.set_pipeline(pipeline);
            for (group, bind_group) in (0..).zip([&loaded.bind_group, &bound.bind_group, image]) {
                pass.set_bind_group(group, bind_group, &[]);
            }
            let chunks = small(loaded.level.chunks.len());
            pass.dispatch_workgroups(chunks.min(MAX_GROUPS), small(part.items), chunks.div_ceil(MAX_GROUPS));
            drop(pass);
            encoder.copy_buffer_to_buffer(&bound.sums, 0, staging, 0, sizes.sums);
            context.submit(encoder)
        });
        readback.read(context, submission?, sizes.sums, |data| write(bytemuck::cast_slice(data)))
    }

    /// Fills the host copies of the poses.
    fn encode_poses(&mut self, level: &DeviceLevel, part: &Request<'_>) {
        let (triangles, modes) = (level.centres.len().max(1), level.modes);
        self.warps.resize(part.warps.len(), Warp::zeroed());
        let encode = |(item, (out, warps)): (usize, (&mut [Warp], &[TriangleWarp]))| {
            // Frames are layers of a texture, of which no device has more.
            let frame = u16::try_from(part.frame_of(item)).unwrap_or(u16::MAX);
            for ((out, warp), centre) in out.iter_mut().zip(warps).zip(&level.centres) {
                *out = Warp::new(warp, *centre, frame);
            }
        };
        if part.items < MANY {
            let warps = part.warps.chunks_exact(triangles);
            self.warps.chunks_exact_mut(triangles).zip(warps).enumerate().for_each(encode);
        } else {
            let warps = part.warps.par_chunks_exact(triangles);
            let both = self.warps.par_chunks_exact_mut(triangles).zip(warps).enumerate();
            both.with_min_len(PER_THREAD).for_each(encode);
        }
        self.appearance.clear();
        for lambda in part.appearance.chunks_exact(modes.max(1)) {
            self.appearance.extend(lambda);
            self.appearance.resize(self.appearance.len().next_multiple_of(4), 0.0);
        }
    }

    /// Makes the buffers large enough, with room to spare.
    fn grow(
        &mut self,
        context: &Context,
        layout: &BindGroupLayout,
        (sizes, class): (&Sizes, AdapterClass),
    ) -> Result<()> {
        let needed = [sizes.warps, sizes.appearance, sizes.sums];
        let room = |b: &Bound| [b.warps.room(), b.appearance.room(), b.sums.size()];
        let fits = |b: &Bound| room(b).iter().zip(needed).all(|(room, bytes)| *room >= bytes);
        if self.buffers.as_ref().is_some_and(fits) {
            return Ok(());
        }
        let old = self.buffers.take().map_or([0; 3], |bound| room(&bound));
        let bytes = |k: usize, limit: u64| needed[k].next_power_of_two().max(old[k]).min(limit);
        let bound = context.scoped("creating the pose buffers", || -> Result<_> {
            let table = |k: usize, label: &str| {
                Table::new(context, class, label, bytes(k, most_bytes(context, class)))
            };
            let (warps, appearance) = (table(0, "warps")?, table(1, "appearance")?);
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
            let sums = context.buffer("sums", bytes(2, context.max_bytes()), usage);
            let resources = [warps.resource(), appearance.resource(), sums.as_entire_binding()];
            let bind_group = context.bind("poses", layout, resources);
            Ok(Bound { warps, appearance, sums, bind_group })
        })??;
        self.buffers = Some(bound);
        Ok(())
    }
}
