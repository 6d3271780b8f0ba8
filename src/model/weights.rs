//! Edge weights of eq. (10): pixels with much texture count more.

/// q = |g| / (|g| + mean |g|) for every pixel, 0..1; all zero for a template without any gradient.
pub fn edge_weights(gradient: &[[f32; 2]]) -> Vec<f32> {
    let magnitude: Vec<f64> = gradient.iter().map(|g| f64::from(g[0]).hypot(f64::from(g[1]))).collect();
    #[expect(clippy::cast_precision_loss, reason = "pixel counts are far below 2^52")]
    let mean = magnitude.iter().sum::<f64>() / magnitude.len().max(1) as f64;
    #[expect(clippy::cast_possible_truncation, reason = "weights are stored in f32")]
    magnitude.iter().map(|m| if *m > 0.0 { (m / (m + mean)) as f32 } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_gradient_gets_one_half() {
        let weights = edge_weights(&[[3.0, 4.0], [0.0, 5.0], [5.0, 0.0]]);
        assert!(weights.iter().all(|q| (q - 0.5).abs() < 1e-6), "{weights:?}");
    }

    #[test]
    fn flat_pixels_get_nothing_and_edges_nearly_one() {
        let mut gradient = vec![[0.0, 0.0]; 99];
        gradient.push([0.0, 100.0]);
        let weights = edge_weights(&gradient);
        assert!(weights[0] == 0.0 && weights[99] > 0.98, "{} and {}", weights[0], weights[99]);
        assert_eq!(edge_weights(&[[0.0, 0.0]]), vec![0.0], "no texture, no weight");
    }
}
