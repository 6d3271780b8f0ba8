//! Trajectories in the text format of the TUM RGB-D benchmark: `timestamp tx ty tz qx qy qz qw`, seconds and
//! metres, one pose per line, `#` begins a comment. The poses here are `camera_from_object`.

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::file::{read_text, write_atomically};
use crate::error::{Error, Result};
use crate::geometry::Pose;

/// What to do about a bad line.
const REMEDY: &str = "each line is timestamp tx ty tz qx qy qz qw (seconds, metres, unit quaternion)";

/// How far from 1 the length of a quaternion may be: files with few decimals are common.
const LENGTH_TOLERANCE: f64 = 1e-3;

/// A pose with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampedPose {
    /// Time, seconds.
    pub time_s: f64,
    /// `camera_from_object`, metres.
    pub pose: Pose,
}

/// Timestamped poses in the order of the file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory {
    /// The poses.
    pub poses: Vec<StampedPose>,
}

impl Trajectory {
    /// Reads a TUM file.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Line`] at the first bad line.
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path)?;
        let lines = (1..).zip(text.lines());
        let poses = lines
            .map(|(line, text)| (line, text.split('#').next().unwrap_or_default().trim()))
            .filter(|(_, text)| !text.is_empty())
            .map(|(line, text)| stamped(text).map_err(|e| e.in_line(path, line)))
            .collect::<Result<_>>()?;
        Ok(Self { poses })
    }

    /// Writes a TUM file; numbers in the shortest form that reads back exactly.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a number that is not finite (nothing is written then), [`Error::Io`].
    pub fn write(&self, path: &Path) -> Result<()> {
        let is_finite =
            |p: &StampedPose| p.time_s.is_finite() && p.pose.matrix().iter().all(|v| v.is_finite());
        if let Some(k) = self.poses.iter().position(|p| !is_finite(p)) {
            let what = format!("pose {k} of the trajectory");
            return Err(Error::invalid(what, "a number is not finite", "leave out lost frames"));
        }
        write_atomically(path, |out| {
            writeln!(out, "# timestamp tx ty tz qx qy qz qw")?;
            for StampedPose { time_s, pose } in &self.poses {
                let (t, q) = (pose.translation(), pose.quaternion());
                writeln!(
                    out,
                    "{time_s:?} {:?} {:?} {:?} {:?} {:?} {:?} {:?}",
                    t.x, t.y, t.z, q.i, q.j, q.k, q.w
                )?;
            }
            Ok(())
        })
    }
}

fn stamped(text: &str) -> Result<StampedPose> {
    let number = |s: &str| {
        let value = s.parse().ok().filter(|v: &f64| v.is_finite());
        value.ok_or_else(|| Error::invalid("pose", format!("{s:?} is not a finite number"), REMEDY))
    };
    let values: Vec<f64> = text.split_whitespace().map(number).collect::<Result<_>>()?;
    let &[time_s, x, y, z, i, j, k, w] = values.as_slice() else {
        return Err(Error::invalid("pose", format!("{} numbers instead of 8", values.len()), REMEDY));
    };
    let q = Quaternion::new(w, i, j, k);
    if (q.norm() - 1.0).abs() > LENGTH_TOLERANCE {
        return Err(Error::invalid("quaternion", format!("its length is {:.4}", q.norm()), REMEDY));
    }
    let pose = Pose::from_quaternion(UnitQuaternion::from_quaternion(q), Vector3::new(x, y, z));
    Ok(StampedPose { time_s, pose })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use nalgebra::Vector6;
    use proptest::prelude::*;

    const SAMPLE: &[u8] = b"# timestamp tx ty tz qx qy qz qw\n0.04 0.1 -0.2 0.5 0 0 0 1\n\n\
        0.08 0.1 -0.2 0.6 0.6 0 0 0.8 # a comment\n";

    #[test]
    fn reads_by_hand() {
        let poses = with_file("t.txt", SAMPLE, Trajectory::read).unwrap().poses;
        assert_eq!(poses.len(), 2, "comments and empty lines are skipped");
        assert_eq!(poses[0].pose, Pose::from_quaternion(UnitQuaternion::identity(), [0.1, -0.2, 0.5].into()));
        let angle = poses[1].pose.rotation_vector();
        assert!((angle - Vector3::new(2.0 * 0.6_f64.asin(), 0.0, 0.0)).norm() < 1e-12, "{angle}");
    }

    #[test]
    fn bad_lines_are_named() {
        for (line, expected) in [
            ("0.1 0 0 0 0 0 0", "7 numbers"),
            ("0.1 0 0 nan 0 0 0 1", "finite"),
            ("0.1 0 0 0 0 0 0 2", "length"),
            ("zero 0 0 0 0 0 0 1", "zero"),
        ] {
            let bytes = [SAMPLE, line.as_bytes()].concat();
            let text = with_file("t.txt", &bytes, Trajectory::read).unwrap_err().to_string();
            assert!(text.contains("t.txt:5:") && text.contains(expected), "{line}: {text}");
        }
    }

    proptest! {
        #[test]
        fn poses_round_trip(p in prop::array::uniform6(-1.5..1.5f64), time_s in 0.0..1e9f64) {
            let pose = Pose::from_params(&Vector6::from(p));
            let trajectory = Trajectory { poses: vec![StampedPose { time_s, pose }] };
            let again = with_file("t.txt", b"", |path| {
                trajectory.write(path).expect("written");
                Trajectory::read(path).expect("read")
            });
            prop_assert_eq!(again.poses[0].time_s, time_s);
            prop_assert_eq!(again.poses[0].pose.translation(), pose.translation());
            prop_assert!((again.poses[0].pose.matrix() - pose.matrix()).norm() < 1e-14);
        }

        #[test]
        fn no_damaged_file_panics(bytes in damaged(SAMPLE)) {
            let _ = with_file("t.txt", &bytes, Trajectory::read);
        }
    }
}
