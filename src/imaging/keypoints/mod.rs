//! Keypoints that are found again when an image is shifted, turned or scaled, with a description of what is around them
//! (D. Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004): extrema of the difference of
//! Gaussians over place and scale, described by histograms of gradients.

mod describe;
mod extrema;
mod scales;

use rayon::prelude::*;

use extrema::Extremum;
use scales::Octave;

/// Numbers of a description.
pub const DESCRIPTION: usize = 128;

/// A place with a size and a direction of its own.
#[derive(Debug, Clone, PartialEq)]
pub struct Keypoint {
    /// Pixels (u, v) of the image.
    pub position: [f64; 2],
    /// Standard deviation of the Gaussian at which it stands out, pixels.
    pub scale: f64,
    /// Main direction of the gradient, radians from +u towards +v.
    pub angle: f64,
    /// Histograms of the gradients around it, relative to scale and direction; of length 512.
    pub description: [i16; DESCRIPTION],
}

/// All keypoints of a picture of grey values (rows of `width`), octave by octave in reading order. A place with two main
/// directions counts twice.
pub fn keypoints(grey: &[f32], width: usize) -> Vec<Keypoint> {
    let mut found = Vec::new();
    let mut octave = Octave::first(grey, width);
    while let Some(this) = octave {
        let extrema: Vec<Extremum> = extrema::extrema(&this);
        let described: Vec<Vec<Keypoint>> =
            extrema.par_iter().map(|e| describe::described(&this, e)).collect();
        found.extend(described.into_iter().flatten());
        octave = this.next();
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 120;

    /// Random values on a lattice, smooth between; turned about the middle and scaled.
    fn picture(turn: f64, scale: f64) -> Vec<f32> {
        let random = |x: f64, y: f64| ((12.9898 * x + 78.233 * y).sin() * 43_758.545).rem_euclid(1.0);
        let smooth = |x: f64| x * x * (3.0 - 2.0 * x);
        let value = |x: f64, y: f64| {
            let (i, j) = (x.floor(), y.floor());
            let (fx, fy) = (smooth(x - i), smooth(y - j));
            let row = |j: f64| (1.0 - fx) * random(i, j) + fx * random(i + 1.0, j);
            200.0 * ((1.0 - fy) * row(j) + fy * row(j + 1.0))
        };
        let middle = (WIDTH / 2) as f64;
        let at = |k: usize| {
            let (x, y) = ((k % WIDTH) as f64 - middle, (k / WIDTH) as f64 - middle);
            let (x, y) = ((turn.cos() * x + turn.sin() * y), (turn.cos() * y - turn.sin() * x));
            #[expect(clippy::cast_possible_truncation, reason = "pictures are f32")]
            let grey = value(x / scale / 7.0, y / scale / 7.0) as f32;
            grey
        };
        (0..WIDTH * WIDTH).map(at).collect()
    }

    #[test]
    fn a_turned_and_scaled_picture_has_the_same_keypoints() {
        let (turn, scale) = (0.7_f64, 1.2);
        let [first, second] = [(0.0, 1.0), (turn, scale)].map(|(t, s)| keypoints(&picture(t, s), WIDTH));
        assert!(first.len() >= 10, "{} keypoints", first.len());
        let middle = (WIDTH / 2) as f64;
        let (mut tried, mut same) = (0, 0);
        for a in &first {
            let [x, y] = a.position.map(|c| (c - middle) * scale);
            let expected = [turn.cos() * x - turn.sin() * y, turn.sin() * x + turn.cos() * y];
            if expected.iter().any(|c| c.abs() > middle - 25.0) {
                continue;
            }
            tried += 1;
            let distance = |b: &Keypoint| {
                a.description.iter().zip(&b.description).map(|(p, q)| i32::from(p - q).pow(2)).sum::<i32>()
            };
            let Some(b) = second.iter().min_by_key(|b| distance(b)) else { continue };
            let near = (0..2).all(|k| (b.position[k] - middle - expected[k]).abs() < 1.5);
            let turned = (b.angle - a.angle - turn).rem_euclid(std::f64::consts::TAU);
            let turned = turned.min(std::f64::consts::TAU - turned) < 0.15;
            same += u32::from(near && turned && (b.scale / a.scale / scale).ln().abs() < 0.2);
        }
        assert!(tried >= 6 && same * 10 >= tried * 8, "{same} of {tried} are found again");
    }

    #[test]
    fn a_plain_picture_has_none() {
        assert!(keypoints(&vec![90.0; 64 * 48], 64).is_empty(), "nothing stands out");
    }
}
