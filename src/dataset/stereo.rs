//! Stereo calibration (`stereo.json`) and corresponding clicks (`clicks.json`).

use std::collections::BTreeSet;
use std::path::Path;

use nalgebra::Point2;
use serde_json::{Map, json};

use super::calibration::{camera_from_matrix, distortion};
use super::json::{Document, Node};
use super::robot::{millimetres, pose, row_major};
use crate::error::{Error, Result};
use crate::geometry::stereo::ClickPair;
use crate::geometry::{Camera, StereoRig};

/// A calibrated pair, and which scenes of the data set its cameras took.
#[derive(Debug, Clone, PartialEq)]
pub struct StereoCalibration {
    /// The cameras.
    pub rig: StereoRig,
    /// Scene of the left camera.
    pub left_scene: u32,
    /// Scene of the right camera.
    pub right_scene: u32,
}

/// Corresponding points of one stereo pair of images.
#[derive(Debug, Clone, PartialEq)]
pub struct Clicks {
    /// Frame of the left and of the right scene that was clicked in, where the file says so.
    pub frames: Option<[u32; 2]>,
    /// Standard deviation of a click, pixels per coordinate, where the file says so.
    pub sigma_px: Option<f64>,
    /// The landmarks.
    pub pairs: Vec<ClickPair>,
}

/// Reads a stereo calibration. Where it states no image size, `camera.json` beside it does.
///
/// # Errors
/// [`Error::Io`], [`Error::Line`] or [`Error::Field`] for what cannot be read or is no pair of cameras.
pub fn read_stereo(path: &Path) -> Result<StereoCalibration> {
    let document = Document::read(path)?;
    let root = document.root();
    let scene = |name: &str, default| root.optional(name).map_or(Ok(default), |n| n.whole());
    let size = image_size(path, &root)?;
    let (left, right) = (camera(&root, "left", size)?, camera(&root, "right", size)?);
    let right_from_left = pose(&root, "R_right_from_left", "t_right_from_left_mm")?;
    let rig =
        StereoRig::new(left, right, right_from_left).map_err(|e| e.in_field(path, "t_right_from_left_mm"))?;
    Ok(StereoCalibration { rig, left_scene: scene("left_scene", 1)?, right_scene: scene("right_scene", 2)? })
}

fn image_size(path: &Path, root: &Node<'_>) -> Result<(u32, u32)> {
    let size = |node: &Node<'_>| Ok((node.member("width")?.whole()?, node.member("height")?.whole()?));
    let beside = path.with_file_name("camera.json");
    if root.optional("width").is_none() && beside.is_file() {
        return size(&Document::read(&beside)?.root());
    }
    size(root)
}

fn camera(root: &Node<'_>, side: &str, size: (u32, u32)) -> Result<Camera> {
    let lens = match root.optional(&format!("dist_{side}")) {
        Some(list) => distortion(&list.numbers()?).map_err(|e| e.in_field(list.path(), list.place()))?,
        None => Default::default(),
    };
    let k = root.member(&format!("K_{side}"))?;
    camera_from_matrix(&k.array()?, size, lens).map_err(|e| e.in_field(k.path(), k.place()))
}

/// Text of `stereo.json`.
pub fn stereo_json(calibration: &StereoCalibration) -> String {
    let rig = &calibration.rig;
    let mut map = Map::new();
    map.insert("left_scene".into(), calibration.left_scene.into());
    map.insert("right_scene".into(), calibration.right_scene.into());
    map.insert("width".into(), rig.left.width.into());
    map.insert("height".into(), rig.left.height.into());
    for (side, camera) in [("left", &rig.left), ("right", &rig.right)] {
        map.insert(format!("K_{side}"), row_major(&camera.matrix()).into());
        if !camera.distortion.is_none() {
            let d = &camera.distortion;
            map.insert(format!("dist_{side}"), vec![d.k1, d.k2, d.p1, d.p2, d.k3].into());
        }
    }
    let pose = &rig.right_from_left;
    map.insert("R_right_from_left".into(), row_major(&pose.rotation()).into());
    map.insert("t_right_from_left_mm".into(), millimetres(&pose.translation()).into());
    format!("{:#}\n", serde_json::Value::Object(map))
}

