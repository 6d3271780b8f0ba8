//! What is stored on the device: the structs of `shaders/common.wgsl` and the pixels of a template.

use bytemuck::{Pod, Zeroable};
use nalgebra::Vector2;
use wgpu::{BindingResource, Buffer, BufferUsages};

use super::context::Context;
use super::shaders::{AdapterClass, Partition};
use super::table::Table;
use crate::backend::TriangleWarp;
use crate::backend::local::{self, LocalWarp};
use crate::error::Result;
use crate::model::{LevelTemplate, Pixels, steps};

/// One level of a template; `Level` in `shaders/common.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Level {
    /// Number of chart pixels.
    pub pixels: u32,
    /// Number of chunks.
    pub chunks: u32,
    /// Number of triangles.
    pub triangles: u32,
    /// Padding.
    pub unused: u32,
}

/// A run of pixels of one triangle; `Chunk` in `shaders/common.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Chunk {
    /// First pixel.
    pub start: u32,
    /// One past the last pixel.
    pub end: u32,
    /// The triangle all of them belong to.
    pub triangle: u32,
    /// Padding.
    pub unused: u32,
}

/// The warp of one triangle; `Warp` in `shaders/common.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Warp {
    /// First row of the homography, base u.
    pub row_u: [f32; 4],
    /// Second row of the homography, base v.
    pub row_v: [f32; 4],
    /// Third row of the homography, 1 plus the number of the frame if active.
    pub row_w: [f32; 4],
    /// Factors of the second differences along u, gain of what is saturated.
    pub blur_u: [f32; 4],
    /// The same along v, its bias.
    pub blur_v: [f32; 4],
}

impl Warp {
    /// The warp from positions relative to the chart's `centre`, minus an integer base pixel near the warped centre, into
    /// a frame.
    pub fn new(warp: &TriangleWarp, centre: Vector2<f64>, frame: u16) -> Self {
        if !warp.active {
            return Self::zeroed();
        }
        let LocalWarp { rows, base, blur, light } = LocalWarp::new(warp, centre);
        let with = |[a, b, c]: [f32; 3], last: f32| [a, b, c, last];
        Self {
            row_u: with(rows[0], base[0]),
            row_v: with(rows[1], base[1]),
            row_w: with(rows[2], 1.0 + f32::from(frame)),
            blur_u: with(blur[0], light[0]),
            blur_v: with(blur[1], light[1]),
        }
    }
}

/// An image that is scanned; `Scan` in `shaders/common.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Scan {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Tiles along u.
    pub columns: u32,
    /// Side of a tile, pixels.
    pub tile: u32,
}

/// One step of the pyramid; `Halving` in `shaders/common.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct Halving {
    /// Words per row of the larger image.
    pub stride_in: u32,
    /// Words per row of the smaller image.
    pub stride_out: u32,
    /// Words of a row of the smaller image that hold pixels.
    pub words: u32,
    /// Rows of the smaller image.
    pub rows: u32,
    /// Rows of the larger image.
    pub rows_in: u32,
}

/// One level of a template on the device.
#[derive(Debug)]
pub(super) struct DeviceLevel {
    /// The chunk table, also needed to add up what comes back.
    pub(super) chunks: Vec<Chunk>,
    /// A pixel in the middle of every chart; positions on the device are relative to it.
    pub(super) centres: Vec<Vector2<f64>>,
    /// Number of modes l.
    pub(super) modes: usize,
    /// How it is cut.
    pub(super) partition: Partition,
    /// `level`, then `chunks`, `pixels`, `modes`: the bindings of group 0 of `accumulate`.
    constants: Buffer,
    tables: [Table; 3],
}

