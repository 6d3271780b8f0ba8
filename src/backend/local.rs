//! Charts seen from their own middle: what lets f32 hold positions and warps without losing anything.

use nalgebra::{Vector2, Vector3};

use super::TriangleWarp;
use crate::model::curvature::{Curvature, MIXED_STEP, STRAIGHT_STEP};
use crate::model::{Chart, LevelTemplate};

/// The warp of one triangle in f32: (u, v, 1) relative to the chart's centre to the homogeneous image position
/// relative to an integer base pixel near the warped centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LocalWarp {
    /// Rows of the homography.
    pub(super) rows: [[f32; 3]; 3],
    /// The base pixel, whole numbers.
    pub(super) base: [f32; 2],
    /// [`TriangleWarp::blur`] for curvatures in their steps.
    pub(super) blur: [[f32; 3]; 2],
    /// [`TriangleWarp::light`].
    pub(super) light: [f32; 2],
}

impl LocalWarp {
    /// Is the template blurred as the frame is?
    pub(super) fn is_blurred(&self) -> bool {
        self.blur != [[0.0; 3]; 2]
    }

    /// Both shifts are made in f64, so that f32 holds only distances within the chart.
    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "pixels are summed in f32")]
    pub(super) fn new(warp: &TriangleWarp, centre: Vector2<f64>) -> Self {
        /// Largest base, pixels: f32 holds it and its neighbours exactly.
        const LIMIT: f64 = 4_194_304.0;
        let mut h = warp.image_from_chart;
        let at = h * Vector3::new(centre.x, centre.y, 1.0);
        h.set_column(2, &at);
        let near = |x: f64| Some((x / at.z).floor()).filter(|b| b.abs() <= LIMIT).unwrap_or(0.0);
        let base = [near(at.x), near(at.y), 0.0];
        // Loops instead of `map`, which is not always inlined.
        let mut rows = [[0.0; 3]; 3];
        let mut blur = [[0.0; 3]; 2];
        let steps = [STRAIGHT_STEP, MIXED_STEP, STRAIGHT_STEP];
        for j in 0..3 {
            for i in 0..3 {
                rows[i][j] = (h[(i, j)] - base[i] * h[(2, j)]) as f32;
            }
            blur[0][j] = warp.blur[0][j] as f32 * steps[j];
            blur[1][j] = warp.blur[1][j] as f32 * steps[j];
        }
        let light = [warp.light[0] as f32, warp.light[1] as f32];
        Self { rows, base: [base[0] as f32, base[1] as f32], blur, light }
    }
}

/// A pixel in the middle of a chart, relative to the chart's origin.
pub(super) fn centre(template: &LevelTemplate, chart: &Chart) -> Vector2<f64> {
    let positions = &template.pixels.position[chart.range()];
    let first = positions.first().copied().unwrap_or_default();
    let (lo, hi) = positions.iter().fold((first, first), |(lo, hi), p| {
        ([lo[0].min(p[0]), lo[1].min(p[1])], [hi[0].max(p[0]), hi[1].max(p[1])])
    });
    let [u, v] = [0, 1].map(|k| f64::from(hi[k] - (hi[k] - lo[k]) / 2));
    Vector2::new(u, v)
}

/// A position relative to the chart's centre as two signed 16-bit numbers, u in the low half.
pub(super) fn pack(position: [u16; 2], centre: Vector2<f64>) -> u32 {
    let shifted = [f64::from(position[0]) - centre.x, f64::from(position[1]) - centre.y];
    #[expect(clippy::cast_possible_truncation, reason = "the centre is in the middle of a u16 range")]
    let [u, v] = shifted.map(|x| u32::from((x as i16).cast_unsigned()));
    u | v << 16
}

/// A curvature as three signed numbers of steps: d2T/du2 in the lowest 11 bits, d2T/dv2 in the next 11, d2T/du dv in the upper 10.
pub(super) fn pack_curvature([uu, uv, vv]: Curvature) -> u32 {
    #[expect(clippy::cast_possible_truncation, reason = "whole numbers, as the model rounds them")]
    let number = |x: f32, step: f32| ((x / step) as i32).cast_unsigned();
    let straight = |x: f32| number(x, STRAIGHT_STEP) & 0x7ff;
    straight(uu) | straight(vv) << 11 | number(uv, MIXED_STEP) << 22
}

/// Moves sums of x (u, v, 1), any number of such triples, from the chart's centre to its origin.
pub(super) fn to_origin(sums: &mut [f64], centre: Vector2<f64>) {
    for slope in sums.chunks_exact_mut(3) {
        slope[0] += centre.x * slope[2];
        slope[1] += centre.y * slope[2];
    }
}

/// [`to_origin`] for sums of x (u^2, u v, u, v^2, v, 1).
pub(super) fn second_to_origin(sums: &mut [f64], c: Vector2<f64>) {
    for sums in sums.chunks_exact_mut(6) {
        let [uu, uv, u, vv, v, one] = [0, 1, 2, 3, 4, 5].map(|k| sums[k]);
        sums[0] = uu + 2.0 * c.x * u + c.x * c.x * one;
        sums[1] = uv + c.x * v + c.y * u + c.x * c.y * one;
        sums[2] = u + c.x * one;
        sums[3] = vv + 2.0 * c.y * v + c.y * c.y * one;
        sums[4] = v + c.y * one;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curvatures_come_back_from_their_bits() {
        for curvature in [[0.0; 3], [-510.0, 127.5, 510.0], [509.5, -127.75, -0.5], [0.5, 0.25, -510.0]] {
            let packed = pack_curvature(curvature).cast_signed();
            let back = [(packed << 21) >> 21, packed >> 22, (packed << 10) >> 21];
            let steps = [STRAIGHT_STEP, MIXED_STEP, STRAIGHT_STEP];
            #[expect(clippy::cast_precision_loss, reason = "a few bits")]
            let back = [0, 1, 2].map(|k| back[k] as f32 * steps[k]);
            assert_eq!(back, curvature, "{packed:#x}");
        }
    }
}
