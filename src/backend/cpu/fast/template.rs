//! The chart pixels of a level as the kernel wants them: blocks of whole vectors, one column after the other.

use nalgebra::Vector2;

use super::BLOCK;
use crate::backend::local::{self, centre, pack};
use crate::model::LevelTemplate;

/// Pixels per vector at most: blocks are padded to whole vectors of every width.
const WIDEST: usize = 16;
/// Columns of a block before the modes: g_u, g_v, T0, q.
const COLUMNS: usize = 4;

/// One level of a template.
#[derive(Debug, Clone)]
pub(crate) struct FastLevel {
    pub(crate) triangles: Vec<Triangle>,
    /// Number of modes l.
    pub(crate) modes: usize,
    positions: Vec<i32>,
    curvatures: Vec<i32>,
    columns: Vec<f32>,
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
    /// First of its pixels in the padded columns.
    start: usize,
    pixels: usize,
}

impl Triangle {
    /// Number of its pixels.
    #[expect(clippy::cast_precision_loss, reason = "pixel counts are far below 2^52")]
    pub(super) fn count(&self) -> f64 {
        self.pixels as f64
    }
}

/// At most [`BLOCK`] pixels of one triangle, padded to whole vectors.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block<'a> {
    /// Number of pixels; the rest of every column is padding.
    pub(super) pixels: usize,
    /// Signed u in the low, v in the high half, relative to the chart's centre.
    pub(super) positions: &'a [i32],
    /// Second differences of T0, see [`local::pack_curvature`].
    pub(super) curvatures: &'a [i32],
    /// g_u, g_v, T0, q, each as long as the positions.
    pub(super) texels: [&'a [f32]; COLUMNS],
    /// T1..Tl, one after the other, each as long as the positions.
    pub(super) modes: &'a [f32],
}

impl FastLevel {
    /// Lays out a level.
    pub(crate) fn new(template: &LevelTemplate) -> Self {
        let modes = template.pixels.modes.len();
        let mut level = Self {
            triangles: Vec::with_capacity(template.charts.len()),
            modes,
            positions: Vec::new(),
            curvatures: Vec::new(),
            columns: Vec::new(),
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
            for first in chart.range().step_by(BLOCK) {
                let range = first..(first + BLOCK).min(chart.end as usize);
                level.push_block(template, range, centre);
            }
        }
        level
    }

    fn push_block(&mut self, template: &LevelTemplate, range: std::ops::Range<usize>, centre: Vector2<f64>) {
        let pixels = &template.pixels;
        let padding = range.len().next_multiple_of(WIDEST) - range.len();
        let packed = pixels.position[range.clone()].iter().map(|p| pack(*p, centre).cast_signed());
        self.positions.extend(packed.chain(std::iter::repeat_n(0, padding)));
        let curvatures =
            template.curvature[range.clone()].iter().map(|c| local::pack_curvature(*c).cast_signed());
        self.curvatures.extend(curvatures.chain(std::iter::repeat_n(0, padding)));
        let gradient = &pixels.gradient[range.clone()];
        let mut push = |column: &mut dyn Iterator<Item = f32>| {
            self.columns.extend(column.chain(std::iter::repeat_n(0.0, padding)));
        };
        push(&mut gradient.iter().map(|g| g[0]));
        push(&mut gradient.iter().map(|g| g[1]));
        for column in [&pixels.intensity, &pixels.weight].into_iter().chain(&pixels.modes) {
            push(&mut column[range.clone()].iter().copied());
        }
    }

    /// The blocks of a triangle.
    pub(super) fn blocks(&self, triangle: &Triangle) -> impl Iterator<Item = Block<'_>> {
        let (start, pixels) = (triangle.start, triangle.pixels);
        (0..pixels).step_by(BLOCK).map(move |first| {
            let pixels = (pixels - first).min(BLOCK);
            let (at, n) = (start + first, pixels.next_multiple_of(WIDEST));
            let columns = &self.columns[at * (COLUMNS + self.modes)..][..n * (COLUMNS + self.modes)];
            let (texels, modes) = columns.split_at(COLUMNS * n);
            let texels = [0, 1, 2, 3].map(|k| &texels[k * n..][..n]);
            Block {
                pixels,
                positions: &self.positions[at..][..n],
                curvatures: &self.curvatures[at..][..n],
                texels,
                modes,
            }
        })
    }

    /// Number of pixels, padding included.
    pub(crate) fn padded_pixels(&self) -> usize {
        self.positions.len()
    }

    /// Bytes that one pass over the level reads.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(self.positions.as_slice())
            + size_of_val(self.curvatures.as_slice())
            + size_of_val(self.columns.as_slice())
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
