//! Writes the robot cell: the BOP data set of the sequences, and the files that people and robot contribute.

use std::path::Path;

use super::cell::{Cell, CellOptions};
use super::export::{
    camera_json, create_folder, pose_json, pretty, scene_camera_json, write_folder, write_frames,
    write_models, write_png, write_sequence, write_text,
};
use crate::dataset::landmarks::{annotations_json, landmarks_json};
use crate::dataset::robot::{HandEyeTransforms, hand_eye_json, robot_json};
use crate::dataset::stereo::{clicks_json, stereo_json};
use crate::error::Result;
use crate::geometry::Pose;

/// Writes the cell to a new folder; `docs/formats.md` lists the files. Scenes 1 and 2 are the sequences, 3 and 4 the
/// frontal pair. `progress` is called with the number of frames written and of all frames.
///
/// # Errors
/// As [`super::write_dataset`].
pub fn write_cell(out: &Path, options: &CellOptions, mut progress: impl FnMut(usize, usize)) -> Result<()> {
    options.validate()?;
    write_folder(out, |folder| {
        let cell = Cell::new(*options)?;
        write_models(&folder.join("models"), &cell.sequences()[0].object().mesh)?;
        write_text(&folder.join("camera.json"), &pretty(&camera_json(cell.sequences()[0].camera())))?;
        write_shape(folder, &cell)?;
        let mut done = 0;
        for index in 0..2 {
            let scene = folder.join(format!("test/{:06}", index + 1));
            write_sequence(&scene, &cell.sequences()[index], || {
                done += 1;
                progress(done, 2 * options.frames);
            })?;
            write_scene(&scene, &cell, index)?;
        }
        Ok(())
    })
}

/// The frontal pair, its calibration, its clicks, and the landmarks as they are.
fn write_shape(folder: &Path, cell: &Cell) -> Result<()> {
    let stereo = cell.stereo();
    write_text(&folder.join("stereo.json"), &stereo_json(&stereo))?;
    write_text(&folder.join("clicks.json"), &clicks_json(&cell.clicks()))?;
    write_text(&folder.join("landmarks_gt.json"), &landmarks_json(&cell.landmarks(), "object"))?;
    let views = [(stereo.left_scene, stereo.rig.left), (stereo.right_scene, stereo.rig.right)];
    for (((scene, camera), pose), image) in
        views.into_iter().zip(cell.frontal_poses()).zip(cell.frontal_images()?)
    {
        let scene = folder.join(format!("test/{scene:06}"));
        create_folder(&scene.join("gray"))?;
        write_png(&scene.join("gray/000000.png"), &image)?;
        write_frames(&scene.join("scene_camera.json"), 1, |_| scene_camera_json(&camera))?;
        write_frames(&scene.join("scene_gt.json"), 1, |_| pose_json(&pose))?;
    }
    Ok(())
}

/// What belongs to one sequence beside its images: annotations, robot, hand-eye transform, each with the exact values.
fn write_scene(scene: &Path, cell: &Cell, index: usize) -> Result<()> {
    for (suffix, exact) in [("", false), ("_gt", true)] {
        let path = |stem: &str| scene.join(format!("{stem}{suffix}.json"));
        write_text(&path("annotations"), &annotations_json(&cell.annotations(index, exact)))?;
        write_text(&path("scene_robot"), &robot_json(&cell.robot(index, exact)))?;
        let effector_from_camera: Pose = if exact { cell.hand_eye() } else { cell.calibrated_hand_eye() };
        let base_from_object = Some(cell.base_from_object());
        let text =
            hand_eye_json(&HandEyeTransforms { effector_from_camera, base_from_object }, "simulated", &[]);
        write_text(&path("hand_eye"), &text)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::landmarks::{read_annotations, read_landmarks};
    use crate::dataset::robot::{read_hand_eye, read_robot};
    use crate::dataset::stereo::{Clicks, read_clicks, read_stereo};
    use crate::dataset::{Dataset, PoseSource};
    use nalgebra::Point2;

    #[test]
    fn the_readers_read_what_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("cell");
        let options =
            CellOptions { frames: 2, training_views: 2, kinematic_noise_mm: 1.0, ..CellOptions::default() };
        write_cell(&out, &options, |_, _| ()).unwrap();
        let cell = Cell::new(options).unwrap();
        let dataset = Dataset::open(&out).unwrap();
        assert_eq!(dataset.scene_ids(), [1, 2, 3, 4], "scenes");
        for id in 1..=4 {
            assert!(dataset.poses(id, 1, &PoseSource::GroundTruth).is_ok(), "truth of scene {id}");
        }
        let stereo = read_stereo(&out.join("stereo.json")).unwrap();
        assert!((stereo.rig.baseline() - cell.stereo().rig.baseline()).abs() < 1e-12, "{stereo:?}");
        assert_eq!(dataset.scene(4).unwrap().frames[0].camera, stereo.rig.right, "the right camera");
        // Numbers read back to the last bit but one.
        let same = |a: &[Point2<f64>], b: &[Point2<f64>]| {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).norm() < 1e-12)
        };
        let right = |c: &Clicks| c.pairs.iter().map(|p| p.right).collect::<Vec<_>>();
        let clicks = read_clicks(&out.join("clicks.json")).unwrap();
        assert!(same(&right(&clicks), &right(&cell.clicks())) && clicks.frames == Some([0, 0]), "clicks");
        assert_eq!(read_landmarks(&out.join("landmarks_gt.json")).unwrap().len(), 76, "landmarks");
        let scene = out.join("test/000002");
        let annotations = read_annotations(&scene.join("annotations.json")).unwrap();
        assert!(same(&annotations.frames[&1], &cell.annotations(1, false).frames[&1]), "annotations");
        let exact = read_annotations(&scene.join("annotations_gt.json")).unwrap();
        assert!(same(&exact.frames[&1], &cell.annotations(1, true).frames[&1]), "exact annotations");
        let near = |a: &Pose, b: &Pose| (a.matrix() - b.matrix()).norm() < 1e-12;
        let robot = read_robot(&scene.join("scene_robot.json")).unwrap();
        assert!(near(&robot[&1], &cell.robot(1, false)[&1]), "the robot with its noise");
        let hand_eye = read_hand_eye(&scene.join("hand_eye.json")).unwrap().effector_from_camera;
        assert!(
            near(&hand_eye, &cell.calibrated_hand_eye()) && !near(&hand_eye, &cell.hand_eye()),
            "hand-eye"
        );
        assert!(write_cell(&out, &options, |_, _| ()).is_err(), "a full folder");
    }
}
