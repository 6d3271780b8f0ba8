//! Soft-normalised image gradient: where edges are and which way they run, without their contrast.

use image::GrayImage;

/// Gradients of this size (grey levels per pixel) count half of the largest in energy; what is weaker is noise.
pub const SOFTNESS: f32 = 3.0;

/// `(g_u, g_v) / sqrt(g_u^2 + g_v^2 + k^2)` with central differences g and k = [`SOFTNESS`]: light and contrast hardly
/// change it, and no pixel counts more than 1.
pub fn normalise([u, v]: [f32; 2]) -> [f32; 2] {
    let inverse = 1.0 / (u * u + v * v + SOFTNESS * SOFTNESS).sqrt();
    [u * inverse, v * inverse]
}

/// The normalised gradient of an image, 0 on its border.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NormalisedGradient {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// (u, v) of every pixel, row by row.
    pub values: Vec<[f32; 2]>,
}

impl NormalisedGradient {
    /// Of an image.
    pub fn new(image: &GrayImage) -> Self {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut values = vec![[0.0; 2]; width * height];
        let data = image.as_raw();
        for y in 1..height.saturating_sub(1) {
            for x in 1..width.saturating_sub(1) {
                let at = y * width + x;
                let half = |a: u8, b: u8| (f32::from(b) - f32::from(a)) / 2.0;
                values[at] =
                    normalise([half(data[at - 1], data[at + 1]), half(data[at - width], data[at + width])]);
            }
        }
        Self { width, height, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contrast_hardly_matters_and_borders_are_empty() {
        let ramp = |slope: u32| {
            NormalisedGradient::new(&GrayImage::from_fn(6, 5, |x, _| {
                image::Luma([u8::try_from(slope * x).expect("small")])
            }))
        };
        let (weak, strong) = (ramp(20), ramp(40));
        let at = 2 * 6 + 3;
        assert!((weak.values[at][0] - strong.values[at][0]).abs() < 0.01, "{:?}", weak.values[at]);
        assert!(weak.values[at][0] > 0.98 && weak.values[at][1] == 0.0, "along u");
        assert_eq!(weak.values[3], [0.0; 2], "the first row");
        assert_eq!(ramp(0).values[at], [0.0; 2], "no gradient");
    }
}
