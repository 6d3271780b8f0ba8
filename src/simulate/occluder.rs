//! A half-plane of clutter that hides a given part of the object.

use super::texture::Texture;

/// Resolution of the search for the edge's position, per pixel.
const BINS_PER_PIXEL: f64 = 8.0;

/// Where the occluder lies in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Occluder {
    /// Share of the object's visible area that it hides, 0..1.
    pub fraction: f64,
    /// Direction in the image from the edge into the hidden side, radians from +u towards +v.
    pub angle: f64,
}

/// A placed occluder: hides where `direction . (u, v)` exceeds `offset`.
#[derive(Debug, Clone, Copy)]
pub(super) struct HalfPlane {
    direction: [f64; 2],
    offset: f64,
}

impl Occluder {
    /// Places the edge so that it hides the wanted share of the coverage (one value per pixel, rows of `width`).
    pub(super) fn place(&self, coverage: &[f64], width: usize) -> HalfPlane {
        let direction = [libm::cos(self.angle), libm::sin(self.angle)];
        let height = coverage.len() / width;
        let reach = (width + height) as f64;
        #[expect(clippy::cast_possible_truncation, reason = "a few thousand bins")]
        let bin = |key: f64| ((key + reach) * BINS_PER_PIXEL) as usize;
        let mut histogram = vec![0.0; bin(reach) + 1];
        for (j, row) in coverage.chunks_exact(width).enumerate() {
            for (i, &c) in row.iter().enumerate().filter(|(_, c)| **c > 0.0) {
                histogram[bin(direction[0] * i as f64 + direction[1] * j as f64)] += c;
            }
        }
        let wanted = self.fraction * histogram.iter().sum::<f64>();
        let mut hidden = 0.0;
        let mut edge = histogram.len();
        while edge > 0 && hidden < wanted {
            edge -= 1;
            hidden += histogram[edge];
        }
        HalfPlane { direction, offset: edge as f64 / BINS_PER_PIXEL - reach }
    }
}

impl HalfPlane {
    /// How much of pixel (u, v) is hidden, 0..1.
    pub(super) fn alpha(&self, u: f64, v: f64) -> f64 {
        (0.5 + self.direction[0] * u + self.direction[1] * v - self.offset).clamp(0.0, 1.0)
    }

    /// Grey value of the clutter at pixel (u, v); the clutter moves with the edge.
    pub(super) fn value(&self, texture: &Texture, u: f64, v: f64) -> f64 {
        let along = self.direction[0] * u + self.direction[1] * v - self.offset;
        let across = self.direction[0] * v - self.direction[1] * u;
        let [w, h] = texture.size();
        texture.sample(mirrored(along, w as f64 - 1.0), mirrored(across + h as f64 / 2.0, h as f64 - 1.0))
    }
}

/// Reflects a coordinate into [0, limit].
fn mirrored(x: f64, limit: f64) -> f64 {
    let turns = (x / (2.0 * limit)).floor();
    let x = x - turns * 2.0 * limit;
    if x > limit { 2.0 * limit - x } else { x }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hides_the_wanted_share() {
        let (w, h) = (160, 120);
        let disc = |k: usize| {
            let (x, y) = ((k % w) as f64 - 70.0, (k / w) as f64 - 50.0);
            if x * x + y * y < 1600.0 { 1.0 } else { 0.0 }
        };
        let coverage: Vec<f64> = (0..w * h).map(disc).collect();
        let total: f64 = coverage.iter().sum();
        for (fraction, angle) in [(0.2, 0.0), (0.4, 1.0), (0.6, 4.0), (0.1, 2.5)] {
            let edge = Occluder { fraction, angle }.place(&coverage, w);
            let hidden = |k: usize| coverage[k] * edge.alpha((k % w) as f64, (k / w) as f64);
            let measured = (0..w * h).map(hidden).sum::<f64>() / total;
            assert!((measured - fraction).abs() < 0.01, "{measured} instead of {fraction} at {angle}");
        }
    }

    #[test]
    fn mirrored_stays_inside() {
        for (x, expected) in [(-3.0, 3.0), (4.0, 4.0), (12.0, 8.0), (21.0, 1.0), (-11.0, 9.0)] {
            assert!((mirrored(x, 10.0) - expected).abs() < 1e-12, "{x} gave {}", mirrored(x, 10.0));
        }
    }
}
