//! `linearize` of one block of pixels: as `super::kernel`, with the slope of the image and the sums of second order.
//!
//! Twin: `crate::backend::cpu::linearize`. Columns that later sums need stay in the first-level cache; every loop has as
//! many sums as fit into registers.

use fearless_simd::{Simd, prelude::*};

use super::BLOCK;
use super::kernel::{Scratch, add_up, columns, load, look, neighbours, project, unpack, weigh};
use super::pairs::Pairs;
use super::template::Block;
use crate::backend::local::LocalWarp;

/// Results of the steps over one block.
#[derive(Debug)]
pub(super) struct LinearScratch {
    common: Scratch,
    /// Slope `(h_u, h_v)` of the image.
    slope: [[f32; BLOCK]; 2],
    /// `q (h_u u, h_u v, h_u, h_v u, h_v v, h_v)`.
    direction: [[f32; BLOCK]; 6],
}

impl Default for LinearScratch {
    fn default() -> Self {
        Self { common: Scratch::default(), slope: [[0.0; BLOCK]; 2], direction: [[0.0; BLOCK]; 6] }
    }
}

/// Adds the sums of a block to both rows of its triangle, relative to the chart's centre. `INSIDE` is as in
/// [`super::kernel::add_block`].
#[inline(always)]
pub(super) fn add_block<S: Simd, const INSIDE: bool>(
    simd: S,
    block: &Block<'_>,
    warp: &LocalWarp,
    appearance: &[f32],
    image: &Pairs,
    scratch: &mut LinearScratch,
    (first, second): (&mut [f64], &mut [f64]),
) {
    look::<S, INSIDE>(simd, block, warp, appearance, image, &mut scratch.common);
    let (head, modes) = first.split_at_mut(11);
    sum_first::<S, INSIDE>(simd, block, appearance.is_empty(), scratch, head);
    project(simd, block, &scratch.common, modes);
    let (hessian, cross) = second.split_at_mut(18);
    for (sums, [along, across]) in hessian.chunks_exact_mut(6).zip([[2, 0], [2, 1], [5, 1]]) {
        sum_places(simd, block, &scratch.direction[along], &scratch.slope[across], sums);
    }
    let (of_mean, of_modes) = cross.split_at_mut(12);
    sum_mean(simd, block, scratch, of_mean);
    let n = block.positions.len();
    for (k, sums) in of_modes.chunks_mut(12).enumerate() {
        let modes = &block.modes[2 * k * n..];
        if sums.len() == 12 {
            sum_modes::<S, 2>(simd, n, columns(modes, n), scratch, sums);
        } else {
            sum_modes::<S, 1>(simd, n, columns(modes, n), scratch, sums);
        }
    }
}

/// Residuals, slopes, and the sums of the first order that do not depend on the modes.
#[inline(always)]
fn sum_first<S: Simd, const INSIDE: bool>(
    simd: S,
    block: &Block<'_>,
    is_mean: bool,
    scratch: &mut LinearScratch,
    row: &mut [f64],
) {
    let LinearScratch { common, slope, direction } = scratch;
    let mut sums = [S::f32s::splat(simd, 0.0); 11];
    for i in (0..block.positions.len()).step_by(S::f32s::LEN) {
        let at = i..i + S::f32s::LEN;
        let intensity = load(simd, block.texels[2], &at);
        let template = if is_mean { intensity } else { load(simd, &common.template, &at) };
        let (fu, fv) = (load(simd, &common.fraction[0], &at), load(simd, &common.fraction[1], &at));
        let [upper_left, lower_left, upper_right, lower_right] = neighbours(simd, common, at.clone());
        let (along_upper, along_lower) = (upper_right - upper_left, lower_right - lower_left);
        let (upper, lower) = (fu.mul_add(along_upper, upper_left), fu.mul_add(along_lower, lower_left));
        let slope_u = fv.mul_add(along_lower - along_upper, along_upper);
        let slope_v = lower - upper;
        let residual = template - fv.mul_add(slope_v, upper);
        let [q, _] = weigh::<S, INSIDE>(simd, block, &at, [intensity, residual], common, &mut sums);
        slope_u.store_slice(&mut slope[0][at.clone()]);
        slope_v.store_slice(&mut slope[1][at.clone()]);
        let [u, v] = unpack(simd, &block.positions[at.clone()]);
        let (along_u, along_v) = (q * slope_u, q * slope_v);
        let terms = [along_u * u, along_u * v, along_u, along_v * u, along_v * v, along_v];
        for k in 0..6 {
            terms[k].store_slice(&mut direction[k][at.clone()]);
            sums[k] = terms[k].mul_add(residual, sums[k]);
        }
    }
    add_up(sums, row);
}

/// sum a b (u^2, u v, u, v^2, v, 1).
#[inline(always)]
fn sum_places<S: Simd>(simd: S, block: &Block<'_>, a: &[f32], b: &[f32], totals: &mut [f64]) {
    let mut sums = [S::f32s::splat(simd, 0.0); 6];
    for i in (0..block.positions.len()).step_by(S::f32s::LEN) {
        let at = i..i + S::f32s::LEN;
        let weight = load(simd, a, &at) * load(simd, b, &at);
        let [u, v] = unpack(simd, &block.positions[at]);
        let (of_u, of_v) = (weight * u, weight * v);
        sums[0] = of_u.mul_add(u, sums[0]);
        sums[1] = of_u.mul_add(v, sums[1]);
        sums[2] += of_u;
        sums[3] = of_v.mul_add(v, sums[3]);
        sums[4] += of_v;
        sums[5] += weight;
    }
    add_up(sums, totals);
}

/// Couplings of the directions with T0 and with 1.
#[inline(always)]
fn sum_mean<S: Simd>(simd: S, block: &Block<'_>, scratch: &LinearScratch, totals: &mut [f64]) {
    let mut sums = [S::f32s::splat(simd, 0.0); 12];
    for i in (0..block.positions.len()).step_by(S::f32s::LEN) {
        let at = i..i + S::f32s::LEN;
        let intensity = load(simd, block.texels[2], &at);
        for k in 0..6 {
            let direction = load(simd, &scratch.direction[k], &at);
            sums[k] = direction.mul_add(intensity, sums[k]);
            sums[6 + k] += direction;
        }
    }
    add_up(sums, totals);
}

/// Couplings of the directions with some modes.
#[inline(always)]
fn sum_modes<S: Simd, const N: usize>(
    simd: S,
    n: usize,
    modes: [&[f32]; N],
    scratch: &LinearScratch,
    totals: &mut [f64],
) {
    let mut sums = [[S::f32s::splat(simd, 0.0); 6]; N];
    for i in (0..n).step_by(S::f32s::LEN) {
        let at = i..i + S::f32s::LEN;
        let mut values = [S::f32s::splat(simd, 0.0); N];
        for m in 0..N {
            values[m] = load(simd, modes[m], &at);
        }
        for (k, column) in scratch.direction.iter().enumerate() {
            let direction = load(simd, column, &at);
            for m in 0..N {
                sums[m][k] = direction.mul_add(values[m], sums[m][k]);
            }
        }
    }
    for m in 0..N {
        add_up(sums[m], &mut totals[6 * m..][..6]);
    }
}
