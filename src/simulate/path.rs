//! Smooth camera paths, known for every frame number, so that a shorter sequence is the beginning of a longer one.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::SceneKind;
use super::random::{Purpose, Stream};
use crate::geometry::Pose;

const TURN: f64 = 2.0 * std::f64::consts::PI;

/// Frames in which the box turns from one end of its swing to the other.
const BOX_SWING_FRAMES: f64 = 120.0;

/// A sum of two sines with seeded periods and phases, never beyond its amplitude.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wave {
    amplitude: f64,
    rates: [f64; 2],
    phases: [f64; 2],
}

impl Wave {
    /// A wave whose slower sine has about the given period in frames.
    pub(super) fn new(amplitude: f64, period: f64, random: &mut Stream) -> Self {
        let slow = TURN / (period * random.range(0.9, 1.15));
        let rates = [slow, slow * random.range(1.6, 2.1)];
        Self { amplitude, rates, phases: [random.range(0.0, TURN), random.range(0.0, TURN)] }
    }

    /// Value at a frame.
    pub(super) fn at(&self, frame: f64) -> f64 {
        let sine = |k: usize| libm::sin(self.rates[k] * frame + self.phases[k]);
        self.amplitude * (0.72 * sine(0) + 0.28 * sine(1))
    }
}

/// The path of one sequence.
#[derive(Debug, Clone)]
pub(super) struct Path {
    scene: SceneKind,
    position: [Wave; 3],
    sway: [Wave; 3],
    tilt_rate: f64,
    axis_rate: f64,
    start: f64,
    flipped: bool,
}

impl Path {
    /// The path of a sequence; sequences of one scene differ.
    pub(super) fn new(scene: SceneKind, seed: u64, sequence: u32) -> Self {
        let index = u64::from(sequence) << 8 | scene as u64;
        let mut random = Stream::new(seed, Purpose::Path, index);
        // x, y, z in metres; x, y, z rotations in radians.
        let (position, sway) = match scene {
            SceneKind::Relief => ([0.034, 0.022, 0.078], [0.0, 0.0, 0.5]),
            SceneKind::Box => ([0.022, 0.016, 0.022], [0.07, 0.05, 0.06]),
        };
        let mut wave = |amplitude: f64, period: f64| Wave::new(amplitude, period, &mut random);
        Self {
            scene,
            position: [wave(position[0], 105.0), wave(position[1], 90.0), wave(position[2], 120.0)],
            sway: [wave(sway[0], 85.0), wave(sway[1], 75.0), wave(sway[2], 125.0)],
            tilt_rate: TURN / random.range(68.0, 82.0),
            axis_rate: TURN / random.range(105.0, 135.0) * if random.chance(0.5) { 1.0 } else { -1.0 },
            start: random.range(0.0, TURN),
            flipped: sequence.is_multiple_of(2),
        }
    }

    /// `camera_from_object` at a frame.
    pub(super) fn pose(&self, frame: f64) -> Pose {
        let shift = Vector3::from(self.position.map(|w| w.at(frame)));
        match self.scene {
            SceneKind::Relief => self.relief(frame, shift),
            SceneKind::Box => self.swing(frame, shift),
        }
    }

    /// Tilt up to 38 degrees about an axis that wanders in the image plane, roll up to 29 degrees.
    fn relief(&self, frame: f64, shift: Vector3<f64>) -> Pose {
        let tilt = 38_f64.to_radians() * 0.5 * (1.0 - libm::cos(self.tilt_rate * frame + 0.4));
        let axis = self.axis_rate * frame + self.start;
        let tilted = rotation(Vector3::new(tilt * libm::cos(axis), tilt * libm::sin(axis), 0.0));
        let rolled = rotation(Vector3::new(0.0, 0.0, self.sway[2].at(frame)));
        Pose::from_quaternion(tilted * rolled, shift + Vector3::new(0.0, 0.0, 0.61))
    }

    /// Seen from above, turning 45 degrees about the vertical axis and back.
    fn swing(&self, frame: f64, shift: Vector3<f64>) -> Pose {
        let swing = libm::cos(0.5 * TURN * frame / BOX_SWING_FRAMES) * if self.flipped { -1.0 } else { 1.0 };
        let turned = rotation(Vector3::new(0.0, (40.0 - 22.5 * swing).to_radians(), 0.0));
        let raised = rotation(Vector3::new(30_f64.to_radians(), 0.0, 0.0));
        let swayed = rotation(Vector3::from(self.sway.map(|w| w.at(frame))));
        Pose::from_quaternion(swayed * raised * turned, shift + Vector3::new(0.0, 0.0, 0.45))
    }
}

/// Rotation by a rotation vector, radians, without the platform's sine.
pub(super) fn rotation(vector: Vector3<f64>) -> UnitQuaternion<f64> {
    let half = 0.5 * vector.norm();
    // sin(h) / (2 h) tends to 1/2.
    let scale = if half > 1e-12 { 0.5 * libm::sin(half) / half } else { 0.5 };
    let [x, y, z] = (vector * scale).into();
    UnitQuaternion::new_normalize(Quaternion::new(libm::cos(half), x, y, z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_agrees_with_the_rotation_vector() {
        for v in [Vector3::new(0.3, -0.2, 0.9), Vector3::new(0.0, 1e-9, 0.0), Vector3::zeros()] {
            let expected = UnitQuaternion::from_scaled_axis(v);
            assert!(rotation(v).angle_to(&expected) < 1e-7, "{v}");
        }
    }

    #[test]
    fn relief_path_stays_in_its_range() {
        for sequence in [1, 2] {
            let path = Path::new(SceneKind::Relief, 1, sequence);
            let poses: Vec<Pose> = (0..120).map(|k| path.pose(f64::from(k))).collect();
            let tilt = |p: &Pose| (-p.rotate(&Vector3::z())).angle(&-Vector3::z()).to_degrees();
            let depth = |p: &Pose| p.translation().z;
            let most = |f: &dyn Fn(&Pose) -> f64| poses.iter().map(f).fold(f64::MIN, f64::max);
            let least = |f: &dyn Fn(&Pose) -> f64| poses.iter().map(f).fold(f64::MAX, f64::min);
            assert!(most(&tilt) < 38.1 && most(&tilt) > 33.0, "tilt up to {}", most(&tilt));
            assert!(least(&depth) > 0.53 && most(&depth) < 0.69, "{}..{} m", least(&depth), most(&depth));
            assert!(most(&depth) - least(&depth) > 0.08, "sequence {sequence} must change its distance");
        }
    }

    #[test]
    fn box_turns_45_degrees() {
        let path = Path::new(SceneKind::Box, 1, 1);
        let yaw = |k: f64| {
            let x = path.pose(k).rotate(&Vector3::x());
            libm::atan2(-x.z, x.x).to_degrees()
        };
        let turned = yaw(BOX_SWING_FRAMES) - yaw(0.0);
        assert!((turned - 45.0).abs() < 12.0, "turned by {turned}");
    }
}
