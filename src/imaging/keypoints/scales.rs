//! A picture at growing blur, each octave at half the size of the one before.

use rayon::prelude::*;

/// Steps of scale per octave.
pub(super) const STEPS: usize = 3;
/// Blur of the first image of an octave, its pixels.
pub(super) const FIRST_BLUR: f64 = 1.6;
/// Blur that a camera's image has, pixels.
const CAMERA_BLUR: f64 = 0.5;
/// Octaves smaller than this on a side say nothing.
const LEAST_SIDE: usize = 24;

/// Images of one size with blurs `FIRST_BLUR * 2^(s / STEPS)`, s = 0 to STEPS + 2.
#[derive(Debug)]
pub(super) struct Octave {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Pixels of the picture per pixel of this octave.
    pub(super) factor: f64,
    pub(super) images: Vec<Vec<f32>>,
}

impl Octave {
    /// At twice the picture's size: most keypoints of small objects are there.
    pub(super) fn first(grey: &[f32], width: usize) -> Option<Self> {
        let height = grey.len() / width.max(1);
        let doubled = doubled(grey, width, height);
        let blur = (FIRST_BLUR * FIRST_BLUR - 4.0 * CAMERA_BLUR * CAMERA_BLUR).sqrt();
        let (width, height) = (2 * width, 2 * height);
        Self::of(blurred(&doubled, width, blur), width, height, 0.5)
    }

    /// The next one: every second pixel of the image whose blur is twice the first one's.
    pub(super) fn next(&self) -> Option<Self> {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let rows = self.images[STEPS].chunks_exact(self.width).step_by(2);
        let halved = rows.flat_map(|row| row.iter().step_by(2).copied()).collect();
        Self::of(halved, width, height, 2.0 * self.factor)
    }

    fn of(first: Vec<f32>, width: usize, height: usize, factor: f64) -> Option<Self> {
        if width.min(height) < LEAST_SIDE {
            return None;
        }
        let mut images = vec![first];
        for step in 1..STEPS + 3 {
            let [before, after] = [step - 1, step].map(blur_at);
            let next = blurred(&images[step - 1], width, (after * after - before * before).sqrt());
            images.push(next);
        }
        Some(Self { width, height, factor, images })
    }
}

#[expect(clippy::cast_precision_loss, reason = "a few steps")]
fn blur_at(step: usize) -> f64 {
    FIRST_BLUR * (step as f64 / STEPS as f64).exp2()
}

/// Pixel (x, y) is at (x / 2, y / 2) of the picture, bilinear.
fn doubled(grey: &[f32], width: usize, height: usize) -> Vec<f32> {
    let mut out = vec![0.0; 4 * width * height];
    out.par_chunks_exact_mut(2 * width).enumerate().for_each(|(y, out)| {
        let [a, b] = [y / 2, y.div_ceil(2).min(height - 1)].map(|y| &grey[y * width..(y + 1) * width]);
        for (x, out) in out.iter_mut().enumerate() {
            let [l, r] = [x / 2, x.div_ceil(2).min(width - 1)];
            *out = (a[l] + a[r] + b[l] + b[r]) / 4.0;
        }
    });
    out
}

/// Gaussian blur, the border continued outside.
fn blurred(image: &[f32], width: usize, sigma: f64) -> Vec<f32> {
    let kernel = kernel(sigma);
    let reach = kernel.len() - 1;
    let mut across = vec![0.0; image.len()];
    across.par_chunks_exact_mut(width).zip(image.par_chunks_exact(width)).for_each_init(
        Vec::new,
        |padded, (out, row)| {
            padded.clear();
            padded.resize(reach, row[0]);
            padded.extend_from_slice(row);
            padded.resize(width + 2 * reach, row[width - 1]);
            weighted(out, &padded[reach..reach + width], kernel[0]);
            for (k, weight) in kernel.iter().enumerate().skip(1) {
                add_pair(out, &padded[reach - k..][..width], &padded[reach + k..][..width], *weight);
            }
        },
    );
    let height = image.len() / width;
    let row = |y: usize| &across[y * width..(y + 1) * width];
    let mut out = vec![0.0; image.len()];
    out.par_chunks_exact_mut(width).enumerate().for_each(|(y, out)| {
        weighted(out, row(y), kernel[0]);
        for (k, weight) in kernel.iter().enumerate().skip(1) {
            add_pair(out, row(y.saturating_sub(k)), row((y + k).min(height - 1)), *weight);
        }
    });
    out
}

fn weighted(out: &mut [f32], a: &[f32], weight: f32) {
    out.iter_mut().zip(a).for_each(|(o, a)| *o = weight * a);
}

fn add_pair(out: &mut [f32], a: &[f32], b: &[f32], weight: f32) {
    out.iter_mut().zip(a).zip(b).for_each(|((o, a), b)| *o += weight * (a + b));
}

/// One half of a Gaussian, its middle first.
fn kernel(sigma: f64) -> Vec<f32> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few pixels")]
    let reach = (3.5 * sigma).ceil() as u32;
    let at = |k: u32| (-f64::from(k * k) / (2.0 * sigma * sigma)).exp();
    let sum = at(0) + 2.0 * (1..=reach).map(at).sum::<f64>();
    #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
    let kernel = (0..=reach).map(|k| (at(k) / sum) as f32).collect();
    kernel
}
