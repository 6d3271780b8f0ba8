//! The cell's files are consistent, and their noise is as asked for.

use super::*;
use crate::geometry::hand_eye::calibrate;
use crate::geometry::pnp;
use crate::geometry::rigid_fit::rigid_fit;
use crate::geometry::stereo::ClickOptions;
use nalgebra::Point3;

fn cell(change: impl FnOnce(&mut CellOptions)) -> Cell {
    let mut options = CellOptions { frames: 32, ..CellOptions::default() };
    change(&mut options);
    Cell::new(options).expect("good options")
}

#[test]
fn both_cameras_see_the_whole_object_from_the_front() {
    let cell = cell(|_| ());
    let rig = cell.stereo().rig;
    for (camera, pose) in [rig.left, rig.right].into_iter().zip(cell.frontal_poses()) {
        let pixels = cell.pixels(&camera, &pose, None);
        assert!(pixels.iter().all(|p| camera.contains(p, 20.0)), "{pixels:?}");
        let front = -pose.rotate(&Vector3::z());
        assert!(front.z < -0.97, "seen from the front: {front}");
    }
    assert!((rig.baseline() - BASELINE).abs() < 1e-12, "{} m", rig.baseline());
}

/// Without noise everything is consistent: clicks give the landmarks, annotations the poses, the robot the
/// hand-eye transform.
#[test]
fn exact_files_give_the_exact_cell() {
    let cell = cell(|o| o.click_noise_px = 0.0);
    let points = cell.stereo().rig.triangulate_all(&cell.clicks().pairs, &ClickOptions::default()).unwrap();
    let found: Vec<Point3<f64>> = points.iter().map(|p| p.position).collect();
    let exact: Vec<Point3<f64>> = cell.landmarks().iter().map(|l| l.position).collect();
    let (pose, rms) = rigid_fit(&exact, &found).unwrap();
    let left = cell.frontal_poses()[0];
    assert!(rms < 1e-9 && (pose.matrix() - left.matrix()).norm() < 1e-8, "{rms} m");
    for (frame, pixels) in cell.annotations(1, false).frames {
        let fit = pnp::solve(cell.sequences[1].camera(), &exact, &pixels).unwrap();
        let off = fit.camera_from_object.matrix() - cell.sequences[1].pose(frame as usize).matrix();
        assert!(off.norm() < 1e-7, "frame {frame}: {off}");
    }
    let robot: Vec<Pose> = cell.robot(0, false).into_values().collect();
    let seen: Vec<Pose> = (0..robot.len()).map(|k| cell.sequences[0].pose(k)).collect();
    let found = calibrate(&robot, &seen).unwrap();
    let off = found.effector_from_camera.matrix() - cell.hand_eye().matrix();
    assert!(off.norm() < 1e-7, "{off}");
    let off = found.base_from_object.matrix() - cell.base_from_object().matrix();
    assert!(off.norm() < 1e-7, "{off}");
}

#[test]
fn noise_is_as_asked_for_and_repeats() {
    let noisy = |o: &mut CellOptions| {
        (o.click_noise_px, o.kinematic_noise_mm, o.kinematic_noise_deg) = (0.5, 2.0, 0.1);
    };
    let cell = cell(noisy);
    let again = self::cell(noisy);
    assert_eq!(cell.clicks(), again.clicks(), "clicks repeat");
    assert_eq!(cell.robot(0, false), again.robot(0, false), "the robot repeats");
    let (noisy, exact) = (cell.annotations(0, false), cell.annotations(0, true));
    let off = noisy.frames.iter().flat_map(|(f, pixels)| pixels.iter().zip(&exact.frames[f]));
    let squares: Vec<f64> = off.map(|(a, b)| (a - b).norm_squared() / 2.0).collect();
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    let sigma = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert_eq!(squares.len(), 16 * 76, "16 views of 76 landmarks");
    assert!((sigma - 0.5).abs() < 0.03, "{sigma} px");
    let (noisy, exact) = (cell.robot(0, false), cell.robot(0, true));
    let off = noisy.iter().map(|(k, p)| exact[k].inverse().compose(p));
    let (mut t, mut r) = (0.0, 0.0);
    for off in off {
        t += off.translation().norm_squared() / 96.0;
        r += off.rotation_vector().norm_squared() / 96.0;
    }
    assert!((t.sqrt() * 1000.0 - 2.0).abs() < 0.5, "{} mm", t.sqrt() * 1000.0);
    assert!((r.sqrt().to_degrees() - 0.1).abs() < 0.025, "{} deg", r.sqrt().to_degrees());
}

#[test]
fn wrong_options_are_named() {
    let refused = |change: fn(&mut CellOptions)| {
        let mut options = CellOptions::default();
        change(&mut options);
        Cell::new(options).expect_err("refused").to_string()
    };
    assert!(refused(|o| o.click_noise_px = -1.0).contains("click noise: -1 px"), "clicks");
    assert!(refused(|o| o.kinematic_noise_deg = 9.0).contains("9 degrees"), "angle");
    assert!(refused(|o| o.kinematic_noise_mm = f64::NAN).contains("NaN mm"), "NaN");
    assert!(refused(|o| o.training_views = 0).contains("training views"), "views");
    assert!(refused(|o| o.frames = 0).contains("frames"), "frames");
}
