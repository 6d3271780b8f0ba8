//! How much of the image a pose explains, cell by cell: what is hidden takes away cells, and does not spoil the others.

use nalgebra::Point3;

use super::atlas::Atlas;
use super::render::Rendering;
use crate::geometry::{Camera, Pose};
use crate::imaging::{GrayImage, Pyramid};

/// Side of a cell, pixels.
const CELL: usize = 8;
/// A cell is looked at if the object covers so many of its pixels.
const LEAST_PIXELS: usize = 32;
/// Cells with less variance (grey levels squared) have nothing to recognise.
const MIN_VARIANCE: f64 = 25.0;
/// Correlation from which on a cell counts as recognised.
const RECOGNISED: f64 = 0.6;

/// A cell says at most this much: noise and small errors of the model decide beyond.
const MOST_INFORMATION: f64 = 3.0;
/// Poses of objects larger than this (rms distance of their points from the centre, pixels) are compared at half size.
const LARGE_PX: f64 = 120.0;
/// A pose is believed from this much information on; wrong poses in images without the object have up to 55.
const LEAST_INFORMATION: f64 = 60.0;
/// And if this share of the cells is recognised,
const LEAST_SHARE: f64 = 0.45;
/// with this much information per cell.
const LEAST_MEAN: f64 = 0.5;
/// Nothing of importance is hidden from this share on.
const CLEAR_SHARE: f64 = 0.8;

/// What a pose explains of an image.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Evidence {
    /// Cells inside the image in which the object has texture.
    cells: usize,
    /// Those of them that look as they should.
    recognised: usize,
    /// Sum over them of -ln(1 - c^2) for correlations c.
    pub(super) information: f64,
}

/// A frame at the two sizes at which poses are compared.
#[derive(Debug)]
pub(super) struct Witness(Pyramid);

impl Witness {
    pub(super) fn new(image: &GrayImage) -> Self {
        Self(Pyramid::new(image.clone(), 2))
    }

    /// How much of the image a pose explains; `extent` is the object's (rms, metres).
    pub(super) fn evidence(
        &self,
        atlas: &Atlas,
        (camera, pose): (&Camera, &Pose),
        (centre, extent): (&Point3<f64>, f64),
        picture: &mut Rendering,
    ) -> Evidence {
        let size = extent * camera.fx / pose.transform_point(centre).z;
        let level = usize::from(size > LARGE_PX);
        picture.render(atlas, &camera.at_level(level), pose);
        Evidence::new(picture, self.0.level(level))
    }
}

impl Evidence {
    /// Compares a rendered pose with the image of the same size.
    fn new(picture: &Rendering, image: &GrayImage) -> Self {
        let mut all = Self::default();
        for top in (0..picture.height).step_by(CELL) {
            for left in (0..picture.width).step_by(CELL) {
                let Some(correlation) = correlation(picture, image, left, top) else { continue };
                all.cells += 1;
                if correlation > RECOGNISED {
                    all.recognised += 1;
                    let rest = (1.0 - correlation * correlation).max(f64::MIN_POSITIVE);
                    all.information += (-rest.ln()).min(MOST_INFORMATION);
                }
            }
        }
        all
    }

    /// Share of the cells that look as they should.
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    fn share(&self) -> f64 {
        self.recognised as f64 / self.cells.max(1) as f64
    }

    /// Is the object where the pose says? A part of it may be hidden.
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    pub(super) fn is_enough(&self) -> bool {
        self.information >= LEAST_INFORMATION.max(LEAST_MEAN * self.cells as f64)
            && self.share() >= LEAST_SHARE
    }

    /// Is it there with nothing of importance hidden?
    pub(super) fn is_clear(&self) -> bool {
        self.is_enough() && self.share() >= CLEAR_SHARE
    }
}

/// Normalised correlation over a cell; `None` if there is too little of the object or of its texture.
fn correlation(picture: &Rendering, image: &GrayImage, left: usize, top: usize) -> Option<f64> {
    let (mut count, mut sums) = (0, [0.0; 5]);
    for y in top..(top + CELL).min(picture.height) {
        for x in left..(left + CELL).min(picture.width) {
            let expected = picture.grey[y * picture.width + x];
            let at = |k: usize, x: usize| u32::try_from(i64::from(picture.origin[k]) + x as i64).ok();
            let Some((u, v)) = at(0, x).zip(at(1, y)) else { continue };
            if expected.is_nan() || u >= image.width() || v >= image.height() {
                continue;
            }
            let (a, b) = (f64::from(expected), f64::from(image.get_pixel(u, v)[0]));
            count += 1;
            sums.iter_mut().zip([a, b, a * a, a * b, b * b]).for_each(|(s, t)| *s += t);
        }
    }
    let [a, b, aa, ab, bb] = sums.map(|s| s / f64::from(count.max(1)));
    let (expected, seen) = (aa - a * a, bb - b * b);
    if usize::try_from(count).is_ok_and(|n| n < LEAST_PIXELS) || expected < MIN_VARIANCE {
        return None;
    }
    Some(if seen > 0.0 { (ab - a * b) / (expected * seen).sqrt() } else { 0.0 })
}
