//! Where the pixels of a block are in the image, eq. (3), and what is there.

use fearless_simd::{Simd, prelude::*};

use super::kernel::{Scratch, splat, unpack};
use super::pairs::{Pairs, Window};
use super::template::{Block, WIDEST};
use crate::backend::local::LocalWarp;

/// A chart whose corners are this far inside the image lies inside it, whatever f32 does to its pixels.
const MARGIN: f32 = 0.01;

/// An image, or what is known to be enough of it.
pub(super) trait Place: Copy {
    /// Are all pixels of the chart in it?
    const INSIDE: bool;

    /// Is any pixel of the image saturated?
    fn is_saturated(&self) -> bool;

    /// Where the pixels of a block are, and the four pixels around each.
    fn look_up<S: Simd>(self, simd: S, block: &Block<'_>, warp: &LocalWarp, scratch: &mut Scratch);
}

/// The window of a chart all of whose pixels are inside the image and the window. `reach` is the largest |u| and |v| of its pixels.
/// With positive depths the rectangle around them goes to the quadrangle of its warped corners.
#[inline(always)]
pub(super) fn window<'a>(warp: &LocalWarp, reach: [f32; 2], image: &Pairs<'a>) -> Option<Window<'a>> {
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
    fn is_saturated(&self) -> bool {
        self.is_saturated
    }

    /// Those of padding are inside as well.
    #[inline(always)]
    fn look_up<S: Simd>(self, simd: S, block: &Block<'_>, warp: &LocalWarp, scratch: &mut Scratch) {
        let rows = rows(simd, warp);
        #[expect(clippy::cast_precision_loss, reason = "image sides are far below 2^24")]
        let stride = self.width as f32;
        // Indices of pixels are exact in f32.
        let base = warp.base[1] * stride + warp.base[0] - self.start;
        let [one, stride, base] = splat(simd, [1.0, stride, base]);
        let groups = block.groups();
        for group in groups.clone() {
            for i in (0..WIDEST).step_by(S::f32s::LEN) {
                let at = i..i + S::f32s::LEN;
                let Spot { corner, fraction, .. } =
                    spot(rows, one, unpack(simd, &block.positions[group].0[at.clone()]));
                let index: S::i32s = (corner[1].mul_add(stride, corner[0]) + base).to_int();
                let index: S::u32s = index.bitcast();
                index.store_slice(&mut scratch.index[group].0[at.clone()]);
                fraction[0].store_slice(&mut scratch.fraction[0][group].0[at.clone()]);
                fraction[1].store_slice(&mut scratch.fraction[1][group].0[at]);
            }
            // One group behind: what has just been stored the compiler would take out of registers number by number, and
            // arithmetic of this group fills the time that the pixels of the last one take to arrive.
            if group > 0 {
                self.quads(&scratch.index[group - 1].0, &mut scratch.quad[group - 1].0);
            }
        }
        if let Some(last) = groups.last() {
            self.quads(&scratch.index[last].0, &mut scratch.quad[last].0);
        }
    }
}

impl Place for Pairs<'_> {
    const INSIDE: bool = false;

    #[inline(always)]
    fn is_saturated(&self) -> bool {
        self.is_saturated
    }

    /// Also which of them are inside.
    #[inline(always)]
    fn look_up<S: Simd>(self, simd: S, block: &Block<'_>, warp: &LocalWarp, scratch: &mut Scratch) {
        let rows = rows(simd, warp);
        let [base_u, base_v] = splat(simd, warp.base);
        #[expect(clippy::cast_precision_loss, reason = "image sides are far below 2^24")]
        let [last_u, last_v] = splat(simd, [self.width as f32 - 1.0, self.height as f32 - 1.0]);
        let stride = S::i32s::splat(simd, self.width.cast_signed());
        let [zero, one, outside] = splat(simd, [0.0, 1.0, -1.0]);
        for (group, positions) in block.positions.iter().enumerate() {
            for i in (0..WIDEST).step_by(S::f32s::LEN) {
                let at = i..i + S::f32s::LEN;
                let Spot { depth, corner, fraction } =
                    spot(rows, one, unpack(simd, &positions.0[at.clone()]));
                let (pixel_u, pixel_v) = (corner[0] + base_u, corner[1] + base_v);
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
                for k in 0..2 {
                    let fraction = inside.select(fraction[k], zero);
                    fraction.store_slice(&mut scratch.fraction[k][group].0[at.clone()]);
                }
                inside.select(one, zero).store_slice(&mut scratch.inside[group].0[at]);
            }
            self.quads(&scratch.index[group].0, &mut scratch.quad[group].0);
        }
        let (whole, rest) = (block.pixels / WIDEST, block.pixels % WIDEST);
        if rest > 0 {
            scratch.inside[whole].0[rest..].fill(0.0);
        }
    }
}

