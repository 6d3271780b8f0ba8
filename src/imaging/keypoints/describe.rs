//! Direction and description of a keypoint, from the gradients around it.

use std::f32::consts::TAU;

use super::extrema::Extremum;
use super::scales::Octave;
use super::{DESCRIPTION, Keypoint};

/// Directions of the histogram that tells the main one.
const BINS: usize = 36;
/// Its window, in blurs of the keypoint.
const WINDOW: f32 = 1.5;
/// A direction with this share of the strongest one is a main one as well.
const SHARE: f32 = 0.8;
/// Cells along a side of the description, and directions of each.
const CELLS: usize = 4;
const DIRECTIONS: usize = 8;
/// Side of a cell, in blurs of the keypoint.
const CELL: f32 = 3.0;
/// No direction counts more than this share of the whole: highlights change some much.
const LARGEST: f32 = 0.2;
const LENGTH: f32 = 512.0;

/// The keypoints of an extremum, one for each main direction.
pub(super) fn described(octave: &Octave, e: &Extremum) -> Vec<Keypoint> {
    let scaled = |x: f32| f64::from(x) * octave.factor;
    let keypoint = |angle: f32| Keypoint {
        position: e.at.map(scaled),
        scale: scaled(e.blur),
        angle: f64::from(angle),
        description: description(octave, e, angle),
    };
    directions(octave, e).into_iter().map(keypoint).collect()
}

/// Calls `each` with offset from the keypoint (pixels), size and direction of the gradient.
fn for_each_gradient(octave: &Octave, e: &Extremum, reach: f32, mut each: impl FnMut([f32; 2], f32, f32)) {
    let image = &octave.images[e.image];
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the image")]
    let span = |middle: f32, size: usize| {
        let lo = (middle - reach).max(1.0).ceil() as usize;
        lo..((middle + reach).max(0.0).floor() as usize + 1).min(size - 1)
    };
    for y in span(e.at[1], octave.height) {
        for x in span(e.at[0], octave.width) {
            let at = y * octave.width + x;
            let (gu, gv) =
                (image[at + 1] - image[at - 1], image[at + octave.width] - image[at - octave.width]);
            #[expect(clippy::cast_precision_loss, reason = "images are far below 2^24 wide")]
            let offset = [x as f32 - e.at[0], y as f32 - e.at[1]];
            each(offset, gu.hypot(gv), gv.atan2(gu));
        }
    }
}

fn directions(octave: &Octave, e: &Extremum) -> Vec<f32> {
    let sigma = WINDOW * e.blur;
    let mut raw = [0.0_f32; BINS];
    for_each_gradient(octave, e, 3.0 * sigma, |[x, y], size, direction| {
        let weight = (-(x * x + y * y) / (2.0 * sigma * sigma)).exp();
        raw[bin(direction, BINS)] += weight * size;
    });
    let around = |k: usize, by: usize| raw[(k + by) % BINS];
    let smooth: [f32; BINS] = std::array::from_fn(|k| {
        let next = around(k, 1) + around(k, BINS - 1);
        (around(k, 2) + around(k, BINS - 2) + 4.0 * next + 6.0 * raw[k]) / 16.0
    });
    let most = smooth.iter().copied().fold(0.0, f32::max);
    let peak = |k: usize| {
        let [a, b, c] = [BINS - 1, 0, 1].map(|by| smooth[(k + by) % BINS]);
        let is_peak = b > a && b > c && b >= SHARE * most;
        #[expect(clippy::cast_precision_loss, reason = "a few bins")]
        let angle = (k as f32 + 0.5 * (a - c) / (a - 2.0 * b + c) + 0.5) / BINS as f32 * TAU;
        is_peak.then_some(angle)
    };
    (0..BINS).filter_map(peak).collect()
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "not negative, at most the number"
)]
#[expect(clippy::cast_precision_loss, reason = "a few bins")]
fn bin(direction: f32, bins: usize) -> usize {
    (direction.rem_euclid(TAU) / TAU * bins as f32) as usize % bins
}

fn description(octave: &Octave, e: &Extremum, angle: f32) -> [i16; DESCRIPTION] {
    let cell = CELL * e.blur;
    let (sin, cos) = (angle.sin() / cell, angle.cos() / cell);
    #[expect(clippy::cast_precision_loss, reason = "a few cells")]
    let half = CELLS as f32 / 2.0;
    let mut histogram = [0.0_f32; DESCRIPTION];
    let reach = cell * (half + 0.5) * std::f32::consts::SQRT_2;
    for_each_gradient(octave, e, reach, |[x, y], size, direction| {
        let place = [cos * x + sin * y, cos * y - sin * x];
        if place.iter().any(|p| p.abs() >= half + 0.5) {
            return;
        }
        let weight = size * (-(place[0] * place[0] + place[1] * place[1]) / (2.0 * half * half)).exp();
        #[expect(clippy::cast_precision_loss, reason = "a few directions")]
        let turn = ((direction - angle).rem_euclid(TAU) / TAU * DIRECTIONS as f32).min(DIRECTIONS as f32);
        spread(&mut histogram, [place[0] + half - 0.5, place[1] + half - 0.5, turn], weight);
    });
    quantised(&histogram)
}

/// Shares a weight among the two nearest cells along u and v and the two nearest directions.
fn spread(histogram: &mut [f32; DESCRIPTION], at: [f32; 3], weight: f32) {
    let floor = at.map(f32::floor);
    let [fu, fv, fd] = [0, 1, 2].map(|k| at[k] - floor[k]);
    #[expect(clippy::cast_possible_truncation, reason = "-1 to the number of cells or directions")]
    let [u, v, d] = floor.map(|x| x as isize);
    for (j, wv) in [(v, 1.0 - fv), (v + 1, fv)] {
        for (i, wu) in [(u, 1.0 - fu), (u + 1, fu)] {
            let (Ok(i), Ok(j)) = (usize::try_from(i), usize::try_from(j)) else { continue };
            if i >= CELLS || j >= CELLS {
                continue;
            }
            for (k, wd) in [(d, 1.0 - fd), (d + 1, fd)] {
                let k = k.unsigned_abs() % DIRECTIONS;
                histogram[(j * CELLS + i) * DIRECTIONS + k] += weight * wu * wv * wd;
            }
        }
    }
}

fn quantised(histogram: &[f32; DESCRIPTION]) -> [i16; DESCRIPTION] {
    let length = |h: &[f32; DESCRIPTION]| h.iter().map(|x| x * x).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
    let most = LARGEST * length(histogram);
    let clipped = histogram.map(|x| x.min(most));
    let scale = LENGTH / length(&clipped);
    #[expect(clippy::cast_possible_truncation, reason = "at most the length")]
    let quantised = clipped.map(|x| (x * scale).round() as i16);
    quantised
}
