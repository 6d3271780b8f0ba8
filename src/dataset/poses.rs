//! Known poses of an object in a scene: ground truth, reference, or another tracker's results.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use nalgebra::{Matrix3, Vector3};

use super::json::{Document, Node};
use super::results;
use crate::error::{Error, Result};
use crate::geometry::Pose;

/// Where the poses of a scene come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PoseSource {
    /// `scene_gt.json` of the scene.
    GroundTruth,
    /// `scene_ref.json` of the scene: poses computed from the same images.
    Reference,
    /// A file: `*.csv` with BOP results, anything else with the fields of `scene_gt.json`.
    File(PathBuf),
}

impl FromStr for PoseSource {
    type Err = Error;

    /// `gt`, `ref`, or the path of a file.
    fn from_str(text: &str) -> Result<Self> {
        match text {
            "" => Err(Error::invalid("pose source", "it is empty", "give gt, ref or the path of a file")),
            "gt" => Ok(Self::GroundTruth),
            "ref" => Ok(Self::Reference),
            path => Ok(Self::File(path.into())),
        }
    }
}

/// Reads the poses (`camera_from_object`, metres) of an object by image id. `scene_id` selects the rows of a
/// results file, where lost frames (score 0 or less) are left out; a JSON file holds one scene.
///
/// # Errors
/// [`Error::Io`], [`Error::Line`] or [`Error::Field`] for what cannot be read; [`Error::Field`] if the object
/// occurs nowhere in the file, or several times in one image (several instances are not supported).
pub fn read(path: &Path, scene_id: u32, object_id: u32) -> Result<BTreeMap<u32, Pose>> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")) {
        read_results(path, scene_id, object_id)
    } else {
        read_scene(path, object_id)
    }
}

fn read_results(path: &Path, scene_id: u32, object_id: u32) -> Result<BTreeMap<u32, Pose>> {
    let mut rows = results::read(path)?;
    rows.retain(|r| r.scene_id == scene_id && r.obj_id == object_id);
    if rows.is_empty() {
        let problem = format!("no line of object {object_id} in scene {scene_id}");
        return Err(Error::field(path, "obj_id", problem, "choose another object, scene or file"));
    }
    let mut poses = BTreeMap::new();
    for row in rows.iter().filter(|r| r.score > 0.0) {
        if poses.insert(row.im_id, row.pose).is_some() {
            return Err(several(path, format!("im_id {}", row.im_id), object_id));
        }
    }
    Ok(poses)
}

fn read_scene(path: &Path, object_id: u32) -> Result<BTreeMap<u32, Pose>> {
    let document = Document::read(path)?;
    let mut poses = BTreeMap::new();
    for (image, objects) in document.root().by_id()? {
        for object in objects.items()? {
            if object.member("obj_id")?.whole()? != object_id {
                continue;
            }
            if poses.insert(image, pose(&object)?).is_some() {
                return Err(several(path, objects.place(), object_id));
            }
        }
    }
    if poses.is_empty() {
        let problem = format!("object {object_id} occurs in no image");
        return Err(Error::field(path, "obj_id", problem, "choose another object or file"));
    }
    Ok(poses)
}

fn several(path: &Path, field: impl Into<String>, object_id: u32) -> Error {
    let problem = format!("object {object_id} occurs several times in one image, which is not supported");
    Error::field(path, field, problem, "keep one instance per image")
}