/// Where a warp takes pixels of a chart, relative to its base.
struct Spot<V> {
    depth: V,
    /// The pixel at the upper left.
    corner: [V; 2],
    /// Where between it and the next the spot lies.
    fraction: [V; 2],
}

#[inline(always)]
fn spot<S: Simd, V: SimdFloat<S>>(rows: [[V; 3]; 3], one: V, [u, v]: [V; 2]) -> Spot<V> {
    let depth = apply(rows[2], u, v);
    let inverse = one / depth;
    let (local_u, local_v) = (apply(rows[0], u, v) * inverse, apply(rows[1], u, v) * inverse);
    let corner = [local_u.floor(), local_v.floor()];
    Spot { depth, corner, fraction: [local_u - corner[0], local_v - corner[1]] }
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

#[cfg(test)]
mod tests {
    use image::GrayImage;

    use super::super::pairs::PairsPyramid;
    use super::*;

    /// Does a chart that reaches `reach` around `at` and is seen as it is have a window in an image? `depth` is the last row of its warp.
    fn fits((width, height): (u32, u32), at: [f32; 2], reach: [f32; 2], depth: [f32; 3]) -> bool {
        let mut pyramid = PairsPyramid::default();
        pyramid.rebuild(&GrayImage::new(width, height), 1);
        let base = at.map(f32::floor);
        let rows = [[1.0, 0.0, at[0] - base[0]], [0.0, 1.0, at[1] - base[1]], depth];
        let warp = LocalWarp { rows, base, blur: [[0.0; 3]; 2], light: [0.0; 2] };
        window(&warp, reach, &pyramid.level(0)).is_some()
    }

    const UPRIGHT: [f32; 3] = [0.0, 0.0, 1.0];

    #[test]
    fn charts_at_the_border_have_a_window_up_to_the_margin() {
        let at = |at| fits((640, 480), at, [10.0, 20.0], UPRIGHT);
        assert!(at([320.0, 240.0]), "in the middle");
        for (inside, outside) in [
            ([10.02, 240.0], [10.0, 240.0]),
            ([628.98, 240.0], [629.0, 240.0]),
            ([320.0, 20.02], [320.0, 20.0]),
            ([320.0, 458.98], [320.0, 459.0]),
        ] {
            assert!(at(inside) && !at(outside), "{inside:?}, {outside:?}");
        }
    }

    #[test]
    fn charts_too_high_and_images_too_large_have_none() {
        // 43 rows of 3000 pixels are in a window: one, and 21 on either side.
        let high = |reach| fits((3000, 300), [700.0, 150.0], [10.0, reach], UPRIGHT);
        assert!(high(20.9) && !high(20.995), "21 rows");
        let large = |width| fits((width, 2048), [700.0, 150.0], [5.0, 5.0], UPRIGHT);
        assert!(large(8191) && !large(8192), "2^24 pixels");
    }

    #[test]
    fn charts_behind_the_camera_have_none() {
        let seen = |depth| fits((640, 480), [320.0, 240.0], [10.0, 10.0], depth);
        assert!(seen([0.01, 0.0, 1.0]), "in front");
        for depth in [[0.0, 0.0, -1.0], [0.2, 0.0, 1.0], [0.0, f32::NAN, 1.0]] {
            assert!(!seen(depth), "{depth:?}");
        }
    }
}
