//! Where the difference of neighbouring blurs is larger, or smaller, than everywhere around it in place and scale.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::scales::{FIRST_BLUR, Octave, STEPS};

/// Differences smaller than this are noise, grey levels.
const LEAST: f32 = 2.5;
/// Edges are bent at least so much more across than along.
const EDGE_RATIO: f32 = 10.0;
/// Pixels at the border that are left out.
const BORDER: usize = 5;
/// Steps to the exact place at most.
const MOVES: usize = 4;

/// A place in an octave.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extremum {
    /// Pixels of the octave.
    pub(super) at: [f32; 2],
    /// Index of the image with the nearest blur.
    pub(super) image: usize,
    /// Blur at which it stands out, pixels of the octave.
    pub(super) blur: f32,
}

struct Differences<'a> {
    octave: &'a Octave,
    layers: Vec<Vec<f32>>,
}

/// All of an octave, in reading order.
pub(super) fn extrema(octave: &Octave) -> Vec<Extremum> {
    let difference = |pair: &[Vec<f32>]| -> Vec<f32> {
        pair[1].par_iter().zip(&pair[0]).with_min_len(4096).map(|(b, a)| b - a).collect()
    };
    let layers = octave.images.windows(2).map(difference).collect();
    let differences = Differences { octave, layers };
    let (w, h) = (octave.width, octave.height);
    let rows: Vec<Vec<Extremum>> = (BORDER..h - BORDER)
        .into_par_iter()
        .map(|y| {
            let places = (1..=STEPS).flat_map(|s| (BORDER..w - BORDER).map(move |x| (s, x)));
            places
                .filter(|(s, x)| differences.is_extreme(*s, *x, y))
                .filter_map(|(s, x)| differences.exact(s, x, y))
                .collect()
        })
        .collect();
    rows.into_iter().flatten().collect()
}

impl Differences<'_> {
    fn is_extreme(&self, layer: usize, x: usize, y: usize) -> bool {
        let w = self.octave.width;
        let at = y * w + x;
        let value = self.layers[layer][at];
        if value.abs() < 0.5 * LEAST {
            return false;
        }
        let (sign, value) = (value.signum(), value.abs());
        [layer, layer - 1, layer + 1].into_iter().all(|s| {
            [at - w, at, at + w].into_iter().all(|row| {
                let around = &self.layers[s][row - 1..row + 2];
                around.iter().all(|v| sign * v <= value)
            })
        })
    }

    /// Fits a parabola; `None` for what is weak, an edge, or runs away.
    fn exact(&self, mut layer: usize, mut x: usize, mut y: usize) -> Option<Extremum> {
        let (w, h) = (self.octave.width, self.octave.height);
        for _ in 0..MOVES {
            let d = |s: usize, i: usize, j: usize| self.layers[layer + s - 1][(y + j - 1) * w + x + i - 1];
            let here = d(1, 1, 1);
            let slope = Vector3::new(
                (d(1, 2, 1) - d(1, 0, 1)) / 2.0,
                (d(1, 1, 2) - d(1, 1, 0)) / 2.0,
                (d(2, 1, 1) - d(0, 1, 1)) / 2.0,
            );
            let xx = d(1, 2, 1) + d(1, 0, 1) - 2.0 * here;
            let yy = d(1, 1, 2) + d(1, 1, 0) - 2.0 * here;
            let ss = d(2, 1, 1) + d(0, 1, 1) - 2.0 * here;
            let xy = (d(1, 2, 2) + d(1, 0, 0) - d(1, 0, 2) - d(1, 2, 0)) / 4.0;
            let xs = (d(2, 2, 1) + d(0, 0, 1) - d(2, 0, 1) - d(0, 2, 1)) / 4.0;
            let ys = (d(2, 1, 2) + d(0, 1, 0) - d(2, 1, 0) - d(0, 1, 2)) / 4.0;
            let bend = Matrix3::new(xx, xy, xs, xy, yy, ys, xs, ys, ss);
            let step = -bend.try_inverse()? * slope;
            if step.amax() <= 0.5 {
                let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
                let is_edge = determinant <= 0.0
                    || trace * trace * EDGE_RATIO >= determinant * (EDGE_RATIO + 1.0).powi(2);
                let is_weak = (here + 0.5 * slope.dot(&step)).abs() < LEAST;
                #[expect(clippy::cast_precision_loss, reason = "images are far below 2^24 wide")]
                let [fx, fy, fs] = [x as f32 + step.x, y as f32 + step.y, layer as f32 + step.z];
                #[expect(clippy::cast_possible_truncation, reason = "a small number")]
                let blur = FIRST_BLUR as f32 * (fs / STEPS as f32).exp2();
                return (!is_edge && !is_weak).then_some(Extremum { at: [fx, fy], image: layer, blur });
            }
            // To the next pixel or layer where the peak must be.
            let moved = |at: usize, by: f32| {
                if by > 0.5 {
                    at + 1
                } else if by < -0.5 {
                    at - 1
                } else {
                    at
                }
            };
            (x, y, layer) = (moved(x, step.x), moved(y, step.y), moved(layer, step.z));
            let inside = (BORDER..w - BORDER).contains(&x) && (BORDER..h - BORDER).contains(&y);
            if !inside || !(1..=STEPS).contains(&layer) {
                return None;
            }
        }
        None
    }
}
