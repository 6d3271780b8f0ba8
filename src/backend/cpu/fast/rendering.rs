//! What makes the template what the frame shows of it: its modes, the blur of sampling, and white where the frame is saturated.

use std::ops::Range;

use fearless_simd::{Simd, prelude::*};

use super::kernel::{Scratch, bilinear, fraction, load, neighbours, splat};
use super::locate::Place;
use super::template::{Block, WIDEST};
use crate::backend::local::LocalWarp;
use crate::backend::{SATURATED, SATURATED_SHARE, TEMPLATE_BLUR};

/// What some modes and, where `BLURRED`, the blur of sampling add to the template, see [`crate::backend::TriangleWarp::blur`].
pub(super) struct Rendering<S: Simd, const MODES: usize, const BLURRED: bool> {
    simd: S,
    /// Number of the first of its modes.
    first: usize,
    lambda: [S::f32s; MODES],
    blur: [[S::f32s; 3]; 2],
    one: S::f32s,
    blurred: S::f32s,
}

impl<S: Simd, const MODES: usize, const BLURRED: bool> Rendering<S, MODES, BLURRED> {
    /// With the parameters of the modes from the `first` one on, and the blur of a warp.
    #[inline(always)]
    pub(super) fn new(simd: S, blur: &[[f32; 3]; 2], first: usize, lambda: [f32; MODES]) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "one twelfth")]
        let [one, blurred] = splat(simd, [1.0, -TEMPLATE_BLUR as f32]);
        let blur = [splat(simd, blur[0]), splat(simd, blur[1])];
        Self { simd, first, lambda: splat(simd, lambda), blur, one, blurred }
    }

    /// The template so far, T0 or what earlier steps made of it, with all of that.
    #[inline(always)]
    pub(super) fn add_to(
        &self,
        so_far: S::f32s,
        block: &Block<'_>,
        (group, at): (usize, &Range<usize>),
        [fu, fv]: [S::f32s; 2],
    ) -> S::f32s {
        let mut sum = so_far;
        let (lambda, modes) = (self.lambda, block.modes::<MODES>(group, self.first));
        for k in 0..MODES {
            sum = lambda[k].mul_add(load(self.simd, &modes[k], at), sum);
        }
        if BLURRED {
            let packed = S::i32s::from_slice(self.simd, &block.curvatures[group].0[at.clone()]);
            let uu: S::f32s = ((packed << 21) >> 21).to_float();
            let vv: S::f32s = ((packed << 10) >> 21).to_float();
            let uv: S::f32s = (packed >> 22).to_float();
            let [by_u, by_v] = self.blur;
            let along_u = by_u[0].mul_add(uu, by_u[1].mul_add(uv, by_u[2] * vv));
            let along_v = by_v[0].mul_add(uu, by_v[1].mul_add(uv, by_v[2] * vv));
            sum = fu.mul_add(self.one - fu, self.blurred).mul_add(along_u, sum);
            sum = fv.mul_add(self.one - fv, self.blurred).mul_add(along_v, sum);
        }
        sum
    }

    /// Adds all of that to the template of a block.
    #[inline(always)]
    pub(super) fn store(&self, block: &Block<'_>, is_mean: bool, scratch: &mut Scratch) {
        for group in block.groups() {
            for i in (0..WIDEST).step_by(S::f32s::LEN) {
                let at = i..i + S::f32s::LEN;
                let before = if is_mean { &block.texels[group][2] } else { &scratch.template[group] };
                let (so_far, fraction) =
                    (load(self.simd, before, &at), fraction(self.simd, scratch, group, &at));
                let template = self.add_to(so_far, block, (group, &at), fraction);
                template.store_slice(&mut scratch.template[group].0[at]);
            }
        }
    }
}

/// T0 + sum lambda_k T_k, up to eight modes at a time; without modes T0 is used where it is.
#[inline(always)]
pub(super) fn blend<S: Simd>(simd: S, block: &Block<'_>, appearance: &[f32], scratch: &mut Scratch) {
    let mut first = 0;
    while first < appearance.len() {
        first += match appearance[first..] {
            [a, b, c, d, e, f, g, h, ..] => blend_some(simd, block, first, [a, b, c, d, e, f, g, h], scratch),
            [a, b, c, d, ..] => blend_some(simd, block, first, [a, b, c, d], scratch),
            [a, b, ..] => blend_some(simd, block, first, [a, b], scratch),
            [a, ..] => blend_some(simd, block, first, [a], scratch),
            [] => return,
        };
    }
}

/// Returns how many.
#[inline(always)]
fn blend_some<S: Simd, const MODES: usize>(
    simd: S,
    block: &Block<'_>,
    first: usize,
    lambda: [f32; MODES],
    scratch: &mut Scratch,
) -> usize {
    Rendering::<S, MODES, false>::new(simd, &[[0.0; 3]; 2], first, lambda).store(block, first == 0, scratch);
    MODES
}

/// Takes off the template by how much saturated pixels would be brighter, see [`crate::backend::TriangleWarp::light`]. Returns how many
/// pixels do not count.
#[inline(always)]
pub(super) fn unsaturate<S: Simd, P: Place>(
    simd: S,
    block: &Block<'_>,
    is_mean: bool,
    warp: &LocalWarp,
    scratch: &mut Scratch,
) -> f64 {
    #[expect(clippy::cast_possible_truncation, reason = "one quarter")]
    let per_share = 1.0 / SATURATED_SHARE as f32;
    let [gain, bias, limit, per_share] =
        splat(simd, [warp.light[0], warp.light[1], f32::from(SATURATED), per_share]);
    let [zero, one] = splat(simd, [0.0, 1.0]);
    let mut uncounted = zero;
    for group in block.groups() {
        let [_, _, mean, weight] = &block.texels[group];
        for i in (0..WIDEST).step_by(S::f32s::LEN) {
            let at = i..i + S::f32s::LEN;
            let fraction = fraction(simd, scratch, group, &at);
            let around = neighbours(simd, scratch, group, &at);
            let mut white = [zero; 4];
            for k in 0..4 {
                white[k] = around[k].simd_ge(limit).select(one, zero);
            }
            let so_far = load(simd, if is_mean { mean } else { &scratch.template[group] }, &at);
            let lit = gain.mul_add(load(simd, mean, &at), so_far + bias);
            let share = (bilinear(fraction, white) * per_share).min(one);
            let missing = share * (lit - bilinear(fraction, around)).max(zero);
            // Nor does padding, which has no weight.
            let counted = load(simd, weight, &at).simd_gt(zero).select(missing.min(one), zero);
            uncounted += if P::INSIDE { counted } else { counted * load(simd, &scratch.inside[group], &at) };
            (so_far - missing).store_slice(&mut scratch.template[group].0[at]);
        }
    }
    f64::from(uncounted.reduce_sum())
}
