//! Steps over a block that make the template what the frame shows of it: blurred by sampling, and white where it is saturated.

use fearless_simd::{Simd, prelude::*};

use super::kernel::{Scratch, bilinear, load, neighbours, splat};
use super::template::Block;
use crate::backend::local::LocalWarp;
use crate::backend::{SATURATED, SATURATED_SHARE, TEMPLATE_BLUR};

/// The template so far: T0 where it is, or what earlier steps made of it.
#[inline(always)]
fn template<'a>(block: &Block<'a>, is_mean: bool, scratch: &'a Scratch) -> &'a [f32] {
    if is_mean { block.texels[2] } else { &scratch.template[..block.positions.len()] }
}

/// Adds what sampling does to the template, see [`crate::backend::TriangleWarp::blur`].
#[inline(always)]
pub(super) fn blur<S: Simd>(
    simd: S,
    block: &Block<'_>,
    is_mean: bool,
    warp: &LocalWarp,
    scratch: &mut Scratch,
) {
    let [by_u, by_v] = [splat(simd, warp.blur[0]), splat(simd, warp.blur[1])];
    #[expect(clippy::cast_possible_truncation, reason = "one twelfth")]
    let [one, blurred] = splat(simd, [1.0, -TEMPLATE_BLUR as f32]);
    for i in (0..block.positions.len()).step_by(S::f32s::LEN) {
        let at = i..i + S::f32s::LEN;
        let packed = S::i32s::from_slice(simd, &block.curvatures[at.clone()]);
        let uu: S::f32s = ((packed << 21) >> 21).to_float();
        let vv: S::f32s = ((packed << 10) >> 21).to_float();
        let uv: S::f32s = (packed >> 22).to_float();
        let [fu, fv] = [load(simd, &scratch.fraction[0], &at), load(simd, &scratch.fraction[1], &at)];
        let along_u = by_u[0].mul_add(uu, by_u[1].mul_add(uv, by_u[2] * vv));
        let along_v = by_v[0].mul_add(uu, by_v[1].mul_add(uv, by_v[2] * vv));
        let so_far = load(simd, template(block, is_mean, scratch), &at);
        let with_u = fu.mul_add(one - fu, blurred).mul_add(along_u, so_far);
        fv.mul_add(one - fv, blurred).mul_add(along_v, with_u).store_slice(&mut scratch.template[at]);
    }
}

/// Takes off the template by how much saturated pixels would be brighter, see [`crate::backend::TriangleWarp::light`]. Returns how many
/// pixels do not count.
#[inline(always)]
pub(super) fn unsaturate<S: Simd, const INSIDE: bool>(
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
    for i in (0..block.positions.len()).step_by(S::f32s::LEN) {
        let at = i..i + S::f32s::LEN;
        let fraction = [load(simd, &scratch.fraction[0], &at), load(simd, &scratch.fraction[1], &at)];
        let around = neighbours(simd, scratch, at.clone());
        let mut white = [zero; 4];
        for k in 0..4 {
            white[k] = around[k].simd_ge(limit).select(one, zero);
        }
        let so_far = load(simd, template(block, is_mean, scratch), &at);
        let lit = gain.mul_add(load(simd, block.texels[2], &at), so_far + bias);
        let share = (bilinear(fraction, white) * per_share).min(one);
        let missing = share * (lit - bilinear(fraction, around)).max(zero);
        // Nor does padding, which has no weight.
        let counted = load(simd, block.texels[3], &at).simd_gt(zero).select(missing.min(one), zero);
        uncounted += if INSIDE { counted } else { counted * load(simd, &scratch.inside, &at) };
        (so_far - missing).store_slice(&mut scratch.template[at]);
    }
    f64::from(uncounted.reduce_sum())
}
