//! Image pyramid by 2x2 box filtering with pixel centres at integers.

use image::GrayImage;

/// One image per level; level 0 is full size.
#[derive(Debug, Clone, Default)]
pub struct Pyramid {
    levels: Vec<GrayImage>,
}

impl Pyramid {
    /// Builds `count` levels (at least one) from a full-size image.
    pub fn new(image: GrayImage, count: usize) -> Self {
        let mut levels = vec![image];
        while levels.len() < count {
            let next = downsample(&levels[levels.len() - 1]);
            levels.push(next);
        }
        Self { levels }
    }

    /// Builds `count` levels (at least one) from a full-size image in the memory of the last one.
    pub fn rebuild(&mut self, image: &GrayImage, count: usize) {
        self.levels.resize_with(count.max(1), GrayImage::default);
        copy(image, &mut self.levels[0]);
        for level in 1..self.levels.len() {
            let (done, rest) = self.levels.split_at_mut(level);
            downsample_into(&done[level - 1], &mut rest[0]);
        }
    }

    /// The image of a level.
    pub fn level(&self, level: usize) -> &GrayImage {
        &self.levels[level]
    }

    /// Number of levels.
    pub fn len(&self) -> usize {
        self.levels.len()
    }

    /// True before the first image.
    pub fn is_empty(&self) -> bool {
        self.levels.is_empty()
    }
}

/// Half the size: (a + b + c + d + 2) / 4 of every 2x2 block; an odd last row or column is left out.
pub fn downsample(image: &GrayImage) -> GrayImage {
    let mut half = GrayImage::default();
    downsample_into(image, &mut half);
    half
}

/// [`downsample`] into the memory of another image.
pub(crate) fn downsample_into(image: &GrayImage, half: &mut GrayImage) {
    let (w, h) = (image.width() as usize / 2, image.height() as usize / 2);
    let stride = image.width() as usize;
    let data = image.as_raw();
    let mut out = std::mem::take(half).into_raw();
    out.resize(w * h, 0);
    // Two bytes as one number: vectors take them apart faster than they gather every other byte.
    let sum = |pair: &[u8; 2]| {
        let both = u16::from_le_bytes(*pair);
        (both & 255) + (both >> 8)
    };
    for (y, row) in out.chunks_exact_mut(w.max(1)).enumerate() {
        let (top, _) = data[2 * y * stride..][..2 * w].as_chunks();
        let (bottom, _) = data[(2 * y + 1) * stride..][..2 * w].as_chunks();
        for ((value, top), bottom) in row.iter_mut().zip(top).zip(bottom) {
            *value = ((sum(top) + sum(bottom) + 2) >> 2).to_le_bytes()[0];
        }
    }
    *half = with_size(image.width() / 2, image.height() / 2, out);
}

fn copy(image: &GrayImage, to: &mut GrayImage) {
    let mut out = std::mem::take(to).into_raw();
    out.clear();
    out.extend_from_slice(image.as_raw());
    *to = with_size(image.width(), image.height(), out);
}

fn with_size(width: u32, height: u32, data: Vec<u8>) -> GrayImage {
    GrayImage::from_raw(width, height, data).expect("the buffer has a byte for every pixel")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_averaged_and_rounded() {
        let image =
            GrayImage::from_raw(5, 3, vec![0, 1, 9, 9, 7, 2, 3, 9, 9, 7, 5, 5, 5, 5, 5]).expect("15 bytes");
        let half = downsample(&image);
        assert_eq!((half.width(), half.height()), (2, 1), "odd rests are dropped");
        assert_eq!(half.as_raw(), &vec![2, 9], "(0+1+2+3+2)/4 = 2");
    }

    #[test]
    fn levels_halve() {
        let pyramid = Pyramid::new(GrayImage::new(640, 480), 3);
        assert_eq!(pyramid.len(), 3, "three levels");
        assert_eq!(pyramid.level(2).dimensions(), (160, 120), "a quarter of the size");
    }
}
