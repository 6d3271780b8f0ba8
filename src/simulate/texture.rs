//! Grey bitmaps on surfaces and behind them.

use image::GrayImage;

use crate::error::{Error, Result};

/// A grey bitmap with texel centres at integers.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    width: usize,
    limit: [f64; 2],
    data: Vec<u8>,
}

impl Texture {
    /// From rows of grey values; at least 2x2 texels.
    pub(super) fn new(width: usize, data: Vec<u8>) -> Self {
        let height = data.len() / width;
        assert!(width >= 2 && height >= 2 && data.len() == width * height, "a texture is at least 2x2");
        // A hair below the last texel, so that the upper neighbour always exists.
        Self { width, limit: [(width - 1) as f64 - 1e-9, (height - 1) as f64 - 1e-9], data }
    }

    /// Uses an image as a texture, one texel per pixel.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an image below 2x2 pixels.
    pub fn from_image(image: &GrayImage) -> Result<Self> {
        let (width, height) = image.dimensions();
        if width < 2 || height < 2 {
            let problem = format!("{width}x{height} pixels are too few");
            return Err(Error::invalid("texture", problem, "give an image of at least 2x2 pixels"));
        }
        Ok(Self::new(width as usize, image.as_raw().clone()))
    }

    /// Width and height, texels.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.data.len() / self.width]
    }

    /// All grey values, row by row.
    pub fn texels(&self) -> &[u8] {
        &self.data
    }

    /// Grey value at (s, t) texels, bilinear, the border continued outside.
    #[inline]
    pub fn sample(&self, s: f64, t: f64) -> f64 {
        let (s, t) = (s.max(0.0).min(self.limit[0]), t.max(0.0).min(self.limit[1]));
        #[expect(clippy::cast_possible_truncation, reason = "clamped to the bitmap")]
        let (i, j) = (s as usize, t as usize);
        let (fs, ft) = (s - i as f64, t - j as f64);
        let at = j * self.width + i;
        let (upper, lower) = (&self.data[at..at + 2], &self.data[at + self.width..at + self.width + 2]);
        let top = f64::from(upper[0]) * (1.0 - fs) + f64::from(upper[1]) * fs;
        let bottom = f64::from(lower[0]) * (1.0 - fs) + f64::from(lower[1]) * fs;
        top * (1.0 - ft) + bottom * ft
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_become_textures_unless_too_small() {
        let image = GrayImage::from_raw(2, 2, vec![1, 2, 3, 4]).expect("four bytes");
        assert_eq!(Texture::from_image(&image).expect("2x2").texels(), [1, 2, 3, 4], "texels");
        assert!(Texture::from_image(&GrayImage::new(1, 5)).is_err(), "one column");
    }

    #[test]
    fn bilinear_inside_and_clamped_outside() {
        let texture = Texture::new(3, vec![0, 10, 20, 30, 40, 50]);
        assert!((texture.sample(0.5, 0.5) - 20.0).abs() < 1e-12, "{}", texture.sample(0.5, 0.5));
        assert!((texture.sample(9.0, 9.0) - 50.0).abs() < 1e-6, "{}", texture.sample(9.0, 9.0));
        assert!(texture.sample(-4.0, f64::NAN).abs() < 1e-12, "{}", texture.sample(-4.0, f64::NAN));
    }
}
