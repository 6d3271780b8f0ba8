//! Principal components of the training images (eq. 4).

use nalgebra::{DMatrix, SymmetricEigen};

/// For every mode the weights with which the images' residuals are added up, from the images' Gram matrix at full
/// size. The same weights serve all levels, so that one set of appearance parameters does.
pub(super) fn principal_combinations(residuals: &[Vec<f64>], modes: usize) -> Vec<Vec<f64>> {
    let n = residuals.len();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let gram = DMatrix::from_fn(n, n, |i, j| dot(&residuals[i], &residuals[j]));
    let eigen = SymmetricEigen::new(gram);
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let largest = eigen.eigenvalues[order[0]];
    let kept = order.into_iter().take(modes).filter(|&k| eigen.eigenvalues[k] > 1e-9 * largest);
    #[expect(clippy::cast_precision_loss, reason = "image counts are small")]
    let scale = 1.0 / (n as f64).sqrt();
    // With eigenvector x of G = R R^T, R^T x has length sqrt(eigenvalue); divided by sqrt(n) it is one standard
    // deviation of the training set.
    kept.map(|k| eigen.eigenvectors.column(k).iter().map(|x| signed(x * scale, &eigen, k)).collect())
        .collect()
}

/// Fixes the sign that an eigenvector leaves open: its largest component is positive.
fn signed(x: f64, eigen: &SymmetricEigen<f64, nalgebra::Dyn>, column: usize) -> f64 {
    let v = eigen.eigenvectors.column(column);
    x * v[v.iamax()].signum()
}

/// The modes at one level: for every mode one value per pixel, grey levels per standard deviation.
pub(super) fn combine(residuals: &[Vec<f64>], combinations: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let pixels = residuals.first().map_or(0, Vec::len);
    let mode = |weights: &Vec<f64>| {
        let mut sum = vec![0.0; pixels];
        for (w, image) in weights.iter().zip(residuals) {
            sum.iter_mut().zip(image).for_each(|(s, r)| *s += w * r);
        }
        sum
    };
    combinations.iter().map(mode).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Images that are multiples of one pattern have one mode: the pattern, scaled by the multiples' deviation.
    #[test]
    fn one_pattern_gives_one_mode() {
        let pattern = [1.0, -2.0, 3.0, 0.5];
        let multiples = [2.0, -1.0, -1.0];
        let residuals: Vec<Vec<f64>> =
            multiples.iter().map(|m| pattern.iter().map(|p| m * p).collect()).collect();
        let modes = combine(&residuals, &principal_combinations(&residuals, 2));
        assert_eq!(modes.len(), 1, "the second eigenvalue is zero");
        let deviation = (multiples.iter().map(|m| m * m).sum::<f64>() / 3.0).sqrt();
        for (mode, p) in modes[0].iter().zip(pattern) {
            assert!((mode - deviation * p).abs() < 1e-9, "{mode} is not {}", deviation * p);
        }
    }
}
