//! Images in which the four neighbours of a position lie side by side.

use image::GrayImage;

use crate::backend::SATURATED;
use crate::imaging::pyramid::downsample_into;

/// Pairs of pixels that a chart can be looked up in without asking for every pixel whether it is there.
const WINDOW: usize = 1 << 17;
/// Numbers of pixels below this are exact in f32.
const EXACT: u32 = 1 << 24;

/// The pyramid of a frame as rows of vertical pairs: pixel (x, y) in the low byte and pixel (x, y + 1) in the high one, so that two
/// neighbours hold all that bilinear sampling needs.
#[derive(Debug, Clone, Default)]
pub(crate) struct PairsPyramid {
    levels: Vec<Level>,
    /// Of all levels, one after the other; what fills them up to a whole window means nothing.
    pairs: Vec<u16>,
    /// The images of all levels but the first, which nobody needs after [`Self::rebuild`].
    halves: Vec<GrayImage>,
}

/// An image of the pyramid.
#[derive(Debug, Clone, Copy)]
struct Level {
    width: u32,
    height: u32,
    is_saturated: bool,
    /// Index of its first pair.
    first: usize,
}

impl PairsPyramid {
    /// Builds `count` levels (at least one) from a full-size image in the memory of the last one.
    pub(crate) fn rebuild(&mut self, image: &GrayImage, count: usize) {
        let Self { levels, pairs, halves } = self;
        halves.resize_with(count.max(1) - 1, GrayImage::default);
        let mut upper = image;
        for half in halves.iter_mut() {
            downsample_into(upper, half);
            upper = half;
        }
        let images = std::iter::once(image).chain(&*halves);
        let mut end = 0;
        levels.clear();
        levels.extend(images.clone().map(|image| {
            let ((width, height), first) = (image.dimensions(), end);
            end += lower_rows(image).len();
            Level { width, height, is_saturated: is_saturated(image.as_raw()), first }
        }));
        pairs.resize(end.max(WINDOW + 1), 0);
        for (level, image) in levels.iter().zip(images) {
            let rows = image.as_raw().iter().zip(lower_rows(image));
            for (pair, (a, b)) in pairs[level.first..].iter_mut().zip(rows) {
                *pair = u16::from_le_bytes([*a, *b]);
            }
        }
    }

    /// The image of a level.
    pub(crate) fn level(&self, level: usize) -> Pairs<'_> {
        let Level { width, height, is_saturated, first } = self.levels[level];
        let count = width as usize * height.saturating_sub(1) as usize;
        Pairs { width, height, is_saturated, pairs: &self.pairs[first..][..count], first, all: &self.pairs }
    }

    /// Number of levels; 0 before the first frame.
    pub(crate) fn len(&self) -> usize {
        self.levels.len()
    }
}

/// All rows of an image but the first.
fn lower_rows(image: &GrayImage) -> &[u8] {
    let values = image.as_raw();
    &values[values.len().min(image.width() as usize)..]
}

/// One level of a [`PairsPyramid`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pairs<'a> {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Is any pixel saturated?
    pub(super) is_saturated: bool,
    /// Of all rows but the last.
    pairs: &'a [u16],
    /// Where they are among those of all levels.
    first: usize,
    all: &'a [u16],
}

impl<'a> Pairs<'a> {
    /// How many rows above and below a row its window holds; `None` if not one, or if indices are not exact in f32. Higher charts go
    /// without: of an image with 3840 columns many do.
    #[inline(always)]
    pub(super) fn window_reach(&self) -> Option<f32> {
        let rows = WINDOW.checked_div(self.width as usize)?.checked_sub(1)? / 2;
        #[expect(clippy::cast_precision_loss, reason = "at most 2^16")]
        let reach = rows as f32;
        (rows > 0 && self.width.saturating_mul(self.height) < EXACT).then_some(reach)
    }

