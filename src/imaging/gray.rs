//! Reading and writing 8-bit grey images.

use std::path::Path;

pub use image::GrayImage;

use crate::error::{Error, Result};

/// Reads any image the `image` crate knows as 8-bit grey (Rec. 709 luma for colour files).
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, [`Error::Image`] if it is not an image.
pub fn read(path: &Path) -> Result<GrayImage> {
    let reader = image::ImageReader::open(path)
        .and_then(image::ImageReader::with_guessed_format)
        .map_err(|e| Error::io(path, e))?;
    let decoded = reader.decode().map_err(|source| Error::Image { path: path.to_owned(), source })?;
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
