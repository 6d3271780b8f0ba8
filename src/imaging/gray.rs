//! Reading and writing 8-bit grey images.

use std::path::Path;

pub use image::GrayImage;

use crate::error::{Error, Result};

/// Reads any image of 8 bits per channel that the `image` crate knows as grey (Rec. 709 luma for colour files).
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, [`Error::Image`] if it is not an image, [`Error::Field`] if it has more bits per channel:
/// only who took it knows which of them are in use, and the upper eight of twelve would be next to black.
pub fn read(path: &Path) -> Result<GrayImage> {
    let reader = image::ImageReader::open(path)
        .and_then(image::ImageReader::with_guessed_format)
        .map_err(|e| Error::io(path, e))?;
    let decoded = reader.decode().map_err(|source| Error::Image { path: path.to_owned(), source })?;
    let colour = decoded.color();
    let bits = colour.bits_per_pixel() / u16::from(colour.channel_count());
    if bits > 8 {
        let remedy = "convert it to 8 bits, scaled so that its brightest pixels are near 255";
        return Err(Error::field(path, "pixels", format!("{bits} bits per channel, 8 are read"), remedy));
    }
    Ok(decoded.into_luma8())
}

/// Width and height of an image file in pixels, from its header alone.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, [`Error::Image`] if it is not an image.
pub fn dimensions(path: &Path) -> Result<(u32, u32)> {
    let reader = image::ImageReader::open(path)
        .and_then(image::ImageReader::with_guessed_format)
        .map_err(|e| Error::io(path, e))?;
    reader.into_dimensions().map_err(|source| Error::Image { path: path.to_owned(), source })
}

/// Reads an image and checks its size against the calibration.
///
/// # Errors
/// As [`read`], and [`Error::Field`] if the size differs.
pub fn read_sized(path: &Path, width: u32, height: u32) -> Result<GrayImage> {
    let image = read(path)?;
    if image.dimensions() != (width, height) {
        let problem =
            format!("{}x{}, but the calibration says {width}x{height}", image.width(), image.height());
        return Err(Error::field(
            path,
            "image size",
            problem,
            "give images and calibration of the same camera",
        ));
    }
    Ok(image)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_eight_bits_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("deep.png");
        image::ImageBuffer::from_pixel(4, 3, image::Luma([4095_u16])).save(&path).expect("a file");
        let problem = read(&path).expect_err("twelve bits in use").to_string();
        assert!(problem.contains("deep.png") && problem.contains("16 bits"), "{problem}");
        image::ImageBuffer::from_pixel(4, 3, image::Rgb([200_u8, 200, 200])).save(&path).expect("a file");
        assert_eq!(read(&path).expect("colour of 8 bits").get_pixel(3, 2).0, [200], "its luma");
    }
}
