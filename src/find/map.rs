//! The normalised gradient of a frame with its derivatives, for sampling between pixels.

use crate::imaging::NormalisedGradient;

/// Per pixel `F_u, F_v, dF_u/du, dF_u/dv, dF_v/du, dF_v/dv`.
#[derive(Debug, Clone)]
pub(super) struct Map {
    width: usize,
    height: usize,
    values: Vec<[f32; 8]>,
}

impl Map {
    pub(super) fn new(gradient: &NormalisedGradient) -> Self {
        let (width, height) = (gradient.width, gradient.height);
        let f = &gradient.values;
        let mut values = vec![[0.0; 8]; width * height];
        for y in 0..height {
            for x in 0..width {
                let at = y * width + x;
                let out = &mut values[at];
                [out[0], out[1]] = f[at];
                let inside = x > 0 && y > 0 && x + 1 < width && y + 1 < height;
                if inside {
                    let slope = |k: usize, step: usize| (f[at + step][k] - f[at - step][k]) / 2.0;
                    [out[2], out[3], out[4], out[5]] =
                        [slope(0, 1), slope(0, width), slope(1, 1), slope(1, width)];
                }
            }
        }
        Self { width, height, values }
    }

    /// Bilinear; `None` outside.
    #[inline]
    pub(super) fn sample(&self, u: f32, v: f32) -> Option<[f32; 8]> {
        #[expect(clippy::cast_precision_loss, reason = "images are far below 2^24 wide")]
        let (right, bottom) = ((self.width - 1) as f32, (self.height - 1) as f32);
        if !(u >= 0.0 && v >= 0.0 && u < right && v < bottom) {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside, checked above")]
        let (x, y) = (u as usize, v as usize);
        #[expect(clippy::cast_precision_loss, reason = "images are far below 2^24 wide")]
        let (fu, fv) = (u - x as f32, v - y as f32);
        let at = y * self.width + x;
        let top: &[[f32; 8]; 2] = self.values[at..at + 2].try_into().ok()?;
        let low = at + self.width;
        let bottom: &[[f32; 8]; 2] = self.values[low..low + 2].try_into().ok()?;
        let weights = [(1.0 - fu) * (1.0 - fv), fu * (1.0 - fv), (1.0 - fu) * fv, fu * fv];
        let mut out = [0.0; 8];
        for (k, out) in out.iter_mut().enumerate() {
            *out = weights[0] * top[0][k]
                + weights[1] * top[1][k]
                + weights[2] * bottom[0][k]
                + weights[3] * bottom[1][k];
        }
        Some(out)
    }
}