impl DeviceLevel {
    /// Uploads a level.
    pub(super) fn upload(context: &Context, template: &LevelTemplate, partition: Partition) -> Result<Self> {
        let pixels = &template.pixels;
        let centres: Vec<Vector2<f64>> = template.charts.iter().map(|c| local::centre(template, c)).collect();
        let chunks = chunks(template, partition.chunk_pixels);
        let level = Level {
            pixels: small(pixels.len()),
            chunks: small(chunks.len()),
            triangles: small(template.charts.len()),
            unused: 0,
        };
        let packed = packed_pixels(template, &centres);
        let modes = match partition.class {
            AdapterClass::Gpu => packed_modes::<2>(pixels),
            AdapterClass::Software => packed_modes::<4>(pixels),
        };
        let (constants, tables) = context.scoped("uploading the template", || -> Result<_> {
            let constants = context.buffer("level", size_of::<Level>() as u64, BufferUsages::UNIFORM);
            context.queue.write_buffer(&constants, 0, bytemuck::bytes_of(&level));
            let table = |label, bytes: &[u8]| {
                let table = Table::new(context, partition.class, label, bytes.len() as u64)?;
                table.write(context, bytes);
                Ok(table)
            };
            let tables = [
                table("template table chunks", bytemuck::cast_slice(&chunks))?,
                table("template table pixels", bytemuck::cast_slice(&packed))?,
                table("template table modes", bytemuck::cast_slice(&modes))?,
            ];
            Ok((constants, tables))
        })??;
        Ok(Self { chunks, centres, modes: pixels.modes.len(), partition, constants, tables })
    }

    /// The bindings of group 0 of `accumulate`, in their order.
    pub(super) fn resources(&self) -> impl Iterator<Item = BindingResource<'_>> {
        std::iter::once(self.constants.as_entire_binding()).chain(self.tables.iter().map(Table::resource))
    }
}

/// Cuts every chart into chunks of at most `limit` pixels.
pub fn chunks(template: &LevelTemplate, limit: u32) -> Vec<Chunk> {
    let of_chart = |(t, chart): (u32, &crate::model::Chart)| {
        let end = chart.end;
        let starts = (chart.start..end).step_by(limit as usize);
        starts.map(move |start| Chunk {
            start,
            end: start.saturating_add(limit).min(end),
            triangle: t,
            unused: 0,
        })
    };
    (0..).zip(&template.charts).flat_map(of_chart).collect()
}

/// A size that fits u32 because the buffer it belongs to is checked against the device's limits.
pub(super) fn small(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

/// Two 16-bit numbers to a word: the position relative to the chart's centre, the gradient, intensity and weight; then the
/// second differences.
fn packed_pixels(template: &LevelTemplate, centres: &[Vector2<f64>]) -> Vec<[u32; 4]> {
    let Pixels { position, gradient, intensity, weight, .. } = &template.pixels;
    let mut packed = vec![[0; 4]; position.len()];
    for (chart, centre) in template.charts.iter().zip(centres) {
        for p in chart.range() {
            let [gu, gv] = gradient[p].map(signed);
            let values = pair(unsigned(intensity[p], steps::INTENSITY), unsigned(weight[p], steps::WEIGHT));
            let curvature = local::pack_curvature(template.curvature[p]);
            packed[p] = [local::pack(position[p], *centre), pair(gu, gv), values, curvature];
        }
    }
    packed
}

/// Two modes to a word, `WORDS` words to a pixel, plane after plane of pixels; missing modes are zero.
fn packed_modes<const WORDS: usize>(pixels: &Pixels) -> Vec<u32> {
    let record = |modes: &'_ [Vec<f32>], p: usize| {
        let mode = |k: usize| modes.get(k).map_or(0, |mode| signed(mode[p]));
        std::array::from_fn::<_, WORDS, _>(|word| pair(mode(2 * word), mode(2 * word + 1)))
    };
    let planes = pixels.modes.chunks(2 * WORDS);
    planes.flat_map(|modes| (0..pixels.len()).flat_map(move |p| record(modes, p))).collect()
}

/// The first in the low, the second in the high half.
fn pair(low: u16, high: u16) -> u32 {
    u32::from(low) | u32::from(high) << 16
}

/// Values are whole numbers of steps that fit 16 bits, as [`LevelTemplate::new`] rounds them.
#[expect(clippy::cast_possible_truncation, reason = "a whole number of 16 bits")]
fn signed(value: f32) -> u16 {
    ((value / steps::SIGNED) as i16).cast_unsigned()
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a whole number of 16 bits")]
fn unsigned(value: f32, step: f32) -> u16 {
    (value / step) as u16
}
