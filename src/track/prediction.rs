//! Where the object will be in the next frame: constant velocity of its centre and of its rotation.

use nalgebra::{Point3, UnitQuaternion};

use crate::geometry::Pose;

/// The last two believed poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    last: Pose,
    before: Option<Pose>,
}

impl Motion {
    pub(super) fn at_rest(pose: Pose) -> Self {
        Self { last: pose, before: None }
    }

    /// A pose that was looked for: none before it is known, and the next one will be motion.
    pub(super) fn found(pose: Pose) -> Self {
        Self { last: pose, before: Some(pose) }
    }

    /// Last believed pose.
    pub(super) fn last(&self) -> Pose {
        self.last
    }

    /// After a frame that was believed. The first frame corrects the start pose, which is no motion.
    pub(super) fn advance(self, pose: Pose) -> Self {
        Self { last: pose, before: Some(self.before.map_or(pose, |_| self.last)) }
    }

    /// After a frame that was lost: stay where the object was seen last.
    pub(super) fn stop(self) -> Self {
        Self::at_rest(self.last)
    }

    /// Pose in the next frame. Centre and rotation are extrapolated separately in the camera frame, both exactly on
    /// SE(3): products of nearly-rotations would drift.
    pub(super) fn predict(&self, centre: &Point3<f64>) -> Pose {
        let Some(before) = self.before else { return self.last };
        let (now, then) = (self.last.transform_point(centre), before.transform_point(centre));
        let turn: UnitQuaternion<f64> = self.last.quaternion() * before.quaternion().inverse();
        let rotation = UnitQuaternion::new_normalize((turn * self.last.quaternion()).into_inner());
        let next = now + (now - then);
        Pose::from_quaternion(rotation, next.coords - rotation * centre.coords)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector3, Vector6};

    #[test]
    fn constant_velocity_is_continued() {
        let centre = Point3::new(0.05, 0.03, -0.04);
        let pose = |k: f64| {
            let r = UnitQuaternion::from_scaled_axis(Vector3::new(0.02, -0.05, 0.01) * k);
            let c = Vector3::new(0.01 * k, -0.004 * k, 0.6 + 0.002 * k);
            Pose::from_quaternion(r, c - r * centre.coords)
        };
        let motion = Motion::at_rest(pose(0.0)).advance(pose(0.0)).advance(pose(1.0));
        let error = motion.predict(&centre).compose(&pose(2.0).inverse());
        assert!((error.matrix() - nalgebra::Matrix4::identity()).norm() < 1e-12, "{}", error.matrix());
    }

    #[test]
    fn long_predictions_stay_rotations() {
        let step = Pose::from_params(&Vector6::new(0.001, 0.0, 0.0, 0.01, 0.02, -0.01));
        let mut motion = Motion::at_rest(Pose::identity()).advance(step);
        for _ in 0..10_000 {
            motion = motion.advance(motion.predict(&Point3::origin()));
        }
        let r = motion.predict(&Point3::origin()).rotation();
        assert!((r.transpose() * r - nalgebra::Matrix3::identity()).norm() < 1e-12, "{r}");
    }

    #[test]
    fn the_first_frame_is_a_correction_not_a_motion() {
        let seen = Pose::from_params(&Vector6::new(0.01, 0.0, 0.6, 0.1, 0.0, 0.0));
        let motion = Motion::at_rest(Pose::identity()).advance(seen);
        assert_eq!(motion.predict(&Point3::origin()), seen, "no velocity yet");
    }
}
