//! Twin of `shaders/scan.wgsl`: a template at every position of the image.

use crate::backend::templates::{ScanPeak, ScanRequest, TILE};

/// The best position in every tile (row by row) for one template; of equal ones the first in reading order.
pub fn scan(request: &ScanRequest<'_>, template: usize, peaks: &mut [ScanPeak]) {
    let (image, [columns, _]) = (request.image, request.tiles());
    let (points, scale) = request.templates.get(template);
    let (width, height) = (i64::try_from(image.width), i64::try_from(image.height));
    let (width, height) = (width.unwrap_or(0), height.unwrap_or(0));
    peaks.fill(ScanPeak { score: f32::NEG_INFINITY, position: [0; 2] });
    for v in 0..height {
        for u in 0..width {
            let mut sum = 0.0_f64;
            for point in points {
                let (x, y) = (u + i64::from(point.offset[0]), v + i64::from(point.offset[1]));
                if (0..width).contains(&x) && (0..height).contains(&y) {
                    let value = image.values[usize::try_from(y * width + x).unwrap_or(0)];
                    sum += f64::from(point.value[0]) * f64::from(value[0]);
                    sum += f64::from(point.value[1]) * f64::from(value[1]);
                }
            }
            #[expect(clippy::cast_possible_truncation, reason = "scores are handed back in f32")]
            let score = (sum * f64::from(scale)) as f32;
            let [u, v] = [u, v].map(|x| u16::try_from(x).unwrap_or(u16::MAX));
            let peak = &mut peaks[usize::from(v) / TILE * columns + usize::from(u) / TILE];
            if score > peak.score {
                *peak = ScanPeak { score, position: [u, v] };
            }
        }
    }
}
