//! Bilinear sampling, written out so that CPU and GPU do the same arithmetic.

use image::GrayImage;

/// The four pixels around a position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Grey values: upper left, upper right, lower left, lower right.
    pub values: [f64; 4],
    /// Fractions of the position along u and v, 0..1: how far it is from the upper left pixel.
    pub fraction: [f64; 2],
}

impl Patch {
    /// The pixels around (u, v); `None` where one of them is outside (0 <= u < width-1, 0 <= v < height-1).
    pub fn at(image: &GrayImage, u: f64, v: f64) -> Option<Self> {
        let (w, h) = image.dimensions();
        let inside = u >= 0.0 && v >= 0.0 && u < f64::from(w) - 1.0 && v < f64::from(h) - 1.0;
        inside.then(|| {
            let (u0, v0) = (u.floor(), v.floor());
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "inside the image, checked above"
            )]
            let at = v0 as usize * w as usize + u0 as usize;
            let (data, w) = (image.as_raw(), w as usize);
            let values = [at, at + 1, at + w, at + w + 1].map(|k| f64::from(data[k]));
            Self { values, fraction: [u - u0, v - v0] }
        })
    }

    /// Bilinear grey value.
    pub fn value(&self) -> f64 {
        self.blend(self.values)
    }

    /// Bilinear mean of numbers of the four pixels.
    pub fn blend(&self, [a, b, c, d]: [f64; 4]) -> f64 {
        let [fu, fv] = self.fraction;
        let (top, bottom) = (a + fu * (b - a), c + fu * (d - c));
        top + fv * (bottom - top)
    }

    /// Derivative of the value by u and v, grey levels per pixel: with values a b over c d du = (1 - fv)(b - a) + fv (d - c)
    /// and dv = (1 - fu)(c - a) + fu (d - b).
    pub fn gradient(&self) -> [f64; 2] {
        let ([a, b, c, d], [fu, fv]) = (self.values, self.fraction);
        let (top, bottom) = (a + fu * (b - a), c + fu * (d - c));
        [(b - a) + fv * ((d - c) - (b - a)), bottom - top]
    }
}

/// Grey value at (u, v), bilinear; `None` where a needed pixel is outside (0 <= u < width-1, 0 <= v < height-1).
pub fn bilinear(image: &GrayImage, u: f64, v: f64) -> Option<f64> {
    Patch::at(image, u, v).map(|patch| patch.value())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> GrayImage {
        GrayImage::from_fn(8, 6, |x, y| image::Luma([u8::try_from(10 * x + 3 * y).expect("small")]))
    }

    #[test]
    fn a_ramp_is_reproduced() {
        for (u, v) in [(0.0, 0.0), (3.25, 2.5), (6.999, 4.999)] {
            let value = bilinear(&ramp(), u, v).expect("inside");
            assert!((value - (10.0 * u + 3.0 * v)).abs() < 1e-9, "({u}, {v}) gave {value}");
        }
    }

    #[test]
    fn the_gradient_is_the_derivative_of_the_value() {
        let image =
            GrayImage::from_fn(8, 6, |x, y| image::Luma([u8::try_from(7 * x * y % 50).expect("small")]));
        let h = 1e-6;
        for (u, v) in [(0.3, 0.6), (3.25, 2.5), (5.9, 4.1)] {
            let value = |u, v| bilinear(&image, u, v).expect("inside");
            let patch = Patch::at(&image, u, v).expect("inside");
            let (same, gradient) = (patch.value(), patch.gradient());
            let expected = [value(u + h, v) - value(u - h, v), value(u, v + h) - value(u, v - h)];
            assert!((same - value(u, v)).abs() < 1e-12, "({u}, {v}) gave {same}");
            for (g, e) in gradient.iter().zip(expected) {
                assert!((g - e / (2.0 * h)).abs() < 1e-6, "({u}, {v}): {g} is not {}", e / (2.0 * h));
            }
        }
    }

    #[test]
    fn outside_is_none() {
        for (u, v) in [(-1e-9, 1.0), (7.0, 1.0), (1.0, 5.0), (f64::NAN, 1.0), (1.0, f64::NAN), (1e20, 0.0)] {
            assert!(bilinear(&ramp(), u, v).is_none(), "({u}, {v}) must be outside");
        }
    }
}
