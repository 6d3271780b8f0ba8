//! Twin of `shaders/accumulate.wgsl`: warp, sample, residual, weight and sum over one chart, in f64.

use image::GrayImage;
use nalgebra::Vector3;

use crate::backend::{SATURATED, SATURATED_SHARE, TEMPLATE_BLUR, TriangleWarp};
use crate::imaging::sample::Patch;
use crate::model::{Chart, LevelTemplate};

/// Adds up the row of one triangle ([`crate::backend::Sums`] says what it holds); eqs. (3), (9), (10), (17), with what sampling does to
/// the template and with saturated pixels as they would be.
pub fn accumulate(
    level: &LevelTemplate,
    chart: &Chart,
    warp: &TriangleWarp,
    appearance: &[f32],
    image: &GrayImage,
    row: &mut [f64],
) {
    let pixels = &level.pixels;
    for p in chart.range() {
        let [u, v] = pixels.position[p].map(f64::from);
        let w = warp.image_from_chart * Vector3::new(u, v, 1.0);
        if w.z <= 0.0 {
            continue;
        }
        let Some(patch) = Patch::at(image, w.x / w.z, w.y / w.z) else { continue };
        let intensity = f64::from(pixels.intensity[p]);
        let modes = pixels.modes.iter().zip(appearance);
        let mut template =
            modes.fold(intensity, |sum, (mode, lambda)| sum + f64::from(*lambda) * f64::from(mode[p]));
        for (f, blur) in patch.fraction.into_iter().zip(&warp.blur) {
            let second = blur.iter().zip(level.curvature[p]).map(|(b, c)| b * f64::from(c)).sum::<f64>();
            template += (f * (1.0 - f) - TEMPLATE_BLUR) * second;
        }
        let shown = patch.value();
        let q = f64::from(pixels.weight[p]);
        let saturated = patch.blend(patch.values.map(|v| if v >= f64::from(SATURATED) { 1.0 } else { 0.0 }));
        let lit = template + warp.light[0] * intensity + warp.light[1];
        let missing = (saturated / SATURATED_SHARE).min(1.0) * (lit - shown).max(0.0);
        let residual = template - (shown + missing);
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
            if q > 0.0 { 1.0 - missing.min(1.0) } else { 1.0 },
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
