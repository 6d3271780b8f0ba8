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

/// Pairs of pixels that a chart can be looked up in without asking for every pixel whether it is there.
const WINDOW: usize = 1 << 16;

/// Rows of vertical pairs: pixel (x, y) in the low byte and pixel (x, y + 1) in the high one, so that two neighbours hold all that
/// bilinear sampling needs.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pairs {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Is any pixel saturated?
    pub(super) is_saturated: bool,
    /// Of all rows but the last; what fills it up to a whole window means nothing.
    pairs: Vec<u16>,
}

impl Pairs {
    /// Takes over an image. Keeps its memory.
    fn fill(&mut self, image: &GrayImage) {
        (self.width, self.height) = image.dimensions();
        self.is_saturated = is_saturated(image.as_raw());
        let stride = self.width as usize;
        let (upper, rest) = (image.as_raw().as_slice(), stride.min(image.as_raw().len()));
        let lower = &upper[rest..];
        self.pairs.resize(lower.len().max(WINDOW + 1), 0);
        for ((pair, a), b) in self.pairs.iter_mut().zip(upper).zip(lower) {
            *pair = u16::from_le_bytes([*a, *b]);
        }
    }

    /// Rows before and after one that are in its window; charts that are higher in the image, as in those of 1920 columns some are, go
    /// without.
    #[inline(always)]
    pub(super) fn window_reach(&self) -> Option<f32> {
        let rows = WINDOW.checked_div(self.width as usize)?.checked_sub(1)?;
        #[expect(clippy::cast_precision_loss, reason = "at most 2^16")]
        let reach = (rows / 2) as f32;
        Some(reach)
    }

    /// The window of a row (a whole number).
    #[inline(always)]
    pub(super) fn window(&self, row: f32, reach: f32) -> Option<Window<'_>> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a row of an image, not negative"
        )]
        let first = (row - reach).max(0.0) as usize;
        let start = first.saturating_mul(self.width as usize).min(self.pairs.len().checked_sub(WINDOW + 1)?);
        Some(Window { start, pairs: self.pairs[start..].first_chunk()?, image: self })
    }

    /// For every index of a pixel (x, y) the bytes (x, y), (x, y + 1), (x + 1, y), (x + 1, y + 1) from the lowest on; 0
    /// outside.
    #[inline(always)]
    pub(super) fn quads(&self, indices: &[u32], quads: &mut [u32]) {
        // A local slice: otherwise its length is read again after every write.
        let pairs = self.pairs.as_slice();
        for (quad, index) in quads.iter_mut().zip(indices) {
            let at = *index as usize;
            *quad = match pairs.get(at..at + 2) {
                Some(&[left, right]) => u32::from(left) | u32::from(right) << 16,
                _ => 0,
            };
        }
    }
}

/// A run of pairs whose indices have 16 bits, so that none is outside.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window<'a> {
    /// Index of its first pair in the image.
    pub(super) start: usize,
    pairs: &'a [u16; WINDOW + 1],
    pub(super) image: &'a Pairs,
}

impl Window<'_> {
    /// As [`Pairs::quads`], by indices from the start of the window.
    #[inline(always)]
    pub(super) fn quads(&self, indices: &[u32], quads: &mut [u32]) {
        for (quad, index) in quads.iter_mut().zip(indices) {
            #[expect(clippy::cast_possible_truncation, reason = "what the window leaves no other values for")]
            let at = usize::from(*index as u16);
            *quad = u32::from(self.pairs[at]) | u32::from(self.pairs[at + 1]) << 16;
        }
    }
}

/// Is any value saturated? Looks at many before it asks whether to go on: only then are they compared in vectors.
fn is_saturated(values: &[u8]) -> bool {
    values.chunks(4096).any(|some| some.iter().fold(0, |highest, value| highest.max(*value)) >= SATURATED)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All positions of all windows, after a larger frame in the same memory.
    #[test]
    fn windows_show_what_the_image_does() {
        let mut pairs = Pairs::default();
        for (width, height) in [(700, 300), (1, 1), (2, 2), (319, 241), (9000, 12), (40_000, 3)] {
            let byte = |x: u32, y: u32| (x.wrapping_mul(31) ^ y.wrapping_mul(57)).to_le_bytes()[0];
            let image = GrayImage::from_fn(width, height, |x, y| image::Luma([byte(x, y)]));
            pairs.fill(&image);
            let reach = pairs.window_reach().expect("narrow enough");
            for row in 0..height.saturating_sub(1) {
                #[expect(
                    clippy::cast_precision_loss,
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "small"
                )]
                let (window, rows) = (pairs.window(row as f32, reach).expect("a window"), reach as u32);
                let start = u32::try_from(window.start).expect("small");
                for y in row.saturating_sub(rows)..(row + rows + 1).min(height - 1) {
                    let corners = (0..width - 1).map(|x| (x, y));
                    let indices: Vec<u32> = corners.clone().map(|(x, y)| y * width + x - start).collect();
                    let mut quads = vec![0; indices.len()];
                    window.quads(&indices, &mut quads);
                    let expected = |(x, y)| {
                        u32::from_le_bytes([byte(x, y), byte(x, y + 1), byte(x + 1, y), byte(x + 1, y + 1)])
                    };
                    assert!(quads.into_iter().eq(corners.map(expected)), "{width}x{height}, row {row}, {y}");
                }
            }
        }
    }

    #[test]
    fn one_saturated_pixel_is_seen_wherever_it_is() {
        for at in [0, 4095, 4096, 9999] {
            let mut values = vec![SATURATED - 1; 10_000];
            assert!(!is_saturated(&values), "none is");
            values[at] = SATURATED;
            assert!(is_saturated(&values), "pixel {at}");
        }
    }
}
