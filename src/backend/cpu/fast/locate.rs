//! Where the pixels of a block are in the image, eq. (3).

use fearless_simd::{Simd, prelude::*};

use super::kernel::{Scratch, splat, unpack};
use super::pairs::{Pairs, Window};
use super::template::{Block, WIDEST, parts};
use crate::backend::local::LocalWarp;

/// A chart whose corners are this far inside the image lies inside it, whatever f32 does to its pixels.
const MARGIN: f32 = 0.01;
/// Numbers of pixels below this are exact in f32.
const EXACT: u32 = 1 << 24;

/// An image, or what is known to be enough of it.
pub(super) trait Place: Copy {
    /// Are all pixels of the chart in it?
    const INSIDE: bool;

    /// The image.
    fn image(&self) -> &Pairs;

    /// Where the pixels of a block are, and the four pixels around each.
    fn look_up<S: Simd>(self, simd: S, block: &Block<'_>, warp: &LocalWarp, scratch: &mut Scratch);
}

/// The window of a chart all of whose pixels are inside the image and the window. `reach` is the largest |u| and |v| of its pixels.
/// With positive depths the rectangle around them goes to the quadrangle of its warped corners.
#[inline(always)]
pub(super) fn window<'a>(warp: &LocalWarp, reach: [f32; 2], image: &'a Pairs) -> Option<Window<'a>> {
    if image.width.saturating_mul(image.height) >= EXACT {
        return None;
    }
    let rows = image.window_reach()?;
    #[expect(clippy::cast_precision_loss, reason = "image sides are far below 2^24")]
    let last = [image.width as f32 - 1.0, image.height as f32 - 1.0];
    let [row_u, row_v, depth] = &warp.rows;
    // Middle and half the range of `row - at depth` over the rectangle: without divisions, x / depth is relative to the base.
    let range = |row: &[f32; 3], at: f32| {
        let [a, b, c] = [row[0] - at * depth[0], row[1] - at * depth[1], row[2] - at * depth[2]];
        (c, a.abs() * reach[0] + b.abs() * reach[1])
    };
    let is_between = |row: &[f32; 3], low: f32, high: f32| {
        let ((from_low, low_reach), (from_high, high_reach)) = (range(row, low), range(row, high));
        from_low >= low_reach && -from_high >= high_reach
    };
    let (_, depth_reach) = range(&[0.0; 3], 1.0);
    let [u, v] = warp.base;
    let is_inside = depth[2] > depth_reach
        && is_between(row_u, MARGIN - u, last[0] - MARGIN - u)
        && is_between(row_v, (MARGIN - v).max(MARGIN - rows), (last[1] - v).min(rows) - MARGIN);
    if is_inside { image.window(v, rows) } else { None }
}

impl Place for Window<'_> {
    const INSIDE: bool = true;

    #[inline(always)]
    fn image(&self) -> &Pairs {
        self.image
    }

    /// Those of padding are inside as well.
    #[inline(always)]
    fn look_up<S: Simd>(self, simd: S, block: &Block<'_>, warp: &LocalWarp, scratch: &mut Scratch) {
        let [row_u, row_v, row_w] = rows(simd, warp);
        #[expect(clippy::cast_precision_loss, reason = "indices of pixels are exact")]
        let [stride, start] = [self.image.width as f32, self.start as f32];
        let base = warp.base[1] * stride + warp.base[0] - start;
        let [one, stride, base] = splat(simd, [1.0, stride, base]);
        let groups = block.groups();
        for k in groups.clone() {
            for at in parts::<S>() {
                let [u, v] = unpack(simd, &block.positions[k].0[at.clone()]);
                let inverse = one / apply(row_w, u, v);
                let (local_u, local_v) = (apply(row_u, u, v) * inverse, apply(row_v, u, v) * inverse);
                let (corner_u, corner_v) = (local_u.floor(), local_v.floor());
                let index: S::i32s = (corner_v.mul_add(stride, corner_u) + base).to_int();
                let index: S::u32s = index.bitcast();
                index.store_slice(&mut scratch.index[k].0[at.clone()]);
                (local_u - corner_u).store_slice(&mut scratch.fraction[0][k].0[at.clone()]);
                (local_v - corner_v).store_slice(&mut scratch.fraction[1][k].0[at]);
            }
            if k > 0 {
                self.quads(&scratch.index[k - 1].0, &mut scratch.quad[k - 1].0);
            }
        }
        if let Some(k) = groups.last() {
            self.quads(&scratch.index[k].0, &mut scratch.quad[k].0);
        }
    }
}

