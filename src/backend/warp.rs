//! How the frame shows a triangle: where, how much blurred by sampling, and how bright what is saturated would be.

use nalgebra::{Matrix3, Point2};

use crate::geometry::warp::warp_jacobian;

/// The warp of one triangle at one pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangleWarp {
    /// 3x3 from chart position (u, v, 1), relative to the chart's origin, to the homogeneous image position in the
    /// frame's level image.
    pub image_from_chart: Matrix3<f64>,
    /// What sampling the frame bilinearly adds to the template: with `f` the fractions of the position, the sum over the axes k = u, v
    /// of `(f[k] (1 - f[k]) - TEMPLATE_BLUR) blur[k] . (d2T/du2, d2T/du dv, d2T/dv2)`.
    pub blur: [[f64; 3]; 2],
    /// What saturated pixels would show beyond the template with its modes and blur: `light[0]` T0 + `light[1]`, grey levels. They
    /// are taken for that bright as far as [`SATURATED_SHARE`] says, and a pixel that lacks a grey level is not counted.
    pub light: [f64; 2],
    /// False leaves the triangle out: its sums are zero.
    pub active: bool,
}

/// Variance (square pixels) of the blur that a template has already: between that of a template of one image and the 1/6 of a mean
/// of many that were sampled bilinearly.
pub const TEMPLATE_BLUR: f64 = 1.0 / 12.0;
/// Grey level from which on a pixel of the frame counts as saturated.
pub const SATURATED: u8 = 254;
/// Share of the bilinear weights from which on a position is as saturated as the pixels around it; below in proportion, so that
/// nothing jumps where a position crosses a pixel.
pub const SATURATED_SHARE: f64 = 0.25;

impl TriangleWarp {
    /// [`Self::light`] below every grey level: what is saturated stays as it is.
    pub const UNKNOWN_LIGHT: [f64; 2] = [0.0, -1e6];

    /// A warp into a frame that is compared with the template as it is.
    pub fn plain(image_from_chart: Matrix3<f64>) -> Self {
        Self { image_from_chart, blur: [[0.0; 3]; 2], light: Self::UNKNOWN_LIGHT, active: true }
    }

    /// The same with the template blurred as the frame is by sampling, for an object whose contrast is 1 + `gain` times the template's:
    /// second differences are turned to the axes of the image by the derivative of the warp at a chart position. Not blurred where that
    /// has no inverse.
    #[must_use]
    pub fn blurred(mut self, at: &Point2<f64>, gain: f64) -> Self {
        let inverse = warp_jacobian(&self.image_from_chart, at).try_inverse();
        if let Some(inverse) = inverse.filter(|m| m.iter().all(|x| x.is_finite())) {
            let half = (1.0 + gain) / 2.0;
            self.blur = [0, 1].map(|axis| {
                let (u, v) = (inverse[(0, axis)], inverse[(1, axis)]);
                [half * u * u, 2.0 * half * u * v, half * v * v]
            });
        }
        self
    }

    /// A triangle that is left out.
    pub fn idle() -> Self {
        Self { active: false, ..Self::plain(Matrix3::zeros()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A template cos(w u) seen turned by 90 degrees and twice as large varies along v of the image with w / 2.
    #[test]
    fn second_differences_are_turned_to_the_axes_of_the_image() {
        let turned = Matrix3::new(0.0, -2.0, 50.0, 2.0, 0.0, 60.0, 0.0, 0.0, 1.0);
        let warp = TriangleWarp::plain(turned).blurred(&Point2::new(10.0, 10.0), 0.5);
        // (1 + gain) / 2 over the square of the scale.
        let expected = [[0.0, 0.0, 0.1875], [0.1875, 0.0, 0.0]];
        for (found, expected) in warp.blur.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((found - expected).abs() < 1e-12, "{:?}", warp.blur);
        }
    }

    #[test]
    fn a_warp_without_an_inverse_is_not_blurred() {
        for flat in [Matrix3::zeros(), Matrix3::from_element(f64::NAN)] {
            let warp = TriangleWarp::plain(flat).blurred(&Point2::origin(), 0.0);
            assert!(warp.blur == [[0.0; 3]; 2], "{:?}", warp.blur);
        }
    }
}