fn pose(object: &Node<'_>) -> Result<Pose> {
    let rotation = object.member("cam_R_m2c")?;
    let r: [f64; 9] = rotation.array()?;
    let t: [f64; 3] = object.member("cam_t_m2c")?.array()?;
    Pose::from_matrix(&Matrix3::from_row_slice(&r), Vector3::from(t) / 1000.0)
        .map_err(|e| e.in_field(rotation.path(), rotation.place()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use proptest::prelude::*;

    const SCENE: &[u8] = br#"{
  "7": [{"cam_R_m2c": [0, -1, 0, 1, 0, 0, 0, 0, 1], "cam_t_m2c": [1, 2, 500.5], "obj_id": 2},
        {"cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [1, 2, 3], "obj_id": 1}],
  "000003": [{"cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [0, 0, 1000], "obj_id": 2}]
}"#;

    const RESULTS: &[u8] = b"1,0,2,1,1 0 0 0 1 0 0 0 1,0 0 500,-1\n1,1,2,0,1 0 0 0 1 0 0 0 1,0 0 500,-1\n\
        4,0,2,1,1 0 0 0 1 0 0 0 1,0 0 600,-1\n";

    #[test]
    fn reads_one_object_in_metres() {
        let poses = with_file("gt.json", SCENE, |p| read(p, 1, 2)).unwrap();
        assert_eq!(poses.keys().copied().collect::<Vec<_>>(), [3, 7], "ascending ids");
        assert_eq!(poses[&7].translation(), Vector3::new(0.001, 0.002, 0.5005), "metres");
        assert!((poses[&7].rotation()[(1, 0)] - 1.0).abs() < 1e-12, "row-major");
    }

    #[test]
    fn reads_results_without_lost_frames() {
        let poses = with_file("r.csv", RESULTS, |p| read(p, 1, 2)).unwrap();
        assert_eq!(poses.keys().copied().collect::<Vec<_>>(), [0], "image 1 is lost, scene 4 is another");
        let twice = [RESULTS, RESULTS].concat();
        let text = with_file("r.csv", &twice, |p| read(p, 1, 2)).unwrap_err().to_string();
        assert!(text.contains("several times"), "{text}");
        assert!(with_file("r.csv", RESULTS, |p| read(p, 2, 2)).is_err(), "no such scene");
    }

    #[test]
    fn errors_name_the_field() {
        let cases = [
            ("\"cam_t_m2c\": [1, 2, 500.5], ", "", r#""7"[0]: the field cam_t_m2c"#),
            ("500.5", "null", r#""7"[0].cam_t_m2c[2]: not a finite number"#),
            ("[1, 2, 500.5]", "[1, 2]", "2 numbers instead of 3"),
            ("[0, -1,", "[0, -2,", r#""7"[0].cam_R_m2c"#),
            ("500.5], \"obj_id\": 2", "500.5], \"obj_id\": -2", "obj_id"),
            ("500.5], \"obj_id\": 2", "500.5], \"obj_id\": 1", "occurs several times"),
            ("\"7\"", "\"seven\"", "not an id"),
            ("500.5", "500.5,,", "gt.json:2:"),
            ("}]\n}", "}]", "gt.json:4:"),
        ];
        let text = String::from_utf8(SCENE.to_vec()).unwrap();
        let failed: Vec<String> = cases
            .iter()
            .filter_map(|(from, to, expected)| {
                let bytes = text.replacen(from, to, 1);
                assert_ne!(bytes, text, "{from} is in the sample");
                let object = if to.ends_with("\"obj_id\": 1") { 1 } else { 2 };
                match with_file("gt.json", bytes.as_bytes(), |p| read(p, 1, object)) {
                    Ok(_) => Some(format!("{to:?} was accepted")),
                    Err(e) => (!e.to_string().contains(expected)).then(|| format!("{to:?}: {e}")),
                }
            })
            .collect();
        assert!(failed.is_empty(), "{failed:#?}");
        let absent = with_file("gt.json", SCENE, |p| read(p, 1, 9)).unwrap_err().to_string();
        assert!(absent.contains("object 9 occurs in no image"), "{absent}");
    }

    #[test]
    fn sources_parse() {
        assert_eq!("gt".parse::<PoseSource>().unwrap(), PoseSource::GroundTruth, "gt");
        assert_eq!("ref".parse::<PoseSource>().unwrap(), PoseSource::Reference, "ref");
        assert_eq!("a/b.csv".parse::<PoseSource>().unwrap(), PoseSource::File("a/b.csv".into()), "a file");
        assert!("".parse::<PoseSource>().is_err(), "nothing");
    }

    proptest! {
        #[test]
        fn no_damaged_file_panics(bytes in damaged(SCENE)) {
            let _ = with_file("gt.json", &bytes, |p| read(p, 1, 2));
        }
    }
}