    /// The window of a row, a whole number; `reach` is that of the image.
    #[inline(always)]
    pub(super) fn window(&self, row: f32, reach: f32) -> Option<Window<'a>> {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a row of an image, not negative"
        )]
        let top = (row - reach).max(0.0) as usize;
        // Where all ends sooner, the window reaches up further, if need be into the level before.
        let start = (self.first + top * self.width as usize).min(self.all.len().checked_sub(WINDOW + 1)?);
        #[expect(clippy::cast_precision_loss, reason = "fewer pixels than are exact")]
        let [start_in_all, first] = [start as f32, self.first as f32];
        let pairs = self.all[start..].first_chunk()?;
        Some(Window {
            width: self.width,
            is_saturated: self.is_saturated,
            start: start_in_all - first,
            pairs,
        })
    }

    /// For every index of a pixel (x, y) the bytes (x, y), (x, y + 1), (x + 1, y), (x + 1, y + 1) from the lowest on; 0
    /// outside.
    #[inline(always)]
    pub(super) fn quads(&self, indices: &[u32], quads: &mut [u32]) {
        for (quad, index) in quads.iter_mut().zip(indices) {
            let at = *index as usize;
            *quad = match self.pairs.get(at..at + 2) {
                Some(&[left, right]) => u32::from(left) | u32::from(right) << 16,
                _ => 0,
            };
        }
    }
}

/// A run of so many pairs that an index with the bits of one in it is never outside.
#[derive(Debug, Clone, Copy)]
pub(super) struct Window<'a> {
    /// Of the image.
    pub(super) width: u32,
    /// Is any pixel of the image saturated?
    pub(super) is_saturated: bool,
    /// Index of its first pair, counted from the image's first.
    pub(super) start: f32,
    pairs: &'a [u16; WINDOW + 1],
}

impl Window<'_> {
    /// As [`Pairs::quads`], by indices from the start of the window.
    #[inline(always)]
    pub(super) fn quads(&self, indices: &[u32], quads: &mut [u32]) {
        for (quad, index) in quads.iter_mut().zip(indices) {
            let at = *index as usize % WINDOW;
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

    fn byte(x: u32, y: u32) -> u8 {
        (x.wrapping_mul(31) ^ y.wrapping_mul(57)).to_le_bytes()[0]
    }

    /// Every position of every window of a level shows the bytes of an image.
    fn check(pairs: &Pairs<'_>, image: &GrayImage) {
        let (width, height) = image.dimensions();
        let Some(reach) = pairs.window_reach() else {
            assert_eq!(width, 0, "an image without a pixel, half of one");
            return;
        };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of rows")]
        let rows = reach as u32;
        for row in 0..height.saturating_sub(1) {
            #[expect(clippy::cast_precision_loss, reason = "a small row")]
            let window = pairs.window(row as f32, reach).expect("a window");
            for y in row.saturating_sub(rows)..(row + rows + 1).min(height - 1) {
                let corners = (0..width - 1).map(|x| (x, y));
                #[expect(clippy::cast_possible_truncation, reason = "a small index")]
                let index = |(x, y): (u32, u32)| (i64::from(y * width + x) - window.start as i64) as u32;
                let indices: Vec<u32> = corners.clone().map(index).collect();
                let mut quads = vec![0; indices.len()];
                window.quads(&indices, &mut quads);
                let at = |x, y| image.get_pixel(x, y).0[0];
                let expected =
                    |(x, y)| u32::from_le_bytes([at(x, y), at(x, y + 1), at(x + 1, y), at(x + 1, y + 1)]);
                assert!(quads.into_iter().eq(corners.map(expected)), "{width}x{height}, row {row}, {y}");
            }
        }
    }

    /// All levels, also after a larger frame in the same memory.
    #[test]
    fn windows_show_what_the_image_does() {
        let mut pyramid = PairsPyramid::default();
        for (width, height) in [(800, 300), (1, 1), (2, 2), (31, 17), (160, 120), (639, 241), (9000, 24)] {
            let image = GrayImage::from_fn(width, height, |x, y| image::Luma([byte(x, y)]));
            pyramid.rebuild(&image, 3);
            check(&pyramid.level(0), &image);
            let half = pyramid.halves[0].clone();
            check(&pyramid.level(1), &half);
        }
    }

    #[test]
    fn images_too_wide_have_no_window() {
        let mut pyramid = PairsPyramid::default();
        for (width, fits) in [(40_000, true), (43_690, true), (43_691, false), (140_000, false)] {
            pyramid.rebuild(&GrayImage::new(width, 3), 1);
            assert_eq!(pyramid.level(0).window_reach().is_some(), fits, "{width} columns");
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
