//! `accumulate` of one block of pixels: warp, gather, residuals and sums, in steps whose results stay in the first-level cache.
//!
//! Twin: `crate::backend::cpu::accumulate`.

use fearless_simd::{Simd, prelude::*};

use super::kernel::{Scratch, add_up, bilinear, fraction, load, neighbours, project, unpack, weigh};
use super::locate::Place;
use super::rendering::{Rendering, blend, unsaturate};
use super::template::{Block, WIDEST};
use crate::backend::local::LocalWarp;

/// Adds the sums of a block to a row, gradients relative to the chart's centre. In a window all of the chart is inside the
/// image, and the two sums that then depend on the template alone are left to the caller.
#[inline(always)]
pub(super) fn add_block<S: Simd, P: Place>(
    simd: S,
    block: &Block<'_>,
    warp: &LocalWarp,
    appearance: &[f32],
    place: P,
    scratch: &mut Scratch,
    row: &mut [f64],
) {
    place.look_up(simd, block, warp, scratch);
    let (first, modes) = row.split_at_mut(11);
    // By far the most; the others are not worth kernels of their own for every number of modes.
    if P::INSIDE && !place.is_saturated() {
        compare_rendered::<S, P>(simd, block, warp, appearance, scratch, first);
    } else {
        blend(simd, block, appearance, scratch);
        let mut is_mean = appearance.is_empty();
        if warp.is_blurred() {
            Rendering::<S, 0, true>::new(simd, &warp.blur, 0, []).store(block, is_mean, scratch);
            is_mean = false;
        }
        if place.is_saturated() {
            first[8] -= unsaturate::<S, P>(simd, block, is_mean, warp, scratch);
            is_mean = false;
        }
        let rest = Rendering::<S, 0, false>::new(simd, &warp.blur, 0, []);
        sum_texels::<S, P, 0, false>(simd, block, is_mean, &rest, scratch, first);
    }
    project(simd, block, scratch, modes);
}

/// What the template shows is worked out where residuals are summed, so that arithmetic fills the time that its pixels take to
/// arrive from memory; of many modes only the last, those before them in runs of eight or four.
#[inline(always)]
fn compare_rendered<S: Simd, P: Place>(
    simd: S,
    block: &Block<'_>,
    warp: &LocalWarp,
    appearance: &[f32],
    scratch: &mut Scratch,
    row: &mut [f64],
) {
    let from = appearance.len() - last_run(appearance.len());
    let (before, last) = appearance.split_at(from);
    blend(simd, block, before, scratch);
    match *last {
        [a] => compare::<S, P, 1>(simd, block, warp, (from, [a]), scratch, row),
        [a, b] => compare::<S, P, 2>(simd, block, warp, (from, [a, b]), scratch, row),
        [a, b, c] => compare::<S, P, 3>(simd, block, warp, (from, [a, b, c]), scratch, row),
        [a, b, c, d] => compare::<S, P, 4>(simd, block, warp, (from, [a, b, c, d]), scratch, row),
        [a, b, c, d, e, f, g, h] => {
            compare::<S, P, 8>(simd, block, warp, (from, [a, b, c, d, e, f, g, h]), scratch, row);
        }
        _ => compare::<S, P, 0>(simd, block, warp, (from, []), scratch, row),
    }
}

/// How many of the modes are the last run: eight where that comes out even, else up to four.
fn last_run(modes: usize) -> usize {
    match modes % 8 {
        0 => modes.min(8),
        rest => (rest - 1) % 4 + 1,
    }
}

/// With the parameters of the modes from the `from` one on.
#[inline(always)]
fn compare<S: Simd, P: Place, const MODES: usize>(
    simd: S,
    block: &Block<'_>,
    warp: &LocalWarp,
    (from, lambda): (usize, [f32; MODES]),
    scratch: &mut Scratch,
    row: &mut [f64],
) {
    let is_mean = from == 0;
    if warp.is_blurred() {
        let rest = Rendering::<S, MODES, true>::new(simd, &warp.blur, from, lambda);
        sum_texels::<S, P, MODES, true>(simd, block, is_mean, &rest, scratch, row);
    } else {
        let rest = Rendering::<S, MODES, false>::new(simd, &warp.blur, from, lambda);
        sum_texels::<S, P, MODES, false>(simd, block, is_mean, &rest, scratch, row);
    }
}

/// Residuals, eq. (17), and the sums that do not depend on the modes. `rest` is what the template so far lacks.
#[inline(always)]
fn sum_texels<S: Simd, P: Place, const MODES: usize, const BLURRED: bool>(
    simd: S,
    block: &Block<'_>,
    is_mean: bool,
    rest: &Rendering<S, MODES, BLURRED>,
    scratch: &mut Scratch,
    row: &mut [f64],
) {
    let mut sums = [S::f32s::splat(simd, 0.0); 11];
    for group in block.groups() {
        let [of_u, of_v, mean, weight] = &block.texels[group];
        for i in (0..WIDEST).step_by(S::f32s::LEN) {
            let at = i..i + S::f32s::LEN;
            let intensity = load(simd, mean, &at);
            let fraction = fraction(simd, scratch, group, &at);
            let so_far = if is_mean { intensity } else { load(simd, &scratch.template[group], &at) };
            let template = rest.add_to(so_far, block, (group, &at), fraction);
            let residual = template - bilinear(fraction, neighbours(simd, scratch, group, &at));
            let values = [load(simd, weight, &at), intensity, residual];
            let [_, qr] = weigh::<S, P>(simd, values, (group, &at), scratch, &mut sums);
            let (along_u, along_v) = (qr * load(simd, of_u, &at), qr * load(simd, of_v, &at));
            let [u, v] = unpack(simd, &block.positions[group].0[at]);
            sums[0] = along_u.mul_add(u, sums[0]);
            sums[1] = along_u.mul_add(v, sums[1]);
            sums[2] += along_u;
            sums[3] = along_v.mul_add(u, sums[3]);
            sums[4] = along_v.mul_add(v, sums[4]);
            sums[5] += along_v;
        }
    }
    add_up(sums, row);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_run_is_one_that_there_is_a_kernel_for() {
        for modes in 0..40 {
            let run = last_run(modes);
            assert!(matches!(run, 0..=4 | 8) && run <= modes && (run > 0 || modes == 0), "{modes}: {run}");
            assert!((modes - run).is_multiple_of(4), "{modes}: {run}");
        }
    }
}
