//! One block of pixels: warp, gather, residual and sums, in steps whose results stay in the first-level cache.

use fearless_simd::{Simd, prelude::*};

use super::BLOCK;
use super::locate::{locate, locate_inside};
use super::pairs::Pairs;
use super::rendering::{blur, unsaturate};
use super::template::Block;
use crate::backend::local::LocalWarp;

/// Results of the steps over one block.
#[derive(Debug)]
pub(super) struct Scratch {
    /// Index of the pixel at the upper left of the warped position; 0 outside.
    pub(super) index: [u32; BLOCK],
    /// The four pixels around the warped position.
    quad: [u32; BLOCK],
    /// Where between them it lies.
    pub(super) fraction: [[f32; BLOCK]; 2],
    /// 1 inside the image, 0 outside and for padding.
    pub(super) inside: [f32; BLOCK],
    /// T0 + sum lambda_k T_k.
    pub(super) template: [f32; BLOCK],
    /// q r.
    pub(super) weighted: [f32; BLOCK],
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            index: [0; BLOCK],
            quad: [0; BLOCK],
            fraction: [[0.0; BLOCK]; 2],
            inside: [0.0; BLOCK],
            template: [0.0; BLOCK],
            weighted: [0.0; BLOCK],
        }
    }
}

/// Adds the sums of a block to a row, gradients relative to the chart's centre. With `INSIDE` all of the chart is inside the
/// image, and the two sums that then depend on the template alone are left to the caller.
#[inline(always)]
pub(super) fn add_block<S: Simd, const INSIDE: bool>(
    simd: S,
    block: &Block<'_>,
    warp: &LocalWarp,
    appearance: &[f32],
    image: &Pairs,
    scratch: &mut Scratch,
    row: &mut [f64],
) {
    look::<S, INSIDE>(simd, block, warp, appearance, image, scratch);
    let (first, modes) = row.split_at_mut(11);
    let mut is_mean = appearance.is_empty();
    if warp.is_blurred() {
        blur(simd, block, is_mean, warp, scratch);
        is_mean = false;
    }
    if image.is_saturated {
        first[8] -= unsaturate::<S, INSIDE>(simd, block, is_mean, warp, scratch);
        is_mean = false;
    }
    sum_texels::<S, INSIDE>(simd, block, is_mean, scratch, first);
    project(simd, block, scratch, modes);
}

