//! Several cameras: is the pose more certain with two than with one, and does one that sees nothing do no harm? Simulated,
//! where the truth is known.

mod support;

use aam6d::geometry::Pose;
use aam6d::imaging::GrayImage;
use aam6d::simulate::{SceneKind, View};
use aam6d::track::{RigCamera, Status, Tracked};
use nalgebra::{Rotation3, Vector3};
use support::pair::Pair;
use support::tracking::{cpu, distance_px, say};

const FRAMES: usize = 24;

impl Pair {
    /// Root mean square of the error of the centre, millimetres, and of the rotation, degrees.
    fn rms(&self, tracked: &[Tracked]) -> [f64; 2] {
        let centre = &self.model.shape.centre;
        let squares = tracked.iter().enumerate().map(|(k, t)| {
            assert_eq!(t.status, Status::Tracking, "frame {k}");
            let (pose, truth) = (t.estimate.camera_from_object, self.sequence.pose(k));
            let mm = (pose.transform_point(centre) - truth.transform_point(centre)).norm() * 1e3;
            let degrees = pose.compose(&truth.inverse()).rotation_vector().norm().to_degrees();
            [mm * mm, degrees * degrees]
        });
        let sum = squares.fold([0.0, 0.0], |a, b| [a[0] + b[0], a[1] + b[1]]);
        sum.map(|s| (s / tracked.len() as f64).sqrt())
    }

    fn joint(&self, other: RigCamera) -> [f64; 2] {
        let mut rig = self.rig(other);
        rig.start_at(self.start());
        let track = |[a, b]: &[GrayImage; 2]| rig.track(&[a, b]).expect("good frames");
        self.rms(&self.frames.iter().map(track).collect::<Vec<_>>())
    }

    fn alone(&self) -> [f64; 2] {
        let mut tracker = self.tracker(cpu());
        tracker.start_at(self.start());
        let track = |[a, _]: &[GrayImage; 2]| tracker.track(a).expect("good frames");
        self.rms(&self.frames.iter().map(track).collect::<Vec<_>>())
    }
}

fn better(scene: SceneKind) {
    let pair = Pair::new(scene, FRAMES);
    let (alone, joint) = (pair.alone(), pair.joint(pair.other.clone()));
    // A second camera that is not where it is said to be must show.
    let off = Pose::new(Rotation3::identity(), Vector3::new(0.002, 0.0, 0.0));
    let place = off.compose(&pair.other.camera_from_reference);
    let wrong = pair.joint(RigCamera { camera_from_reference: place, ..pair.other.clone() });
    say(format_args!(
        "{scene:?}: alone {alone:.4?} mm and degrees, both {joint:.4?}, badly calibrated {wrong:.4?}"
    ));
    assert!(joint[0] < 0.8 * alone[0], "{joint:?} with both, {alone:?} alone");
    assert!(wrong[0] > 5.0 * joint[0], "a camera 2 mm off is not noticed: {wrong:?} and {joint:?}");
}

#[test]
fn two_cameras_are_better_than_one_relief() {
    better(SceneKind::Relief);
}

#[test]
fn two_cameras_are_better_than_one_box() {
    better(SceneKind::Box);
}

#[test]
fn one_camera_may_see_nothing() {
    let pair = Pair::new(SceneKind::Box, FRAMES);
    let blind = GrayImage::from_pixel(640, 480, image::Luma([90]));
    let mut rig = pair.rig(pair.other.clone());
    rig.start_at(pair.start());
    let vertices = &pair.sequence.object().mesh.vertices;
    for (k, [a, b]) in pair.frames.iter().enumerate() {
        // First the other camera is blind, then the reference camera; in between both for a frame.
        let seen = match k {
            0..8 => [a, &blind],
            8 => [&blind, &blind],
            _ => [&blind, b],
        };
        let tracked = rig.track(&seen).expect("good frames");
        let (pose, truth) = (tracked.estimate.camera_from_object, pair.sequence.pose(k));
        let px = distance_px(&pair.camera, vertices, &truth, &pose);
        if k == 8 {
            assert!(!tracked.status.has_pose(), "nothing to see, and still {:?}", tracked.status);
        } else {
            assert!(
                tracked.status == Status::Tracking && px < 1.5,
                "frame {k}: {:?}, {px} px",
                tracked.status
            );
        }
    }
}

#[test]
fn the_first_pose_may_come_from_either_camera() {
    let pair = Pair::new(SceneKind::Relief, FRAMES);
    let empty = pair.sequence.renderer().render_view(&View {
        pose: Pose::new(Rotation3::identity(), Vector3::new(50.0, 0.0, 1.0)),
        ..View::default()
    });
    let mut rig = pair.rig(pair.other.clone());
    let before = rig.track(&[&empty, &empty]).expect("good frames");
    assert_eq!(before.status, Status::Searching, "nothing is there");
    let tracked = rig.track(&[&empty, &pair.frames[0][1]]).expect("good frames");
    let pose = tracked.estimate.camera_from_object;
    let px = distance_px(&pair.camera, &pair.sequence.object().mesh.vertices, &pair.sequence.pose(0), &pose);
    assert!(tracked.status == Status::Tracking && px < 1.5, "{:?}, {px} px", tracked.status);
    let refused = rig.track(&[&empty]).expect_err("one image for two cameras");
    assert!(refused.to_string().contains("1 images for 2 cameras"), "{refused}");
}