/// Reads corresponding clicks.
///
/// # Errors
/// [`Error::Io`], [`Error::Line`] or [`Error::Field`]; a name that occurs twice and an empty list are errors.
pub fn read_clicks(path: &Path) -> Result<Clicks> {
    let document = Document::read(path)?;
    let root = document.root();
    let mut seen = BTreeSet::new();
    let mut pairs = Vec::new();
    for node in root.member("clicks")?.items()? {
        let name = node.member("name")?.label()?;
        if !seen.insert(name.clone()) {
            return Err(
                node.error(format!("the landmark {name:?} occurs twice"), "give every landmark a name")
            );
        }
        let point = |side: &str| node.member(side)?.array().map(|[u, v]: [f64; 2]| Point2::new(u, v));
        pairs.push(ClickPair { left: point("left")?, right: point("right")?, name });
    }
    if pairs.is_empty() {
        return Err(Error::field(
            path,
            "clicks",
            "the list is empty",
            "click at least 6 points in both images",
        ));
    }
    let frame = |name: &str| root.optional(name).map(|n| n.whole()).transpose();
    let frames = frame("left_frame")?.zip(frame("right_frame")?).map(|(l, r)| [l, r]);
    let sigma_px = root.optional("sigma_px").map(|n| n.number()).transpose()?;
    if sigma_px.is_some_and(|s| s <= 0.0) {
        return Err(Error::field(
            path,
            "sigma_px",
            "it is not positive",
            "give the noise of a click in pixels",
        ));
    }
    Ok(Clicks { frames, sigma_px, pairs })
}

/// Text of `clicks.json`.
pub fn clicks_json(clicks: &Clicks) -> String {
    let mut text = String::from("{\n");
    if let Some([left, right]) = clicks.frames {
        text += &format!("  \"left_frame\": {left},\n  \"right_frame\": {right},\n");
    }
    if let Some(sigma) = clicks.sigma_px {
        text += &format!("  \"sigma_px\": {},\n", json!(sigma));
    }
    let line = |p: &ClickPair| {
        let value = json!({ "name": p.name, "left": [p.left.x, p.left.y], "right": [p.right.x, p.right.y] });
        format!("    {value}")
    };
    let lines: Vec<String> = clicks.pairs.iter().map(line).collect();
    text + &format!("  \"clicks\": [\n{}\n  ]\n}}\n", lines.join(",\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use proptest::prelude::*;

    const STEREO: &[u8] = br#"{"width": 640, "height": 480, "K_left": [680, 0, 338, 0, 681, 247, 0, 0, 1],
 "K_right": [682, 0, 320, 0, 682, 225, 0, 0, 1], "dist_left": [-0.1, 0.01, 0, 0], "R_right_from_left":
 [1, 0, 0, 0, 1, 0, 0, 0, 1], "t_right_from_left_mm": [-61.8, -1, -2.8]}"#;
    const CLICKS: &[u8] = br#"{"left_frame": 0, "right_frame": 4, "sigma_px": 0.5, "clicks": [
 {"name": "bolt", "left": [10.5, 20], "right": [3, 21]}, {"name": 7, "left": [1, 2], "right": [3, 4]}]}"#;

    #[test]
    fn files_read_back_what_was_written() {
        let stereo = with_file("s.json", STEREO, read_stereo).unwrap();
        assert!((stereo.rig.baseline() - 0.061_871).abs() < 1e-5, "{} m", stereo.rig.baseline());
        assert_eq!((stereo.left_scene, stereo.right_scene), (1, 2), "scenes unless stated");
        let again = with_file("s.json", stereo_json(&stereo).as_bytes(), read_stereo).unwrap();
        assert_eq!(again, stereo, "stereo");
        let clicks = with_file("c.json", CLICKS, read_clicks).unwrap();
        assert_eq!((clicks.frames, clicks.sigma_px), (Some([0, 4]), Some(0.5)), "{clicks:?}");
        assert_eq!(clicks.pairs[1].name, "7", "a number is a name too");
        let again = with_file("c.json", clicks_json(&clicks).as_bytes(), read_clicks).unwrap();
        assert_eq!(again, clicks, "clicks");
    }

    #[test]
    fn errors_name_the_field() {
        let stereo = |from: &str, to: &str| {
            let text = String::from_utf8(STEREO.to_vec()).unwrap().replace(from, to);
            with_file("s.json", text.as_bytes(), read_stereo).expect_err("refused").to_string()
        };
        assert!(stereo("\"K_right\"", "\"K\"").contains("K_right is missing"), "missing");
        assert!(stereo("[682, 0,", "[682, 5,").contains("K_right"), "skew");
        assert!(stereo("\"width\": 640,", "").contains("width"), "no size");
        assert!(stereo("-61.8, -1, -2.8", "0, 0, 0").contains("same place"), "no baseline");
        let clicks = |from: &str, to: &str| {
            let text = String::from_utf8(CLICKS.to_vec()).unwrap().replace(from, to);
            with_file("c.json", text.as_bytes(), read_clicks).expect_err("refused").to_string()
        };
        assert!(clicks("7", "\"bolt\"").contains("clicks[1]: the landmark \"bolt\" occurs twice"), "twice");
        assert!(clicks("[3, 21]", "[3]").contains("clicks[0].right: 1 numbers instead of 2"), "one number");
        assert!(clicks("0.5", "0").contains("sigma_px"), "no noise");
    }

    proptest! {
        #[test]
        fn no_damaged_file_panics(stereo in damaged(STEREO), clicks in damaged(CLICKS)) {
            let _ = with_file("s.json", &stereo, read_stereo);
            let _ = with_file("c.json", &clicks, read_clicks);
        }
    }
}
