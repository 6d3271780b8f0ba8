//! Poses that may be right, and which of them are the same.

use nalgebra::Point2;

use crate::geometry::{Camera, Pose};
use crate::model::Model;

/// A pose and how well it fits.
#[derive(Debug, Clone)]
pub(super) struct Hypothesis {
    pub(super) pose: Pose,
    /// z = sum t.F / sqrt(sum |t|^2) over all pixels of the object; of keypoints, how many agree.
    pub(super) agreement: f64,
}

/// Corners of the object's box in the image; a corner behind the camera is far away.
pub(super) fn corners(model: &Model, camera: &Camera, pose: &Pose) -> [Point2<f64>; 8] {
    let far = Point2::new(1e6, 1e6);
    model.shape.corners.map(|x| camera.project(&pose.transform_point(&x)).unwrap_or(far))
}

/// Root mean square distance of the corners, pixels.
pub(super) fn distance_px(a: &[Point2<f64>; 8], b: &[Point2<f64>; 8]) -> f64 {
    (a.iter().zip(b).map(|(p, q)| (p - q).norm_squared()).sum::<f64>() / 8.0).sqrt()
}

/// The best `most`, each farther than `apart` pixels (full size) from all better ones. The order of equal ones does not
/// depend on chance.
pub(super) fn best_distinct(
    mut all: Vec<Hypothesis>,
    model: &Model,
    camera: &Camera,
    apart: f64,
    most: usize,
) -> Vec<Hypothesis> {
    all.retain(|h| h.agreement.is_finite());
    all.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
    let mut kept: Vec<Hypothesis> = Vec::new();
    let mut seen: Vec<[Point2<f64>; 8]> = Vec::new();
    for hypothesis in all {
        if kept.len() == most {
            break;
        }
        let at = corners(model, camera, &hypothesis.pose);
        if seen.iter().all(|other| distance_px(&at, other) > apart) {
            kept.push(hypothesis);
            seen.push(at);
        }
    }
    kept
}
