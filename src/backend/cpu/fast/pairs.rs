//! An image in which the four neighbours of a position lie side by side.

use image::GrayImage;

use crate::backend::SATURATED;
use crate::imaging::pyramid::downsample_into;

/// The pyramid of a frame as pairs.
#[derive(Debug, Clone, Default)]
pub(crate) struct PairsPyramid {
    levels: Vec<Pairs>,
    /// The images of all levels but the first, which nobody needs after [`Self::rebuild`].
    halves: Vec<GrayImage>,
}

impl PairsPyramid {
    /// Builds `count` levels (at least one) from a full-size image in the memory of the last one.
    pub(crate) fn rebuild(&mut self, image: &GrayImage, count: usize) {
        let count = count.max(1);
        self.levels.resize_with(count, Pairs::default);
        self.halves.resize_with(count - 1, GrayImage::default);
        let mut upper = image;
        self.levels[0].fill(upper);
        for (pairs, half) in self.levels[1..].iter_mut().zip(&mut self.halves) {
            downsample_into(upper, half);
            pairs.fill(half);
            upper = half;
        }
    }

    /// The image of a level.
    pub(crate) fn level(&self, level: usize) -> &Pairs {
        &self.levels[level]
    }

    /// Number of levels; 0 before the first frame.
    pub(crate) fn len(&self) -> usize {
        self.levels.len()
    }
}

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
    fn fill(&mut self, image: &GrayImage) {
        (self.width, self.height) = image.dimensions();
        self.is_saturated = is_saturated(image.as_raw());
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

/// Is any value saturated? Looks at many before it asks whether to go on: only then are they compared in vectors.
fn is_saturated(values: &[u8]) -> bool {
    values.chunks(4096).any(|some| some.iter().fold(0, |highest, value| highest.max(*value)) >= SATURATED)
}
