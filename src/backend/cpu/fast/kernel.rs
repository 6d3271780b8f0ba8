//! What `accumulate` and `linearize` of a block share: the results that their steps hand on, and arithmetic on vectors of pixels.

use std::ops::Range;

use fearless_simd::{Simd, prelude::*};

use super::locate::Place;
use super::template::{Block, GROUPS, Line, WIDEST};

/// A column of a block.
pub(super) type Column<T> = [Line<T>; GROUPS];

/// Results of the steps over one block.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Where the pixel at the upper left of the warped position is in the image, or in its window; 0 outside.
    pub(super) index: Column<u32>,
    /// The four pixels around the warped position.
    pub(super) quad: Column<u32>,
    /// Where between them it lies.
    pub(super) fraction: [Column<f32>; 2],
    /// 1 inside the image, 0 outside and for padding.
    pub(super) inside: Column<f32>,
    /// What the template shows, as far as it has been worked out.
    pub(super) template: Column<f32>,
    /// q r.
    pub(super) weighted: Column<f32>,
}

// Loops instead of `map`: without optimisation across crates `map` is not inlined, and vectors go through memory.

#[inline(always)]
pub(super) fn splat<S: Simd, const N: usize>(simd: S, values: [f32; N]) -> [S::f32s; N] {
    let mut vectors = [S::f32s::splat(simd, 0.0); N];
    for k in 0..N {
        vectors[k] = S::f32s::splat(simd, values[k]);
    }
    vectors
}

#[inline(always)]
pub(super) fn unpack<S: Simd>(simd: S, positions: &[i32]) -> [S::f32s; 2] {
    let packed = S::i32s::from_slice(simd, positions);
    [((packed << 16) >> 16).to_float(), (packed >> 16).to_float()]
}

/// q and q r of some residuals; q r is kept for the modes, and added up with what else does not depend on a slope.
#[inline(always)]
pub(super) fn weigh<S: Simd, P: Place>(
    simd: S,
    [weight, intensity, residual]: [S::f32s; 3],
    (group, at): (usize, &Range<usize>),
    scratch: &mut Scratch,
    sums: &mut [S::f32s; 11],
) -> [S::f32s; 2] {
    // The weight of padding is zero.
    let mut q = weight;
    if !P::INSIDE {
        let inside = load(simd, &scratch.inside[group], at);
        q *= inside;
        sums[7] += q;
        sums[8] += inside;
    }
    let qr = q * residual;
    qr.store_slice(&mut scratch.weighted[group].0[at.clone()]);
    sums[6] = qr.mul_add(residual, sums[6]);
    sums[9] = qr.mul_add(intensity, sums[9]);
    sums[10] += qr;
    [q, qr]
}

/// Adds the sums of a block to those of its triangle.
#[inline(always)]
pub(super) fn add_up<S: Simd, V: SimdFloat<S, Element = f32>, const N: usize>(
    sums: [V; N],
    totals: &mut [f64],
) {
    for k in 0..N {
        totals[k] += f64::from(sums[k].reduce_sum());
    }
}

#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, line: &Line<f32>, at: &Range<usize>) -> S::f32s {
    S::f32s::from_slice(simd, &line.0[at.clone()])
}

/// Where between its four pixels a position lies.
#[inline(always)]
pub(super) fn fraction<S: Simd>(simd: S, scratch: &Scratch, group: usize, at: &Range<usize>) -> [S::f32s; 2] {
    let [fu, fv] = &scratch.fraction;
    [load(simd, &fu[group], at), load(simd, &fv[group], at)]
}

/// Between four values in the order of [`neighbours`].
#[inline(always)]
pub(super) fn bilinear<S: Simd, V: SimdFloat<S>>(
    [fu, fv]: [V; 2],
    [upper_left, lower_left, upper_right, lower_right]: [V; 4],
) -> V {
    let upper = fu.mul_add(upper_right - upper_left, upper_left);
    let lower = fu.mul_add(lower_right - lower_left, lower_left);
    fv.mul_add(lower - upper, upper)
}

/// The four pixels around positions: upper left, lower left, upper right, lower right.
#[inline(always)]
pub(super) fn neighbours<S: Simd>(
    simd: S,
    scratch: &Scratch,
    group: usize,
    at: &Range<usize>,
) -> [S::f32s; 4] {
    let quad = S::u32s::from_slice(simd, &scratch.quad[group].0[at.clone()]);
    let quad: S::i32s = quad.bitcast();
    let upper_left: S::f32s = (quad & 255).to_float();
    let lower_left: S::f32s = ((quad >> 8) & 255).to_float();
    let upper_right: S::f32s = ((quad >> 16) & 255).to_float();
    let lower_right: S::f32s = ((quad >> 24) & 255).to_float();
    [upper_left, lower_left, upper_right, lower_right]
}

/// sum q r T_k, up to four modes at a time.
#[inline(always)]
pub(super) fn project<S: Simd>(simd: S, block: &Block<'_>, scratch: &Scratch, row: &mut [f64]) {
    for (k, sums) in row.chunks_mut(4).enumerate() {
        match sums.len() {
            1 => project_some::<S, 1>(simd, block, 4 * k, scratch, sums),
            2 => project_some::<S, 2>(simd, block, 4 * k, scratch, sums),
            3 => project_some::<S, 3>(simd, block, 4 * k, scratch, sums),
            _ => project_some::<S, 4>(simd, block, 4 * k, scratch, sums),
        }
    }
}

#[inline(always)]
fn project_some<S: Simd, const MODES: usize>(
    simd: S,
    block: &Block<'_>,
    first: usize,
    scratch: &Scratch,
    totals: &mut [f64],
) {
    let mut sums = [S::f32s::splat(simd, 0.0); MODES];
    for group in block.groups() {
        let modes = block.modes::<MODES>(group, first);
        for i in (0..WIDEST).step_by(S::f32s::LEN) {
            let at = i..i + S::f32s::LEN;
            let qr = load(simd, &scratch.weighted[group], &at);
            for k in 0..MODES {
                sums[k] = qr.mul_add(load(simd, &modes[k], &at), sums[k]);
            }
        }
    }
    add_up(sums, totals);
}
