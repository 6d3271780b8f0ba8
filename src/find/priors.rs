//! What is known beforehand and narrows the search.

use crate::geometry::{Camera, Pose};

/// A last pose narrows the grid to turns of at most this much from it, radians (45 degrees).
const NEAR_TURN: f64 = std::f64::consts::FRAC_PI_4;
/// The same for the distance, as a factor.
const NEAR_DISTANCE: f64 = 1.35;
/// An object may be larger than its box by this factor.
const BOX_SLACK: f64 = 1.25;

/// What is known beforehand; all of it must hold.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Priors {
    /// Box (left, top, width, height; pixels of the rectified image) that holds the object.
    pub image_box: Option<[f64; 4]>,
    /// Distance (nearest, farthest; metres) of the object's centre from the camera.
    pub distance: Option<(f64, f64)>,
    /// The last pose that was believed (`camera_from_object`): orientation and distance are similar, the position is
    /// not limited.
    pub last_seen: Option<Pose>,
}

impl Priors {
    /// May the object look like this? `pose` has its centre on the optical axis at `distance`, `radius_px` is half of
    /// its size in the (full-size) image.
    pub(super) fn allow_view(&self, pose: &Pose, distance: f64, radius_px: f64, step: f64) -> bool {
        if let Some((near, far)) = self.distance
            && !(distance * step >= near && distance <= far * step)
        {
            return false;
        }
        if let Some([_, _, width, height]) = self.image_box
            && 2.0 * radius_px > BOX_SLACK * width.max(height)
        {
            return false;
        }
        let Some(last) = &self.last_seen else { return true };
        // Seen from elsewhere in the image the object is turned with the line of sight; small against the limit.
        let turned = last.quaternion().angle_to(&pose.quaternion());
        let ratio = distance / last.translation().norm().max(f64::MIN_POSITIVE);
        turned <= NEAR_TURN && (1.0 / NEAR_DISTANCE..=NEAR_DISTANCE).contains(&ratio)
    }

    /// May the object's centre be at this pixel of the image at a level?
    pub(super) fn allow_position(&self, level: usize, camera: &Camera, u: f64, v: f64) -> bool {
        let Some([left, top, width, height]) = self.image_box else { return true };
        let factor = f64::from(camera.width) / f64::from(camera.at_level(level).width);
        let [u, v] = [u, v].map(|x| (x + 0.5) * factor - 0.5);
        u >= left - factor && v >= top - factor && u <= left + width + factor && v <= top + height + factor
    }
}
