//! Tests of [`super`] on small data sets made in a temporary folder.

use proptest::prelude::*;
use tempfile::TempDir;

use super::*;
use crate::dataset::damage::damaged;
use crate::geometry::Distortion;

const CAMERAS: &[u8] = br#"{
  "10": {"cam_K": [500, 0, 32.5, 0, 501, 24.5, 0, 0, 1], "depth_scale": 1.0},
  "2": {"cam_K": [500, 0, 32, 0, 501, 24, 0, 0, 1], "cam_dist": [0.1, 0.2, 0.003, 0.004, 0.5]}
}"#;

/// A data set with scene 3 (images 2 and 10, 64x48) in the folder `split`.
fn small(split: &str) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join(split).join("000003");
    fs::create_dir_all(scene.join("gray")).unwrap();
    fs::write(scene.join("scene_camera.json"), CAMERAS).unwrap();
    for name in ["000002.png", "000010.pgm"] {
        image::GrayImage::new(64, 48).save(scene.join("gray").join(name)).unwrap();
    }
    folder
}

fn scene_error(change: impl FnOnce(&Path)) -> String {
    let folder = small("test");
    change(&folder.path().join("test/000003"));
    let dataset = Dataset::open(folder.path()).unwrap();
    dataset.scene(3).expect_err("must be refused").to_string()
}

#[test]
fn frames_ascend_with_their_cameras() {
    let folder = small("test");
    let dataset = Dataset::open(folder.path()).unwrap();
    assert_eq!(dataset.scene_ids(), [3], "scenes");
    let scene = dataset.scene(3).unwrap();
    assert_eq!(scene.frames.iter().map(|f| f.id).collect::<Vec<_>>(), [2, 10], "ascending");
    let lens = Distortion { k1: 0.1, k2: 0.2, p1: 0.003, p2: 0.004, k3: 0.5 };
    let expected = Camera { distortion: lens, ..Camera::pinhole(500.0, 501.0, 32.0, 24.0, 64, 48) };
    assert_eq!(scene.frames[0].camera, expected, "with the size of the image");
    assert!(scene.frames[1].camera.distortion.is_none(), "no cam_dist is no distortion");
    assert!(scene.frames[1].image.ends_with("gray/000010.pgm"), "{:?}", scene.frames[1].image);
    assert_eq!(scene.cameras().len(), 2, "cameras by id");
}

#[test]
fn splits_are_found_and_test_is_preferred() {
    for split in ["train_pbr", "val", "test_primesense", "."] {
        let folder = small(split);
        assert_eq!(Dataset::open(folder.path()).unwrap().scene_ids(), [3], "{split}");
    }
    let folder = small("train");
    let other = folder.path().join("test/000008");
    fs::create_dir_all(&other).unwrap();
    fs::write(other.join("scene_camera.json"), "{}").unwrap();
    assert_eq!(Dataset::open(folder.path()).unwrap().scene_ids(), [8], "test before train");
    fs::create_dir_all(folder.path().join("models")).unwrap();
    fs::write(folder.path().join("models/obj_000005.ply"), "ply").unwrap();
    let split = Dataset::open(folder.path().join("train")).unwrap();
    assert_eq!(split.scene_ids(), [3], "a split can be opened");
    assert_eq!(split.object_ids().unwrap(), [5], "with the meshes beside it");
}

#[test]
fn missing_things_are_named() {
    assert!(Dataset::open("/nowhere/at/all").unwrap_err().to_string().contains("/nowhere"), "no folder");
    let empty = tempfile::tempdir().unwrap();
    assert!(Dataset::open(empty.path()).unwrap_err().to_string().contains("no scene"), "no scene");
    let folder = small("test");
    let dataset = Dataset::open(folder.path()).unwrap();
    assert!(dataset.scene(4).unwrap_err().to_string().contains("[3]"), "the scenes there are");
    assert!(dataset.mesh(1).unwrap_err().to_string().contains("models"), "no meshes");
    let poses = dataset.poses(3, 1, &PoseSource::GroundTruth).unwrap_err().to_string();
    assert!(poses.contains("scene_gt.json"), "{poses}");

    let no_image = scene_error(|s| fs::remove_file(s.join("gray/000010.pgm")).unwrap());
    assert!(no_image.contains("\"10\": there is no such image"), "{no_image}");
    let no_camera = scene_error(|s| {
        fs::copy(s.join("gray/000002.png"), s.join("gray/7.png")).unwrap();
    });
    assert!(no_camera.contains("no entry for image 7"), "{no_camera}");
    let no_folder = scene_error(|s| fs::remove_dir_all(s.join("gray")).unwrap());
    assert!(no_folder.contains("no folder gray/"), "{no_folder}");
    let broken = scene_error(|s| fs::write(s.join("gray/000002.png"), "no image").unwrap());
    assert!(broken.contains("000002.png"), "{broken}");
    let size = scene_error(|s| fs::write(s.join("../../camera.json"), r#"{"width": 65}"#).unwrap());
    assert!(size.contains("camera.json: width: 65"), "{size}");
}

#[test]
fn wrong_cameras_are_named() {
    let cases = [
        ("[500, 0, 32.5", "[-500, 0, 32.5", "\"10\".cam_K"),
        ("0, 0, 1], \"depth", "0, 0], \"depth", "8 numbers instead of 9"),
        ("0, 0, 1], \"depth", "0, 0, 2], \"depth", "no intrinsic matrix"),
        ("[0.1, 0.2, 0.003", "[0.1, 0.2, \"a\"", "\"2\".cam_dist[2]"),
        ("[0.1, 0.2, 0.003, 0.004, 0.5]", "[0.1]", "\"2\".cam_dist"),
        ("cam_K", "cam_k", "cam_K is missing"),
    ];
    let text = String::from_utf8(CAMERAS.to_vec()).unwrap();
    for (from, to, expected) in cases {
        let bytes = text.replacen(from, to, 1);
        let error = scene_error(|s| fs::write(s.join("scene_camera.json"), bytes).unwrap());
        assert!(error.contains(expected), "{to}: {error}");
    }
}

proptest! {
    #[test]
    fn no_damaged_cameras_panic(bytes in damaged(CAMERAS)) {
        let folder = small("test");
        fs::write(folder.path().join("test/000003/scene_camera.json"), bytes).unwrap();
        let _ = Dataset::open(folder.path()).unwrap().scene(3);
    }
}