impl Place for &Pairs {
    const INSIDE: bool = false;

    #[inline(always)]
    fn image(&self) -> &Pairs {
        self
    }

    /// Also which of them are inside.
    #[inline(always)]
    fn look_up<S: Simd>(self, simd: S, block: &Block<'_>, warp: &LocalWarp, scratch: &mut Scratch) {
        look_up(simd, block, warp, self, scratch);
    }
}

/// Positions of any block, and which of them are inside.
#[inline(always)]
fn look_up<S: Simd>(simd: S, block: &Block<'_>, warp: &LocalWarp, image: &Pairs, scratch: &mut Scratch) {
    let [row_u, row_v, row_w] = rows(simd, warp);
    let [base_u, base_v] = splat(simd, warp.base);
    #[expect(clippy::cast_precision_loss, reason = "image sides are far below 2^24")]
    let [last_u, last_v] = splat(simd, [image.width as f32 - 1.0, image.height as f32 - 1.0]);
    let stride = S::i32s::splat(simd, image.width.cast_signed());
    let [zero, one, outside] = splat(simd, [0.0, 1.0, -1.0]);
    for (group, positions) in block.positions.iter().enumerate() {
        for at in parts::<S>() {
            let [u, v] = unpack(simd, &positions.0[at.clone()]);
            let depth = apply(row_w, u, v);
            let inverse = one / depth;
            let (local_u, local_v) = (apply(row_u, u, v) * inverse, apply(row_v, u, v) * inverse);
            let (corner_u, corner_v) = (local_u.floor(), local_v.floor());
            let (pixel_u, pixel_v) = (corner_u + base_u, corner_v + base_v);
            // Positive range tests, so that NaN is outside, chained by their operands: combining masks is not inlined
            // without optimisation across crates.
            let from_left = depth.simd_gt(zero).select(pixel_u, outside);
            let from_right = from_left.simd_ge(zero).select(last_u - pixel_u, outside);
            let from_top = from_right.simd_gt(zero).select(pixel_v, outside);
            let inside = from_top.simd_ge(zero).select(last_v - pixel_v, outside).simd_gt(zero);
            let row: S::i32s = inside.select(pixel_v, zero).to_int();
            let column: S::i32s = inside.select(pixel_u, zero).to_int();
            let index: S::u32s = (row * stride + column).bitcast();
            index.store_slice(&mut scratch.index[group].0[at.clone()]);
            inside
                .select(local_u - corner_u, zero)
                .store_slice(&mut scratch.fraction[0][group].0[at.clone()]);
            inside
                .select(local_v - corner_v, zero)
                .store_slice(&mut scratch.fraction[1][group].0[at.clone()]);
            inside.select(one, zero).store_slice(&mut scratch.inside[group].0[at]);
        }
        image.quads(&scratch.index[group].0, &mut scratch.quad[group].0);
    }
    let (whole, rest) = (block.pixels / WIDEST, block.pixels % WIDEST);
    if rest > 0 {
        scratch.inside[whole].0[rest..].fill(0.0);
    }
}

#[inline(always)]
fn rows<S: Simd>(simd: S, warp: &LocalWarp) -> [[S::f32s; 3]; 3] {
    let [row_u, row_v, row_w] = warp.rows;
    [splat(simd, row_u), splat(simd, row_v), splat(simd, row_w)]
}

/// A row of a warp times (u, v, 1).
#[inline(always)]
fn apply<S: Simd, V: SimdFloat<S>>(row: [V; 3], u: V, v: V) -> V {
    row[0].mul_add(u, row[1].mul_add(v, row[2]))
}
