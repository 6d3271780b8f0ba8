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
    let (w, h) = (image.width() as usize / 2, image.height() as usize / 2);
    let stride = image.width() as usize;
    let data = image.as_raw();
    let mut out = vec![0; w * h];
    for (y, row) in out.chunks_exact_mut(w.max(1)).enumerate() {
        let top = &data[2 * y * stride..][..2 * w];
        let bottom = &data[(2 * y + 1) * stride..][..2 * w];
        for (x, value) in row.iter_mut().enumerate() {
            let sum = u16::from(top[2 * x])
                + u16::from(top[2 * x + 1])
                + u16::from(bottom[2 * x])
                + u16::from(bottom[2 * x + 1]);
            *value = u8::try_from((sum + 2) >> 2).unwrap_or(u8::MAX);
        }
    }
    let (w, h) = (image.width() / 2, image.height() / 2);
    GrayImage::from_raw(w, h, out).expect("the buffer has w * h bytes")
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
