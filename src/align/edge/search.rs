//! The search of one edge along its normal in the frame.

use image::GrayImage;
use nalgebra::{Point2, Vector2};

use super::points::EdgePoint;
use crate::geometry::{Camera, Pose};
use crate::imaging::sample::bilinear;

/// Slopes below this are noise, grey levels per pixel.
const MIN_SLOPE: f64 = 4.0;
/// A template edge is recognised from this share of its expected slope on.
const MIN_SHARE: f64 = 0.4;
/// ... and up to this multiple.
const MAX_SHARE: f64 = 2.5;
/// Longest search to each side, pixels.
pub(super) const MAX_REACH: usize = 8;

/// An edge point in the frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Line {
    pub(super) at: Point2<f64>,
    /// Unit normal, towards the brighter side where that is known.
    pub(super) normal: Vector2<f64>,
    /// Expected slope, grey levels per pixel; `None`: any sign and size.
    slope: Option<f64>,
}

impl Line {
    /// Where the point is seen at a pose, and where its normal leads; `None` if behind the camera or seen end-on.
    pub(super) fn new(edge: &EdgePoint, camera: &Camera, pose: &Pose) -> Option<Self> {
        let project = |x| camera.project(&pose.transform_point(&x));
        let at = project(edge.point)?;
        let tangent = project(edge.point + edge.along)? - at;
        if tangent.norm() < 0.2 {
            return None;
        }
        let tangent = tangent.normalize();
        let normal = Vector2::new(tangent.y, -tangent.x);
        let Some((bright, slope)) = edge.bright else { return Some(Self { at, normal, slope: None }) };
        // One template pixel across the edge is this many pixels of the frame.
        let across = (project(edge.point + bright)? - at).dot(&normal);
        (across.abs() > 0.1).then(|| Self {
            at,
            normal: normal * across.signum(),
            slope: Some(slope / across.abs()),
        })
    }

    /// Signed distance (pixels, along the normal) from the expected place to the nearest edge that fits, up to `reach`.
    pub(super) fn search(&self, image: &GrayImage, reach: usize) -> Option<f64> {
        let reach = reach.min(MAX_REACH);
        // Values at -(reach + 2) .. reach + 2, averaged over three pixels along the edge.
        let mut values = [0.0; 2 * MAX_REACH + 5];
        let values = &mut values[..2 * reach + 5];
        let tangent = Vector2::new(-self.normal.y, self.normal.x);
        for (k, value) in values.iter_mut().enumerate() {
            let here = self.at + self.normal * offset(k, reach + 2);
            for side in [-1.0, 0.0, 1.0] {
                let p = here + tangent * side;
                *value += bilinear(image, p.x, p.y)? / 3.0;
            }
        }
        // Slopes at -(reach + 1) .. reach + 1.
        let slope = |k: usize| {
            let slope = (values[k + 2] - values[k]) / 2.0;
            if self.slope.is_some() { slope } else { slope.abs() }
        };
        let least = self.slope.map_or(MIN_SLOPE, |s| f64::max(MIN_SLOPE, MIN_SHARE * s));
        let most = self.slope.map_or(f64::INFINITY, |s| MAX_SHARE * s);
        let mut best: Option<f64> = None;
        for k in 1..=2 * reach + 1 {
            let [before, here, after] = [slope(k - 1), slope(k), slope(k + 1)];
            if here < least || here > most || before > here || after >= here {
                continue;
            }
            let peak =
                offset(k, reach + 1) + 0.5 * (before - after) / (before - 2.0 * here + after).min(-1e-9);
            if best.is_none_or(|b| peak.abs() < b.abs()) {
                best = Some(peak);
            }
        }
        best
    }
}

/// Position of sample `k` when sample `middle` is the expected place.
fn offset(k: usize, middle: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a few samples")]
    let (k, middle) = (k as f64, middle as f64);
    k - middle
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A soft step at u = 20.3, brighter to the right.
    fn step() -> GrayImage {
        GrayImage::from_fn(40, 30, |u, _| {
            let value = 120.0 + 80.0 * ((f64::from(u) - 20.3) / 1.5).tanh();
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "40..200")]
            image::Luma([value.round() as u8])
        })
    }

    #[test]
    fn an_edge_is_found_between_pixels_and_only_with_its_sign() {
        let at = Point2::new(18.6, 12.4);
        let line = |u: f64, slope| Line { at, normal: Vector2::new(u, 0.0), slope };
        let found = line(1.0, Some(45.0)).search(&step(), 4).expect("an edge");
        assert!((found - 1.7).abs() < 0.05, "{found} is not 1.7");
        assert_eq!(line(-1.0, Some(45.0)).search(&step(), 4), None, "the other sign");
        assert_eq!(line(1.0, Some(400.0)).search(&step(), 4), None, "far too weak");
        let either = line(-1.0, None).search(&step(), 4).expect("an edge of any sign");
        assert!((either + 1.7).abs() < 0.05, "{either} is not -1.7");
        assert_eq!(line(1.0, Some(45.0)).search(&step(), 1), None, "out of reach");
    }
}
