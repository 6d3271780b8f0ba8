//! Turns of an object after which it looks the same.

use nalgebra::{Point3, Unit, Vector3};

use super::Pose;

/// Steps of a turn about an axis of continuous symmetry.
const STEPS: u32 = 72;

/// What leaves an object's looks as they are, in the object frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Symmetries {
    /// Motions other than none.
    pub discrete: Vec<Pose>,
    /// Axes (direction and a point on it, metres) about which any turn may be made.
    pub continuous: Vec<(Unit<Vector3<f64>>, Point3<f64>)>,
}

impl Symmetries {
    /// All motions that leave the looks as they are, none first; turns about an axis in steps of 5 degrees.
    pub fn motions(&self) -> Vec<Pose> {
        let mut all = vec![Pose::identity()];
        all.extend(&self.discrete);
        let discrete = all.len();
        for (axis, point) in &self.continuous {
            for step in 1..STEPS {
                let angle = std::f64::consts::TAU * f64::from(step) / f64::from(STEPS);
                let turn = Pose::about(axis.into_inner() * angle, Vector3::zeros(), point);
                for k in 0..discrete {
                    all.push(turn.compose(&all[k]));
                }
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_and_discrete_motions_combine() {
        let half = Pose::about(Vector3::x() * std::f64::consts::PI, Vector3::zeros(), &Point3::origin());
        let all = Symmetries {
            discrete: vec![half],
            continuous: vec![(Vector3::z_axis(), Point3::new(0.1, 0.0, 0.0))],
        };
        let motions = all.motions();
        assert_eq!(motions.len(), 2 * 72, "both sides, all turns");
        assert_eq!(motions[0], Pose::identity(), "none comes first");
        let on_axis = Point3::new(0.1, 0.0, 0.3);
        assert!((motions[2].transform_point(&on_axis) - on_axis).norm() < 1e-12, "the axis stays");
        assert_eq!(Symmetries::default().motions().len(), 1, "no symmetry");
    }
}
