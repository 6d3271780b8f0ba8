//! Robot cells: `scene_robot.json` (end-effector per frame) and `hand_eye.json` (camera on the end-effector).

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};

use super::file::write_atomically;
use super::json::{Document, Node};
use crate::error::{Error, Result};
use crate::geometry::{HandEye, Pose};

/// The constant transforms of a cell, as `hand_eye.json` holds them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandEyeTransforms {
    /// Camera on the end-effector, metres: `R_c2e`, `t_c2e`.
    pub effector_from_camera: Pose,
    /// The stationary object in the robot's base, metres: `R_o2b`, `t_o2b`, where the file states it.
    pub base_from_object: Option<Pose>,
}

/// Reads the robot poses (`base_from_effector`, metres) by image id.
///
/// # Errors
/// [`Error::Io`], [`Error::Line`] or [`Error::Field`] for what cannot be read.
pub fn read_robot(path: &Path) -> Result<BTreeMap<u32, Pose>> {
    let document = Document::read(path)?;
    let mut poses = BTreeMap::new();
    for (image, node) in document.root().by_id()? {
        if poses.insert(image, pose(&node, "R_e2b", "t_e2b")?).is_some() {
            return Err(node.error("the image occurs twice", "keep one entry per image"));
        }
    }
    if poses.is_empty() {
        return Err(Error::field(path, "the whole file", "it has no pose", "give one entry per image"));
    }
    Ok(poses)
}

/// Text of `scene_robot.json`.
pub fn robot_json(base_from_effector: &BTreeMap<u32, Pose>) -> String {
    let line = |(id, pose): (&u32, &Pose)| {
        let value =
            json!({ "R_e2b": row_major(&pose.rotation()), "t_e2b": millimetres(&pose.translation()) });
        format!("  \"{id}\": {value}")
    };
    let lines: Vec<String> = base_from_effector.iter().map(line).collect();
    format!("{{\n{}\n}}\n", lines.join(",\n"))
}

/// Reads a hand-eye transform.
///
/// # Errors
/// As [`read_robot`].
pub fn read_hand_eye(path: &Path) -> Result<HandEyeTransforms> {
    let document = Document::read(path)?;
    let root = document.root();
    let base_from_object = root.optional("R_o2b").map(|_| pose(&root, "R_o2b", "t_o2b")).transpose()?;
    Ok(HandEyeTransforms { effector_from_camera: pose(&root, "R_c2e", "t_c2e")?, base_from_object })
}

/// Text of `hand_eye.json`; `residuals` are those of a calibration, by frame.
pub fn hand_eye_json(transforms: &HandEyeTransforms, method: &str, residuals: &[(u32, f64, f64)]) -> String {
    let x = &transforms.effector_from_camera;
    let mut value = json!({ "R_c2e": row_major(&x.rotation()), "t_c2e": millimetres(&x.translation()) });
    if let Some(y) = &transforms.base_from_object {
        value["R_o2b"] = row_major(&y.rotation()).into();
        value["t_o2b"] = millimetres(&y.translation()).into();
    }
    value["method"] = method.into();
    if !residuals.is_empty() {
        let row = |(frame, mm, deg): &(u32, f64, f64)| json!({ "frame": frame, "t_mm": mm, "r_deg": deg });
        value["residuals"] = Value::Array(residuals.iter().map(row).collect());
    }
    format!("{value:#}\n")
}

/// Writes a calibration with its residuals; `frames` are the image ids in the order of the residuals.
///
/// # Errors
/// [`Error::Io`].
pub fn write_hand_eye(path: &Path, calibration: &HandEye, frames: &[u32]) -> Result<()> {
    let transforms = HandEyeTransforms {
        effector_from_camera: calibration.effector_from_camera,
        base_from_object: Some(calibration.base_from_object),
    };
    let rows: Vec<(u32, f64, f64)> = frames
        .iter()
        .zip(&calibration.residuals)
        .map(|(&f, r)| (f, r.translation.norm() * 1000.0, r.rotation.norm().to_degrees()))
        .collect();
    let text = hand_eye_json(&transforms, "Park-Martin, refined over all frames", &rows);
    write_atomically(path, |w| w.write_all(text.as_bytes()))
}

