//! Removes lens distortion from frames, so that everything behind it sees a pinhole camera.

use image::GrayImage;
use nalgebra::Point2;

use super::sample::bilinear;
use crate::geometry::Camera;

/// Maps frames of a camera with lens distortion to the pinhole camera with the same K.
#[derive(Debug, Clone)]
pub struct Rectifier {
    source: Option<Vec<[f32; 2]>>,
    width: u32,
    height: u32,
}

impl Rectifier {
    /// Precomputes where every pixel of the rectified image lies in the distorted one.
    pub fn new(camera: &Camera) -> Self {
        let source = (!camera.distortion.is_none()).then(|| {
            let pixels = (0..camera.height).flat_map(|v| (0..camera.width).map(move |u| (u, v)));
            pixels.map(|(u, v)| distorted_pixel(camera, f64::from(u), f64::from(v))).collect()
        });
        Self { source, width: camera.width, height: camera.height }
    }

    /// The image as the pinhole camera would have seen it; pixels from outside are 0. Without distortion the
    /// image is handed back as it is.
    pub fn rectify(&self, image: GrayImage) -> GrayImage {
        let mut rectified = GrayImage::default();
        if self.rectify_into(&image, &mut rectified) { rectified } else { image }
    }

    /// [`Self::rectify`] into the memory of another image; false, and nothing is written, without distortion.
    pub fn rectify_into(&self, image: &GrayImage, rectified: &mut GrayImage) -> bool {
        let Some(source) = &self.source else { return false };
        let sample = |[u, v]: &[f32; 2]| {
            let value = bilinear(image, f64::from(*u), f64::from(*v)).unwrap_or(0.0);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "an average of bytes"
            )]
            let byte = value.round() as u8;
            byte
        };
        let mut data = std::mem::take(rectified).into_raw();
        data.clear();
        data.extend(source.iter().map(sample));
        *rectified = GrayImage::from_raw(self.width, self.height, data).expect("one byte per pixel");
        true
    }
}

#[expect(clippy::cast_possible_truncation, reason = "1e-4 px is enough for a sampling position")]
fn distorted_pixel(camera: &Camera, u: f64, v: f64) -> [f32; 2] {
    let p = Point2::new((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
    let d = camera.distortion.apply(p);
    [(camera.fx * d.x + camera.cx) as f32, (camera.fy * d.y + camera.cy) as f32]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Distortion;
    use nalgebra::Point3;

    /// A smooth pattern seen through a lens must look, rectified, as the pinhole camera sees it.
    #[test]
    fn rectified_equals_pinhole() {
        let pinhole = Camera::pinhole(200.0, 200.0, 79.5, 59.5, 160, 120);
        let lens =
            Camera { distortion: Distortion { k1: -0.2, k2: 0.05, ..Distortion::default() }, ..pinhole };
        let pattern = |p: Point3<f64>| 128.0 + 60.0 * (20.0 * p.x).sin() + 50.0 * (17.0 * p.y).cos();
        let view = |camera: &Camera| {
            GrayImage::from_fn(160, 120, |u, v| {
                let ray =
                    camera.ray(&Point2::new(f64::from(u), f64::from(v))).expect("inside the lens model");
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "18..238")]
                image::Luma([pattern(Point3::from(ray)).round() as u8])
            })
        };
        let rectified = Rectifier::new(&lens).rectify(view(&lens));
        let expected = view(&pinhole);
        for (u, v) in [(10, 10), (80, 60), (40, 100), (150, 20)] {
            let (a, b) = (rectified.get_pixel(u, v)[0], expected.get_pixel(u, v)[0]);
            assert!(a.abs_diff(b) <= 2, "({u}, {v}): {a} against {b}");
        }
        assert_eq!(Rectifier::new(&pinhole).rectify(expected.clone()), expected, "no distortion, no change");
    }
}
