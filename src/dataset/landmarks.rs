//! Landmarks: their positions with covariance (`landmarks.json`) and where they are in images (`annotations.json`).

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use nalgebra::{Matrix3, Point2, Point3};
use serde_json::json;

use super::json::{Document, Node};
use super::robot::row_major;
use crate::error::{Error, Result};

/// A landmark of the 3D shape, eq. (6).
#[derive(Debug, Clone, PartialEq)]
pub struct Landmark {
    /// What it is called.
    pub name: String,
    /// Position in the object frame, metres.
    pub position: Point3<f64>,
    /// Covariance of the position, square metres; zero where it is exact or not known.
    pub covariance: Matrix3<f64>,
}

/// All landmarks in every annotated image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Annotations {
    /// Names, in the order of the pixels.
    pub names: Vec<String>,
    /// Standard deviation of an annotation per coordinate, pixels, if it is known.
    pub sigma_px: Option<f64>,
    /// Per frame id one pixel per landmark, in the image as taken.
    pub frames: BTreeMap<u32, Vec<Point2<f64>>>,
}

impl Annotations {
    /// The landmarks in the order of the annotations.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the annotated landmarks that have no position, and those that are not annotated.
    pub fn shape(&self, landmarks: &[Landmark]) -> Result<Vec<Landmark>> {
        let known: BTreeMap<&str, &Landmark> = landmarks.iter().map(|l| (l.name.as_str(), l)).collect();
        let annotated: BTreeSet<&str> = self.names.iter().map(String::as_str).collect();
        let unknown = annotated.iter().filter(|n| !known.contains_key(*n)).copied();
        let missing = known.keys().filter(|n| !annotated.contains(*n)).copied();
        let odd: Vec<&str> = unknown.chain(missing).collect();
        if !odd.is_empty() {
            let problem = format!("{} are not in both files", odd.join(", "));
            return Err(Error::invalid("landmarks", problem, "annotate exactly the landmarks of the shape"));
        }
        Ok(self.names.iter().map(|n| known[n.as_str()].clone()).collect())
    }
}

/// Reads landmarks.
///
/// # Errors
/// [`Error::Io`], [`Error::Line`] or [`Error::Field`]; a name that occurs twice and an empty list are errors.
pub fn read_landmarks(path: &Path) -> Result<Vec<Landmark>> {
    let document = Document::read(path)?;
    let mut seen = BTreeSet::new();
    let mut landmarks = Vec::new();
    for node in document.root().member("landmarks")?.items()? {
        let name = name(&node.member("name")?, &mut seen)?;
        let position: [f64; 3] = node.member("position_mm")?.array()?;
        let covariance = match node.optional("covariance_mm2") {
            Some(list) => Matrix3::from_row_slice(&list.array::<9>()?) * 1e-6,
            None => Matrix3::zeros(),
        };
        landmarks.push(Landmark { name, position: Point3::from(position) / 1000.0, covariance });
    }
    if landmarks.is_empty() {
        return Err(Error::field(path, "landmarks", "the list is empty", "give at least 6 landmarks"));
    }
    Ok(landmarks)
}

fn name(node: &Node<'_>, seen: &mut BTreeSet<String>) -> Result<String> {
    let name = node.label()?;
    if !seen.insert(name.clone()) {
        return Err(node.error(format!("the landmark {name:?} occurs twice"), "give every landmark a name"));
    }
    Ok(name)
}

/// Text of `landmarks.json`; `frame` says in words what the coordinates refer to.
pub fn landmarks_json(landmarks: &[Landmark], frame: &str) -> String {
    let line = |l: &Landmark| {
        let position: Vec<f64> = l.position.iter().map(|v| v * 1000.0).collect();
        let value = json!({
            "name": l.name, "position_mm": position, "covariance_mm2": row_major(&(l.covariance * 1e6)),
        });
        format!("    {value}")
    };
    let lines: Vec<String> = landmarks.iter().map(line).collect();
    format!("{{\n  \"frame\": {},\n  \"landmarks\": [\n{}\n  ]\n}}\n", json!(frame), lines.join(",\n"))
}

