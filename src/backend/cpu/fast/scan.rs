//! Second implementation of `scan`: f32 vectors along the rows of a map with a border of zeros, so that a point of a
//! template costs one multiply-add per position and channel, all loads contiguous.

use fearless_simd::{Level, Simd, dispatch, prelude::*};

use crate::backend::cpu::Instructions;
use crate::backend::templates::{ScanPeak, ScanPoint, ScanRequest, TILE};
use crate::imaging::NormalisedGradient;

/// Vectors of a row that are summed together: the sums stay in registers.
const RUN: usize = 5;
/// Rows are padded to whole runs of the widest vectors.
const WIDEST: usize = 16 * RUN;

/// The two channels with a border of zeros.
#[derive(Debug)]
struct Padded {
    channels: [Vec<f32>; 2],
    stride: usize,
    border: usize,
    width: usize,
    height: usize,
    padded_width: usize,
}

impl Padded {
    /// A border as wide as templates reach.
    fn new(image: &NormalisedGradient, border: usize) -> Self {
        let padded_width = image.width.next_multiple_of(WIDEST);
        let stride = padded_width + 2 * border;
        let mut channels = [0, 1].map(|_| vec![0.0; stride * (image.height + 2 * border)]);
        for (y, row) in image.values.chunks_exact(image.width).enumerate() {
            let start = (y + border) * stride + border;
            for (k, channel) in channels.iter_mut().enumerate() {
                channel[start..start + row.len()].iter_mut().zip(row).for_each(|(c, v)| *c = v[k]);
            }
        }
        Self { channels, stride, border, width: image.width, height: image.height, padded_width }
    }
}

/// What a thread needs.
#[derive(Debug, Default)]
pub(in crate::backend) struct Scratch {
    /// Index of a point's first element in row 0, and its values.
    points: Vec<(usize, [f32; 2])>,
    /// Best score and its row per column of a row of tiles.
    best: Vec<f32>,
    row: Vec<f32>,
}

/// An image made ready for all templates of a request.
#[derive(Debug)]
pub(in crate::backend) struct FastScanner<'a> {
    level: Level,
    request: &'a ScanRequest<'a>,
    image: Padded,
}

impl<'a> FastScanner<'a> {
    pub(in crate::backend) fn new(instructions: Instructions, request: &'a ScanRequest<'a>) -> Self {
        let image = Padded::new(request.image, request.templates.reach());
        Self { level: super::level(instructions), request, image }
    }

    /// As the twin.
    pub(in crate::backend) fn scan(&self, template: usize, scratch: &mut Scratch, peaks: &mut [ScanPeak]) {
        let (points, scale) = self.request.templates.get(template);
        scan(self.level, (points, scale), &self.image, scratch, peaks);
    }
}

fn scan(
    level: Level,
    (points, scale): (&[ScanPoint], f32),
    image: &Padded,
    scratch: &mut Scratch,
    peaks: &mut [ScanPeak],
) {
    scratch.points.clear();
    scratch.points.extend(points.iter().map(|p| {
        // The border is as wide as offsets reach, so indices are never negative.
        let [x, y] = p.offset.map(|o| image.border.wrapping_add_signed(isize::from(o)));
        (y * image.stride + x, p.value.map(|v| v * scale))
    }));
    let columns = image.width.div_ceil(TILE);
    for (tile_row, peaks) in peaks.chunks_exact_mut(columns).enumerate() {
        let rows = tile_row * TILE..((tile_row + 1) * TILE).min(image.height);
        scratch.best.clear();
        scratch.best.resize(image.padded_width, f32::NEG_INFINITY);
        scratch.row.clear();
        scratch.row.resize(image.padded_width, 0.0);
        for v in rows {
            dispatch!(level, simd => add_row(simd, image, v, scratch));
        }
        for (tile, peak) in peaks.iter_mut().enumerate() {
            let inside = tile * TILE..((tile + 1) * TILE).min(image.width);
            *peak = best_of(scratch, inside);
        }
    }
}

/// The best column of a tile; of equal ones the first in reading order.
fn best_of(scratch: &Scratch, columns: std::ops::Range<usize>) -> ScanPeak {
    let (mut score, mut at) = (f32::NEG_INFINITY, [0.0, 0.0]);
    for u in columns {
        let (s, v) = (scratch.best[u], scratch.row[u]);
        if s > score || (s == score && v < at[1]) {
            #[expect(clippy::cast_precision_loss, reason = "images are far below 2^24 wide")]
            let u = u as f32;
            (score, at) = (s, [u, v]);
        }
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole numbers of pixels")]
    let position = at.map(|x| x as u16);
    ScanPeak { score, position }
}

/// Scores all positions of a row and keeps the best per column.
#[inline(always)]
fn add_row<S: Simd>(simd: S, image: &Padded, v: usize, scratch: &mut Scratch) {
    let length = RUN * S::f32s::LEN;
    #[expect(clippy::cast_precision_loss, reason = "images are far below 2^24 high")]
    let this_row = S::f32s::splat(simd, v as f32);
    for start in (0..image.padded_width).step_by(length) {
        let base = v * image.stride + start;
        let mut sums = [S::f32s::splat(simd, 0.0); RUN];
        for (offset, [a, b]) in &scratch.points {
            let first = &image.channels[0][base + offset..][..length];
            let second = &image.channels[1][base + offset..][..length];
            let (a, b) = (S::f32s::splat(simd, *a), S::f32s::splat(simd, *b));
            for (k, sum) in sums.iter_mut().enumerate() {
                let at = k * S::f32s::LEN..(k + 1) * S::f32s::LEN;
                *sum = a.mul_add(S::f32s::from_slice(simd, &first[at.clone()]), *sum);
                *sum = b.mul_add(S::f32s::from_slice(simd, &second[at]), *sum);
            }
        }
        for (k, sum) in sums.into_iter().enumerate() {
            let at = start + k * S::f32s::LEN..start + (k + 1) * S::f32s::LEN;
            let best = S::f32s::from_slice(simd, &scratch.best[at.clone()]);
            let row = S::f32s::from_slice(simd, &scratch.row[at.clone()]);
            let better = sum.simd_gt(best);
            better.select(sum, best).store_slice(&mut scratch.best[at.clone()]);
            better.select(this_row, row).store_slice(&mut scratch.row[at]);
        }
    }
}
