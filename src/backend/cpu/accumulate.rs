//! Twin of `shaders/accumulate.wgsl`: warp, sample, residual, weight and sum over one chart, in f64.

use image::GrayImage;
use nalgebra::Vector3;

use crate::backend::TriangleWarp;
use crate::imaging::sample::bilinear;
use crate::model::{Chart, Pixels};

/// Adds up the row of one triangle ([`crate::backend::Sums`] says what it holds); eqs. (3), (9), (10), (17).
pub fn accumulate(
    pixels: &Pixels,
    chart: &Chart,
    warp: &TriangleWarp,
    appearance: &[f32],
    image: &GrayImage,
    row: &mut [f64],
) {
    for p in chart.range() {
        let [u, v] = pixels.position[p].map(f64::from);
        let w = warp.image_from_chart * Vector3::new(u, v, 1.0);
        if w.z <= 0.0 {
            continue;
        }
        let Some(value) = bilinear(image, w.x / w.z, w.y / w.z) else { continue };
        let intensity = f64::from(pixels.intensity[p]);
        let modes = pixels.modes.iter().zip(appearance);
        let template =
            modes.fold(intensity, |sum, (mode, lambda)| sum + f64::from(*lambda) * f64::from(mode[p]));
        let residual = template - value;
        let q = f64::from(pixels.weight[p]);
        let qr = q * residual;
        let [gu, gv] = pixels.gradient[p].map(f64::from);
        let terms = [
            qr * gu * u,
            qr * gu * v,
            qr * gu,
            qr * gv * u,
            qr * gv * v,
            qr * gv,
            qr * residual,
            q,
            1.0,
            qr * intensity,
            qr,
        ];
        for (sum, term) in row.iter_mut().zip(terms) {
            *sum += term;
        }
        for (sum, mode) in row[terms.len()..].iter_mut().zip(&pixels.modes) {
            *sum += qr * f64::from(mode[p]);
        }
    }
}