/// Reads annotations.
///
/// # Errors
/// [`Error::Io`], [`Error::Line`] or [`Error::Field`]; every frame needs one pixel per landmark.
pub fn read_annotations(path: &Path) -> Result<Annotations> {
    let document = Document::read(path)?;
    let root = document.root();
    let mut seen = BTreeSet::new();
    let names = root.member("landmarks")?.items()?;
    let names: Result<Vec<String>> = names.iter().map(|n| name(n, &mut seen)).collect();
    let names = names?;
    let sigma_px = root.optional("sigma_px").map(|n| n.number()).transpose()?;
    if let Some(sigma) = sigma_px.filter(|s| *s <= 0.0) {
        let problem = format!("{sigma} is not positive");
        return Err(Error::field(path, "sigma_px", problem, "give the noise of an annotation, pixels"));
    }
    let mut frames = BTreeMap::new();
    for (id, node) in root.member("frames")?.by_id()? {
        let items = node.items()?;
        if items.len() != names.len() {
            let problem = format!("{} pixels for {} landmarks", items.len(), names.len());
            return Err(node.error(problem, "annotate every landmark in every training image"));
        }
        let pixels: Result<Vec<Point2<f64>>> =
            items.iter().map(|n| n.array().map(|[u, v]: [f64; 2]| Point2::new(u, v))).collect();
        if frames.insert(id, pixels?).is_some() {
            return Err(node.error("the frame occurs twice", "keep one entry per frame"));
        }
    }
    if frames.is_empty() || names.is_empty() {
        let problem = format!("{} landmarks in {} frames", names.len(), frames.len());
        return Err(Error::field(path, "frames", problem, "annotate at least one image"));
    }
    Ok(Annotations { names, sigma_px, frames })
}

/// Text of `annotations.json`.
pub fn annotations_json(annotations: &Annotations) -> String {
    let line = |(id, pixels): (&u32, &Vec<Point2<f64>>)| {
        let pixels: Vec<[f64; 2]> = pixels.iter().map(|p| [p.x, p.y]).collect();
        format!("    \"{id}\": {}", json!(pixels))
    };
    let lines: Vec<String> = annotations.frames.iter().map(line).collect();
    let names = json!(annotations.names);
    let sigma = annotations.sigma_px.map(|s| format!("  \"sigma_px\": {},\n", json!(s))).unwrap_or_default();
    format!("{{\n  \"landmarks\": {names},\n{sigma}  \"frames\": {{\n{}\n  }}\n}}\n", lines.join(",\n"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use proptest::prelude::*;

    const LANDMARKS: &[u8] = br#"{"frame": "left camera", "landmarks": [
 {"name": "a", "position_mm": [1, 2, 3.5], "covariance_mm2": [1, 0, 0, 0, 1, 0, 0, 0, 4]},
 {"name": "b", "position_mm": [1, 2, 500]}]}"#;
    const ANNOTATIONS: &[u8] =
        br#"{"landmarks": ["b", "a"], "sigma_px": 0.5, "frames": {"7": [[1, 2], [3.5, 4]], "0": [[5, 6], [7, 8]]}}"#;

    #[test]
    fn files_read_back_what_was_written() {
        let landmarks = with_file("l.json", LANDMARKS, read_landmarks).unwrap();
        assert!((landmarks[0].covariance[(2, 2)] - 4e-6).abs() < 1e-18, "square metres");
        assert_eq!(landmarks[1].covariance, Matrix3::zeros(), "not known");
        let again = with_file("l.json", landmarks_json(&landmarks, "x").as_bytes(), read_landmarks).unwrap();
        assert!((again[1].position - landmarks[1].position).norm() < 1e-15, "{again:?}");
        let annotations = with_file("a.json", ANNOTATIONS, read_annotations).unwrap();
        let again = with_file("a.json", annotations_json(&annotations).as_bytes(), read_annotations).unwrap();
        assert_eq!(again, annotations, "annotations");
        let shape = annotations.shape(&landmarks).unwrap();
        assert!((shape[0].position.z - 0.5).abs() < 1e-15, "in the order of the annotations: {shape:?}");
        let error = annotations.shape(&landmarks[..1]).unwrap_err().to_string();
        assert!(error.contains("b are not in both"), "{error}");
    }

    #[test]
    fn errors_name_the_field() {
        let annotations = |from: &str, to: &str| {
            let text = String::from_utf8(ANNOTATIONS.to_vec()).unwrap().replace(from, to);
            with_file("a.json", text.as_bytes(), read_annotations).expect_err("refused").to_string()
        };
        assert!(annotations(", [3.5, 4]", "").contains("1 pixels for 2 landmarks"), "one missing");
        assert!(annotations("[3.5, 4]", "[3.5]").contains("\"7\"[1]"), "one coordinate");
        assert!(annotations("0.5", "0").contains("sigma_px"), "no noise");
        assert!(annotations("\"b\"", "\"a\"").contains("landmarks[1]"), "the same name");
        assert!(annotations("\"7\"", "\"first\"").contains("not an id"), "no id");
        let text = with_file("l.json", b"{\"landmarks\": []}", read_landmarks).unwrap_err().to_string();
        assert!(text.contains("at least 6"), "{text}");
    }

    proptest! {
        #[test]
        fn no_damaged_file_panics(landmarks in damaged(LANDMARKS), annotations in damaged(ANNOTATIONS)) {
            let _ = with_file("l.json", &landmarks, read_landmarks);
            let _ = with_file("a.json", &annotations, read_annotations);
        }
    }
}