/// A pose of two members, rotation row-major and translation in millimetres.
pub(super) fn pose(node: &Node<'_>, rotation: &str, translation: &str) -> Result<Pose> {
    let r = node.member(rotation)?;
    let t: [f64; 3] = node.member(translation)?.array()?;
    Pose::from_matrix(&Matrix3::from_row_slice(&r.array::<9>()?), Vector3::from(t) / 1000.0)
        .map_err(|e| e.in_field(r.path(), r.place()))
}

pub(super) fn row_major(m: &Matrix3<f64>) -> Vec<f64> {
    m.transpose().iter().copied().collect()
}

pub(super) fn millimetres(v: &Vector3<f64>) -> Vec<f64> {
    v.iter().map(|t| t * 1000.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use proptest::prelude::*;

    const ROBOT: &[u8] = br#"{
  "3": {"R_e2b": [0, -1, 0, 1, 0, 0, 0, 0, 1], "t_e2b": [335.091, -32.1497, 308.57]},
  "1": {"R_e2b": [1, 0, 0, 0, 1, 0, 0, 0, 1], "t_e2b": [1, 2, 3]}
}"#;
    const HAND_EYE: &[u8] = br#"{"R_c2e": [0, -1, 0, 1, 0, 0, 0, 0, 1], "t_c2e": [58, -34.5, -42],
  "R_o2b": [1, 0, 0, 0, 1, 0, 0, 0, 1], "t_o2b": [420, -65, 92]}"#;

    #[test]
    fn files_read_back_what_was_written() {
        let robot = with_file("r.json", ROBOT, read_robot).unwrap();
        assert_eq!(robot.keys().copied().collect::<Vec<_>>(), [1, 3], "ids");
        assert!((robot[&3].translation().z - 0.308_57).abs() < 1e-12, "millimetres");
        let again = with_file("r.json", robot_json(&robot).as_bytes(), read_robot).unwrap();
        assert!((again[&3].matrix() - robot[&3].matrix()).norm() < 1e-12, "{again:?}");
        let hand_eye = with_file("h.json", HAND_EYE, read_hand_eye).unwrap();
        let text = hand_eye_json(&hand_eye, "by hand", &[(3, 1.0, 0.1)]);
        let again = with_file("h.json", text.as_bytes(), read_hand_eye).unwrap();
        let x = again.effector_from_camera.matrix() - hand_eye.effector_from_camera.matrix();
        assert!(x.norm() < 1e-12 && again.base_from_object.is_some(), "{text}");
    }

    #[test]
    fn errors_name_file_and_field() {
        let cases = [
            (r#"{"0": {"R_e2b": [1, 0, 0, 0, 1, 0, 0, 0, 1]}}"#, "t_e2b"),
            (r#"{"0": {"R_e2b": [2, 0, 0, 0, 1, 0, 0, 0, 1], "t_e2b": [0, 0, 0]}}"#, "R_e2b"),
            (r#"{"x": {}}"#, "\"x\""),
            ("{}", "no pose"),
        ];
        for (text, expected) in cases {
            let error = with_file("r.json", text.as_bytes(), read_robot).unwrap_err().to_string();
            assert!(error.contains("r.json") && error.contains(expected), "{expected}: {error}");
        }
        let error = with_file("h.json", br#"{"R_c2e": [1]}"#, read_hand_eye).unwrap_err().to_string();
        assert!(error.contains("t_c2e") || error.contains("R_c2e"), "{error}");
    }

    proptest! {
        #[test]
        fn no_damaged_file_panics(robot in damaged(ROBOT), hand_eye in damaged(HAND_EYE)) {
            let _ = with_file("r.json", &robot, read_robot);
            let _ = with_file("h.json", &hand_eye, read_hand_eye);
        }
    }
}
