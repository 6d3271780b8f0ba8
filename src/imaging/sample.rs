//! Bilinear sampling, written out so that CPU and GPU do the same arithmetic.

use image::GrayImage;

/// Grey value at (u, v), bilinear; `None` where a needed pixel is outside (0 <= u < width-1, 0 <= v < height-1).
pub fn bilinear(image: &GrayImage, u: f64, v: f64) -> Option<f64> {
    bilinear_with_gradient(image, u, v).map(|(value, _)| value)
}

/// [`bilinear`] and its derivative by u and v, grey levels per pixel: with values a b over c d and the fractions
/// (fu, fv), du = (1 - fv)(b - a) + fv (d - c) and dv = (1 - fu)(c - a) + fu (d - b).
pub fn bilinear_with_gradient(image: &GrayImage, u: f64, v: f64) -> Option<(f64, [f64; 2])> {
    let (w, h) = image.dimensions();
    let inside = u >= 0.0 && v >= 0.0 && u < f64::from(w) - 1.0 && v < f64::from(h) - 1.0;
    inside.then(|| {
        let (u0, v0) = (u.floor(), v.floor());
        let (fu, fv) = (u - u0, v - v0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "inside the image, checked above"
        )]
        let at = v0 as usize * w as usize + u0 as usize;
        let data = image.as_raw();
        let [a, b] = [f64::from(data[at]), f64::from(data[at + 1])];
        let [c, d] = [f64::from(data[at + w as usize]), f64::from(data[at + w as usize + 1])];
        let (top, bottom) = (a + fu * (b - a), c + fu * (d - c));
        (top + fv * (bottom - top), [(b - a) + fv * ((d - c) - (b - a)), bottom - top])
    })
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
            let (same, gradient) = bilinear_with_gradient(&image, u, v).expect("inside");
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
            assert!(bilinear_with_gradient(&ramp(), u, v).is_none(), "({u}, {v}) must be outside");
        }
    }
}
