//! An image in which the four neighbours of a position lie side by side.

use image::GrayImage;

use crate::backend::SATURATED;

/// Rows of vertical pairs: pixel (x, y) is followed by pixel (x, y + 1), so that one load of 4 bytes brings all that
/// bilinear sampling needs.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pairs {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Is any pixel saturated?
    pub(super) is_saturated: bool,
    bytes: Vec<u8>,
}

impl Pairs {
    /// Takes over an image. Keeps its memory.
    pub(crate) fn fill(&mut self, image: &GrayImage) {
        (self.width, self.height) = image.dimensions();
        self.is_saturated = image.iter().any(|value| *value >= SATURATED);
        let stride = self.width as usize;
        let (upper, rest) = (image.as_raw().as_slice(), stride.min(image.as_raw().len()));
        let lower = &upper[rest..];
        self.bytes.resize(2 * lower.len(), 0);
        for ((pair, a), b) in self.bytes.chunks_exact_mut(2).zip(upper).zip(lower) {
            pair.copy_from_slice(&[*a, *b]);
        }
    }

    /// For every index of a pixel (x, y) the bytes (x, y), (x, y + 1), (x + 1, y), (x + 1, y + 1) from the lowest on; 0
    /// outside.
    #[inline(always)]
    pub(super) fn quads(&self, indices: &[u32], quads: &mut [u32]) {
        // A local slice: otherwise its length is read again after every write.
        let bytes = self.bytes.as_slice();
        for (quad, index) in quads.iter_mut().zip(indices) {
            let at = 2 * *index as usize;
            *quad = match bytes.get(at..at + 4) {
                Some(&[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
                _ => 0,
            };
        }
    }
}
