//! The chart pixels of a level as the kernels want them: groups of as many as the widest vector holds; positions, second
//! differences, texels and modes of all groups each in one run of memory, which the processor can foresee.

use std::ops::Range;

use nalgebra::Vector2;

use super::BLOCK;
use crate::backend::local::{centre, pack, pack_curvature};
use crate::model::LevelTemplate;

/// Pixels per vector at most: charts are padded to whole vectors of every width.
pub(super) const WIDEST: usize = 16;
/// Groups per block at most.
pub(super) const GROUPS: usize = BLOCK / WIDEST;
/// Lines of a group beside the modes: g_u, g_v, T0, q.
const TEXELS: usize = 4;

/// One value each of a group of pixels; as long as a line of the cache and never across two of them.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(super) struct Line<T>(pub(super) [T; WIDEST]);

impl<T: Copy + Default> Default for Line<T> {
    fn default() -> Self {
        Self([T::default(); WIDEST])
    }
}

impl<T: Copy + Default> Line<T> {
    /// Values with padding behind them.
    fn padded(values: impl Iterator<Item = T>) -> Self {
        let mut line = Self::default();
        line.0.iter_mut().zip(values).for_each(|(place, value)| *place = value);
        line
    }
}

/// One level of a template.
#[derive(Debug, Clone)]
pub(crate) struct FastLevel {
    pub(crate) triangles: Vec<Triangle>,
    /// Number of modes l.
    pub(crate) mode_count: usize,
    positions: Vec<Line<i32>>,
    curvatures: Vec<Line<i32>>,
    /// g_u, g_v, T0, q of every group.
    texels: Vec<[Line<f32>; TEXELS]>,
    /// T1..Tl of every group.
    modes: Vec<Line<f32>>,
}

/// One triangle of a level.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Triangle {
    /// A pixel in the middle of the chart; positions are relative to it.
    pub(crate) centre: Vector2<f64>,
    /// Largest |u| and |v| of its pixels, relative to the centre.
    pub(super) reach: [f32; 2],
    /// sum q over all of its pixels.
    pub(super) weight: f64,
    /// Its first group.
    start: usize,
    pixels: usize,
}

impl Triangle {
    /// Number of its pixels.
    #[expect(clippy::cast_precision_loss, reason = "pixel counts are far below 2^52")]
    pub(super) fn count(&self) -> f64 {
        self.pixels as f64
    }

    /// Number of its blocks.
    #[inline(always)]
    pub(super) fn blocks(&self) -> usize {
        self.pixels.div_ceil(BLOCK)
    }
}

/// At most [`BLOCK`] pixels of one triangle, padded to whole groups.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block<'a> {
    /// Number of pixels; the rest is padding.
    pub(super) pixels: usize,
    /// Signed u in the low, v in the high half, relative to the chart's centre.
    pub(super) positions: &'a [Line<i32>],
    /// Second differences of T0, see [`pack_curvature`].
    pub(super) curvatures: &'a [Line<i32>],
    /// g_u, g_v, T0, q.
    pub(super) texels: &'a [[Line<f32>; TEXELS]],
    modes: &'a [Line<f32>],
    mode_count: usize,
}

impl<'a> Block<'a> {
    /// The numbers of its groups. There are never more than the minimum says: it spares the test of every index.
    #[inline(always)]
    pub(super) fn groups(&self) -> Range<usize> {
        0..self.texels.len().min(GROUPS)
    }

    /// Some modes of a group, from the `first` one (counted from 0) on.
    #[inline(always)]
    pub(super) fn modes<const N: usize>(&self, group: usize, first: usize) -> &'a [Line<f32>] {
        let first = group * self.mode_count + first;
        &self.modes[first..first + N]
    }
}

impl FastLevel {
    /// Lays out a level.
    pub(crate) fn new(template: &LevelTemplate) -> Self {
        let modes = template.pixels.modes.len();
        let mut level = Self {
            triangles: Vec::with_capacity(template.charts.len()),
            mode_count: modes,
            positions: Vec::new(),
            curvatures: Vec::new(),
            texels: Vec::new(),
            modes: Vec::new(),
        };
        for chart in &template.charts {
            let (start, centre) = (level.positions.len(), centre(template, chart));
            let range = chart.range();
            level.triangles.push(Triangle {
                centre,
                reach: reach(&template.pixels.position[range.clone()], centre),
                weight: template.pixels.weight[range.clone()].iter().copied().map(f64::from).sum(),
                start,
                pixels: range.len(),
            });
            for first in range.clone().step_by(WIDEST) {
                level.push_group(template, first..(first + WIDEST).min(range.end), centre);
            }
        }
        level
    }

    fn push_group(&mut self, template: &LevelTemplate, range: Range<usize>, centre: Vector2<f64>) {
        let pixels = &template.pixels;
        let packed = pixels.position[range.clone()].iter().map(|p| pack(*p, centre).cast_signed());
        self.positions.push(Line::padded(packed));
        let packed = template.curvature[range.clone()].iter().map(|c| pack_curvature(*c).cast_signed());
        self.curvatures.push(Line::padded(packed));
        let gradient = &pixels.gradient[range.clone()];
        let [of_u, of_v] = [0, 1].map(|k| Line::padded(gradient.iter().map(|g| g[k])));
        let line = |column: &Vec<f32>| Line::padded(column[range.clone()].iter().copied());
        self.texels.push([of_u, of_v, line(&pixels.intensity), line(&pixels.weight)]);
        self.modes.extend(pixels.modes.iter().map(line));
    }

    /// A block of a triangle.
    #[inline(always)]
    pub(super) fn block(&self, triangle: &Triangle, number: usize) -> Block<'_> {
        let (first, modes) = (number * BLOCK, self.mode_count);
        let pixels = (triangle.pixels - first).min(BLOCK);
        let start = triangle.start + first / WIDEST;
        let groups = start..start + pixels.div_ceil(WIDEST);
        Block {
            pixels,
            positions: &self.positions[groups.clone()],
            curvatures: &self.curvatures[groups.clone()],
            texels: &self.texels[groups.clone()],
            modes: &self.modes[groups.start * modes..groups.end * modes],
            mode_count: modes,
        }
    }

    /// Number of pixels, padding included.
    pub(crate) fn padded_pixels(&self) -> usize {
        self.positions.len() * WIDEST
    }

    /// Bytes that one pass over the level reads.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.positions.as_slice())
            + size_of_val(self.curvatures.as_slice())
            + size_of_val(self.texels.as_slice())
            + size_of_val(self.modes.as_slice())
    }
}

/// Largest distance of positions from the centre, along u and v.
fn reach(positions: &[[u16; 2]], centre: Vector2<f64>) -> [f32; 2] {
    [0, 1].map(|k| {
        let far = positions.iter().map(|p| (f64::from(p[k]) - centre[k]).abs()).fold(0.0, f64::max);
        #[expect(clippy::cast_possible_truncation, reason = "whole numbers below 2^16")]
        let far = far as f32;
        far
    })
}