/// What the image and the template show at the pixels of a block.
#[inline(always)]
pub(super) fn look<S: Simd, const INSIDE: bool>(
    simd: S,
    block: &Block<'_>,
    warp: &LocalWarp,
    appearance: &[f32],
    image: &Pairs,
    scratch: &mut Scratch,
) {
    if INSIDE {
        locate_inside(simd, block, warp, image, scratch);
    } else {
        locate(simd, block, warp, image, scratch);
    }
    let n = block.positions.len();
    image.quads(&scratch.index[..n], &mut scratch.quad[..n]);
    blend(simd, block, appearance, scratch);
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

/// T0 + sum lambda_k T_k, up to four modes at a time; without modes T0 is used where it is.
#[inline(always)]
fn blend<S: Simd>(simd: S, block: &Block<'_>, appearance: &[f32], scratch: &mut Scratch) {
    let n = block.positions.len();
    for (k, lambda) in appearance.chunks(4).enumerate() {
        let modes = &block.modes[4 * k * n..];
        match *lambda {
            [a, b, c, d] => blend_some(simd, block, [a, b, c, d], modes, k == 0, scratch),
            [a, b, c] => blend_some(simd, block, [a, b, c], modes, k == 0, scratch),
            [a, b] => blend_some(simd, block, [a, b], modes, k == 0, scratch),
            [a] => blend_some(simd, block, [a], modes, k == 0, scratch),
            _ => {}
        }
    }
}

#[inline(always)]
fn blend_some<S: Simd, const N: usize>(
    simd: S,
    block: &Block<'_>,
    lambda: [f32; N],
    modes: &[f32],
    first: bool,
    scratch: &mut Scratch,
) {
    let n = block.positions.len();
    let (lambda, columns): (_, [&[f32]; N]) = (splat(simd, lambda), columns(modes, n));
    for i in (0..n).step_by(S::f32s::LEN) {
        let at = i..i + S::f32s::LEN;
        let before = if first { &block.texels[2][at.clone()] } else { &scratch.template[at.clone()] };
        let mut sum = S::f32s::from_slice(simd, before);
        for k in 0..N {
            sum = lambda[k].mul_add(S::f32s::from_slice(simd, &columns[k][at.clone()]), sum);
        }
        sum.store_slice(&mut scratch.template[at]);
    }
}

/// The first modes, each of length `n`.
#[inline(always)]
pub(super) fn columns<const N: usize>(modes: &[f32], n: usize) -> [&[f32]; N] {
    let mut columns: [&[f32]; N] = [&[]; N];
    for k in 0..N {
        columns[k] = &modes[k * n..][..n];
    }
    columns
}

/// Residuals, eq. (17), and the sums that do not depend on the modes.
#[inline(always)]
fn sum_texels<S: Simd, const INSIDE: bool>(
    simd: S,
    block: &Block<'_>,
    is_mean: bool,
    scratch: &mut Scratch,
    row: &mut [f64],
) {
    let mut sums = [S::f32s::splat(simd, 0.0); 11];
    for i in (0..block.positions.len()).step_by(S::f32s::LEN) {
        let at = i..i + S::f32s::LEN;
        let gradient_u = load(simd, block.texels[0], &at);
        let gradient_v = load(simd, block.texels[1], &at);
        let intensity = load(simd, block.texels[2], &at);
        let template = if is_mean { intensity } else { load(simd, &scratch.template, &at) };
        let residual = template - sample(simd, scratch, at.clone());
        let [_, qr] = weigh::<S, INSIDE>(simd, block, &at, [intensity, residual], scratch, &mut sums);
        let [u, v] = unpack(simd, &block.positions[at]);
        let (along_u, along_v) = (qr * gradient_u, qr * gradient_v);
        sums[0] = along_u.mul_add(u, sums[0]);
        sums[1] = along_u.mul_add(v, sums[1]);
        sums[2] += along_u;
        sums[3] = along_v.mul_add(u, sums[3]);
        sums[4] = along_v.mul_add(v, sums[4]);
        sums[5] += along_v;
    }
    add_up(sums, row);
}

/// q and q r of some residuals; q r is kept for the modes, and added up with what else does not depend on a slope.
#[inline(always)]
pub(super) fn weigh<S: Simd, const INSIDE: bool>(
    simd: S,
    block: &Block<'_>,
    at: &std::ops::Range<usize>,
    [intensity, residual]: [S::f32s; 2],
    scratch: &mut Scratch,
    sums: &mut [S::f32s; 11],
) -> [S::f32s; 2] {
    // The weight of padding is zero.
    let mut q = load(simd, block.texels[3], at);
    if !INSIDE {
        let inside = load(simd, &scratch.inside, at);
        q *= inside;
        sums[7] += q;
        sums[8] += inside;
    }
    let qr = q * residual;
    qr.store_slice(&mut scratch.weighted[at.start..at.end]);
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
pub(super) fn load<S: Simd>(simd: S, values: &[f32], at: &std::ops::Range<usize>) -> S::f32s {
    S::f32s::from_slice(simd, &values[at.start..at.end])
}

/// Grey values between the four pixels, bilinear.
#[inline(always)]
fn sample<S: Simd>(simd: S, scratch: &Scratch, at: std::ops::Range<usize>) -> S::f32s {
    let fraction = [load(simd, &scratch.fraction[0], &at), load(simd, &scratch.fraction[1], &at)];
    bilinear(fraction, neighbours(simd, scratch, at))
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
pub(super) fn neighbours<S: Simd>(simd: S, scratch: &Scratch, at: std::ops::Range<usize>) -> [S::f32s; 4] {
    let quad = S::u32s::from_slice(simd, &scratch.quad[at]);
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
    let n = block.positions.len();
    for (k, sums) in row.chunks_mut(4).enumerate() {
        let modes = &block.modes[4 * k * n..];
        match sums {
            [a, b, c, d] => project_some(simd, n, modes, scratch, [a, b, c, d]),
            [a, b, c] => project_some(simd, n, modes, scratch, [a, b, c]),
            [a, b] => project_some(simd, n, modes, scratch, [a, b]),
            [a] => project_some(simd, n, modes, scratch, [a]),
            _ => {}
        }
    }
}

#[inline(always)]
fn project_some<S: Simd, const N: usize>(
    simd: S,
    n: usize,
    modes: &[f32],
    scratch: &Scratch,
    totals: [&mut f64; N],
) {
    let columns: [&[f32]; N] = columns(modes, n);
    let mut sums = [S::f32s::splat(simd, 0.0); N];
    for i in (0..n).step_by(S::f32s::LEN) {
        let at = i..i + S::f32s::LEN;
        let qr = S::f32s::from_slice(simd, &scratch.weighted[at.clone()]);
        for k in 0..N {
            sums[k] = qr.mul_add(S::f32s::from_slice(simd, &columns[k][at.clone()]), sums[k]);
        }
    }
    for k in 0..N {
        *totals[k] += f64::from(sums[k].reduce_sum());
    }
}
