//! Twin of `shaders/linearize.wgsl`: warp, sample with gradient, residual, and the sums of a Gauss-Newton step over
//! one chart, in f64.

use image::GrayImage;
use nalgebra::Vector3;

use crate::backend::TriangleWarp;
use crate::imaging::sample::Patch;
use crate::model::{Chart, Pixels};

/// Adds up the two rows of one triangle ([`crate::backend::Linearization`] says what they hold).
pub fn linearize(
    pixels: &Pixels,
    chart: &Chart,
    warp: &TriangleWarp,
    appearance: &[f32],
    image: &GrayImage,
    (first, second): (&mut [f64], &mut [f64]),
) {
    for p in chart.range() {
        let [u, v] = pixels.position[p].map(f64::from);
        let w = warp.image_from_chart * Vector3::new(u, v, 1.0);
        if w.z <= 0.0 {
            continue;
        }
        let Some(patch) = Patch::at(image, w.x / w.z, w.y / w.z) else { continue };
        let (value, [hu, hv]) = (patch.value(), patch.gradient());
        let intensity = f64::from(pixels.intensity[p]);
        let modes = pixels.modes.iter().zip(appearance);
        let template =
            modes.fold(intensity, |sum, (mode, lambda)| sum + f64::from(*lambda) * f64::from(mode[p]));
        let residual = template - value;
        let q = f64::from(pixels.weight[p]);
        let qr = q * residual;
        let direction = [hu * u, hu * v, hu, hv * u, hv * v, hv];
        let place = [u * u, u * v, u, v * v, v, 1.0];

        add(&mut first[..6], qr, &direction);
        add(&mut first[6..11], 1.0, &[qr * residual, q, 1.0, qr * intensity, qr]);
        add(&mut second[..6], q * hu * hu, &place);
        add(&mut second[6..12], q * hu * hv, &place);
        add(&mut second[12..18], q * hv * hv, &place);
        add(&mut second[18..24], q * intensity, &direction);
        add(&mut second[24..30], q, &direction);
        for (k, mode) in pixels.modes.iter().enumerate() {
            let mode = f64::from(mode[p]);
            first[11 + k] += qr * mode;
            add(&mut second[30 + 6 * k..][..6], q * mode, &direction);
        }
    }
}

fn add(sums: &mut [f64], factor: f64, terms: &[f64]) {
    for (sum, term) in sums.iter_mut().zip(terms) {
        *sum += factor * term;
    }
}
