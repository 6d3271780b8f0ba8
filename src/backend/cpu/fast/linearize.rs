//! `linearize` of one block of pixels: as `super::accumulate`, with the slope of the image and the sums of second order.
//!
//! Twin: `crate::backend::cpu::linearize`. Columns that later sums need stay in the first-level cache; every loop has as
//! many sums as fit into registers.

use fearless_simd::{Simd, prelude::*};

use super::kernel::{Column, Scratch, add_up, fraction, load, neighbours, project, unpack, weigh};
use super::locate::Place;
use super::rendering::blend;
use super::template::{Block, WIDEST};
use crate::backend::local::LocalWarp;

/// Results of the steps over one block.
#[derive(Debug, Default)]
pub(super) struct LinearScratch {
    common: Scratch,
    /// Slope `(h_u, h_v)` of the image.
    slope: [Column<f32>; 2],
    /// `q (h_u u, h_u v, h_u, h_v u, h_v v, h_v)`.
    direction: [Column<f32>; 6],
}

/// Adds the sums of a block to both rows of its triangle, relative to the chart's centre. In a window as in
/// [`super::accumulate::add_block`].
#[inline(always)]
pub(super) fn add_block<S: Simd, P: Place>(
    simd: S,
    block: &Block<'_>,
    warp: &LocalWarp,
    appearance: &[f32],
    place: P,
    scratch: &mut LinearScratch,
    (first, second): (&mut [f64], &mut [f64]),
) {
    place.look_up(simd, block, warp, &mut scratch.common);
    blend(simd, block, appearance, &mut scratch.common);
    let (head, modes) = first.split_at_mut(11);
    sum_first::<S, P>(simd, block, appearance.is_empty(), scratch, head);
    project(simd, block, &scratch.common, modes);
    let (hessian, cross) = second.split_at_mut(18);
    for (sums, [along, across]) in hessian.chunks_exact_mut(6).zip([[2, 0], [2, 1], [5, 1]]) {
        sum_places(simd, block, &scratch.direction[along], &scratch.slope[across], sums);
    }
    let (of_mean, of_modes) = cross.split_at_mut(12);
    sum_mean(simd, block, scratch, of_mean);
    for (k, sums) in of_modes.chunks_mut(12).enumerate() {
        if sums.len() == 12 {
            sum_modes::<S, 2>(simd, block, 2 * k, scratch, sums);
        } else {
            sum_modes::<S, 1>(simd, block, 2 * k, scratch, sums);
        }
    }
}

/// Residuals, slopes, and the sums of the first order that do not depend on the modes.
#[inline(always)]
fn sum_first<S: Simd, P: Place>(
    simd: S,
    block: &Block<'_>,
    is_mean: bool,
    scratch: &mut LinearScratch,
    row: &mut [f64],
) {
    let LinearScratch { common, slope, direction } = scratch;
    let mut sums = [S::f32s::splat(simd, 0.0); 11];
    for group in block.groups() {
        let [_, _, mean, weight] = &block.texels[group];
        for i in (0..WIDEST).step_by(S::f32s::LEN) {
            let at = i..i + S::f32s::LEN;
            let intensity = load(simd, mean, &at);
            let template = if is_mean { intensity } else { load(simd, &common.template[group], &at) };
            let [fu, fv] = fraction(simd, common, group, &at);
            let [upper_left, lower_left, upper_right, lower_right] = neighbours(simd, common, group, &at);
            let (along_upper, along_lower) = (upper_right - upper_left, lower_right - lower_left);
            let (upper, lower) = (fu.mul_add(along_upper, upper_left), fu.mul_add(along_lower, lower_left));
            let slope_u = fv.mul_add(along_lower - along_upper, along_upper);
            let slope_v = lower - upper;
            let residual = template - fv.mul_add(slope_v, upper);
            let values = [load(simd, weight, &at), intensity, residual];
            let [q, _] = weigh::<S, P>(simd, values, (group, &at), common, &mut sums);
            slope_u.store_slice(&mut slope[0][group].0[at.clone()]);
            slope_v.store_slice(&mut slope[1][group].0[at.clone()]);
            let [u, v] = unpack(simd, &block.positions[group].0[at.clone()]);
            let (along_u, along_v) = (q * slope_u, q * slope_v);
            let terms = [along_u * u, along_u * v, along_u, along_v * u, along_v * v, along_v];
            for k in 0..6 {
                terms[k].store_slice(&mut direction[k][group].0[at.clone()]);
                sums[k] = terms[k].mul_add(residual, sums[k]);
            }
        }
    }
    add_up(sums, row);
}

/// sum a b (u^2, u v, u, v^2, v, 1).
#[inline(always)]
fn sum_places<S: Simd>(simd: S, block: &Block<'_>, a: &Column<f32>, b: &Column<f32>, totals: &mut [f64]) {
    let mut sums = [S::f32s::splat(simd, 0.0); 6];
    for group in block.groups() {
        for i in (0..WIDEST).step_by(S::f32s::LEN) {
            let at = i..i + S::f32s::LEN;
            let weight = load(simd, &a[group], &at) * load(simd, &b[group], &at);
            let [u, v] = unpack(simd, &block.positions[group].0[at]);
            let (of_u, of_v) = (weight * u, weight * v);
            sums[0] = of_u.mul_add(u, sums[0]);
            sums[1] = of_u.mul_add(v, sums[1]);
            sums[2] += of_u;
            sums[3] = of_v.mul_add(v, sums[3]);
            sums[4] += of_v;
            sums[5] += weight;
        }
    }
    add_up(sums, totals);
}

/// Couplings of the directions with T0 and with 1.
#[inline(always)]
fn sum_mean<S: Simd>(simd: S, block: &Block<'_>, scratch: &LinearScratch, totals: &mut [f64]) {
    let mut sums = [S::f32s::splat(simd, 0.0); 12];
    for group in block.groups() {
        for i in (0..WIDEST).step_by(S::f32s::LEN) {
            let at = i..i + S::f32s::LEN;
            let intensity = load(simd, &block.texels[group][2], &at);
            for k in 0..6 {
                let direction = load(simd, &scratch.direction[k][group], &at);
                sums[k] = direction.mul_add(intensity, sums[k]);
                sums[6 + k] += direction;
            }
        }
    }
    add_up(sums, totals);
}

/// Couplings of the directions with some modes.
#[inline(always)]
fn sum_modes<S: Simd, const N: usize>(
    simd: S,
    block: &Block<'_>,
    first: usize,
    scratch: &LinearScratch,
    totals: &mut [f64],
) {
    let mut sums = [[S::f32s::splat(simd, 0.0); 6]; N];
    for group in block.groups() {
        let modes = block.modes::<N>(group, first);
        for i in (0..WIDEST).step_by(S::f32s::LEN) {
            let at = i..i + S::f32s::LEN;
            let mut values = [S::f32s::splat(simd, 0.0); N];
            for m in 0..N {
                values[m] = load(simd, &modes[m], &at);
            }
            for (k, column) in scratch.direction.iter().enumerate() {
                let direction = load(simd, &column[group], &at);
                for m in 0..N {
                    sums[m][k] = direction.mul_add(values[m], sums[m][k]);
                }
            }
        }
    }
    for m in 0..N {
        add_up(sums[m], &mut totals[6 * m..][..6]);
    }
}
