//! Mild changes of exposure and of the direction of light.

use nalgebra::Vector3;

use super::path::Wave;
use super::random::{Purpose, Stream};

/// Exposure of the camera and one distant lamp: grey = gain * shade(normal) * print + bias.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Factor on the whole image.
    pub gain: f64,
    /// Grey levels added to the whole image.
    pub bias: f64,
    /// Unit vector towards the lamp, camera frame.
    pub direction: Vector3<f64>,
    /// Share of the light that comes from the lamp, 0..1; the rest comes from everywhere.
    pub diffuse: f64,
}

impl Default for Light {
    /// Everything looks as printed.
    fn default() -> Self {
        Self { gain: 1.0, bias: 0.0, direction: -Vector3::z(), diffuse: 0.0 }
    }
}

impl Light {
    /// Factor (0..1) on the print of a surface with this outward unit normal, camera frame.
    pub fn shade(&self, normal: &Vector3<f64>) -> f64 {
        1.0 - self.diffuse + self.diffuse * normal.dot(&self.direction).max(0.0)
    }
}

/// Light that changes slowly over a sequence.
#[derive(Debug, Clone)]
pub(super) struct LightPath {
    gain: Wave,
    bias: Wave,
    sideways: Wave,
    upwards: Wave,
}

impl LightPath {
    /// The light of a sequence; bright enough to be seen, mild enough that nothing saturates.
    pub(super) fn new(seed: u64, sequence: u32) -> Self {
        let mut random = Stream::new(seed, Purpose::Light, u64::from(sequence));
        Self {
            gain: Wave::new(0.08, 90.0, &mut random),
            bias: Wave::new(6.0, 70.0, &mut random),
            sideways: Wave::new(0.9, 80.0, &mut random),
            upwards: Wave::new(0.45, 110.0, &mut random),
        }
    }

    /// The light at a frame.
    pub(super) fn at(&self, frame: f64) -> Light {
        let towards = Vector3::new(self.sideways.at(frame), self.upwards.at(frame) - 0.55, -1.0);
        Light {
            gain: 0.95 + self.gain.at(frame),
            bias: self.bias.at(frame),
            direction: towards.normalize(),
            diffuse: 0.5,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shade_falls_with_the_angle_and_the_default_changes_nothing() {
        let light = Light { diffuse: 0.5, ..Light::default() };
        assert!((light.shade(&-Vector3::z()) - 1.0).abs() < 1e-12, "facing the lamp");
        assert!((light.shade(&Vector3::x()) - 0.5).abs() < 1e-12, "edge-on");
        assert!((Light::default().shade(&Vector3::x()) - 1.0).abs() < 1e-12, "no lamp");
    }

    #[test]
    fn changes_are_smooth_and_never_saturate_the_print() {
        let path = LightPath::new(1, 1);
        for k in 0..300 {
            let (a, b) = (path.at(f64::from(k)), path.at(f64::from(k) + 1.0));
            assert!(a.direction.angle(&b.direction) < 0.12 && (a.gain - b.gain).abs() < 0.02, "frame {k}");
            assert!(
                225.0 * a.gain + a.bias < 250.0 && 31.0 * a.gain * 0.4 + a.bias > 2.0,
                "frame {k}: {a:?}"
            );
        }
    }
}
