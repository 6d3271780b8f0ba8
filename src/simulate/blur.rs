//! Optical blur.

use rayon::prelude::*;

/// The kernel reaches this many standard deviations.
const REACH: f64 = 3.5;

/// Gaussian blur of an image of the given width, border pixels repeated; `sigma` in pixels.
pub(super) fn gaussian(values: &mut [f64], width: usize, sigma: f64) {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few pixels")]
    let reach = (REACH * sigma).ceil() as usize;
    let weights: Vec<f64> = (0..=reach).map(|k| libm::exp(-0.5 * (k * k) as f64 / (sigma * sigma))).collect();
    let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    let height = values.len() / width;
    let pass = |from: &[f64], to: &mut [f64], along: usize, n: usize| {
        to.par_iter_mut().enumerate().for_each(|(i, out)| {
            let at = (i / along) % n;
            let near = |k: usize| from[i - k.min(at) * along] + from[i + k.min(n - 1 - at) * along];
            let sides: f64 = weights.iter().enumerate().skip(1).map(|(k, w)| w * near(k)).sum();
            *out = (weights[0] * from[i] + sides) / sum;
        });
    };
    let mut rows = vec![0.0; values.len()];
    pass(values, &mut rows, 1, width);
    pass(&rows, values, width, height);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_becomes_a_gaussian() {
        let mut values = vec![0.0; 41 * 31];
        values[15 * 41 + 20] = 1.0;
        gaussian(&mut values, 41, 1.5);
        let sum: f64 = values.iter().sum();
        let variance: f64 =
            values.iter().enumerate().map(|(i, v)| v * ((i % 41) as f64 - 20.0).powi(2)).sum();
        assert!((sum - 1.0).abs() < 1e-12, "energy stays, {sum}");
        assert!((variance - 2.25).abs() < 0.02, "variance {variance}");
    }

    #[test]
    fn a_flat_image_stays_flat() {
        let mut values = vec![7.0; 20 * 10];
        gaussian(&mut values, 20, 2.0);
        assert!(values.iter().all(|v| (v - 7.0).abs() < 1e-12), "borders are repeated");
    }
}
