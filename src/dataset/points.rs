//! Points of an object clicked in one image, for a first pose.

use std::path::Path;

use nalgebra::{Point2, Point3};

use super::json::Document;
use crate::error::Result;

/// A point of the object and where it is in an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClickedPoint {
    /// Pixel in the image as taken.
    pub pixel: Point2<f64>,
    /// Position in the object frame, metres.
    pub position: Point3<f64>,
}

/// Reads a list of clicked points.
///
/// # Errors
/// [`crate::Error::Io`], [`crate::Error::Line`] or [`crate::Error::Field`] for what cannot be read, and for fewer than
/// four points.
pub fn read_points(path: &Path) -> Result<Vec<ClickedPoint>> {
    let document = Document::read(path)?;
    let items = document.root().items()?;
    if items.len() < 4 {
        let problem = format!("{} points are too few", items.len());
        return Err(document.root().error(problem, "click at least four points of the object"));
    }
    let point = |node: &super::json::Node<'_>| {
        let pixel: [f64; 2] = node.member("pixel")?.array()?;
        let position: [f64; 3] = node.member("point_mm")?.array()?;
        Ok(ClickedPoint {
            pixel: Point2::from(pixel),
            position: Point3::from(position.map(|mm| mm / 1000.0)),
        })
    };
    items.iter().map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use proptest::prelude::*;

    const POINTS: &[u8] =
        br#"[{"pixel": [10, 20.5], "point_mm": [1, 2, 3]}, {"pixel": [1, 2], "point_mm": [0, 0, 0]},
 {"pixel": [3, 4], "point_mm": [5, 0, 0]}, {"pixel": [5, 6], "point_mm": [0, 5, 0]}]"#;

    #[test]
    fn reads_metres() {
        let points = with_file("p.json", POINTS, read_points).unwrap();
        assert_eq!(points.len(), 4, "four points");
        assert_eq!(points[0].position, Point3::new(0.001, 0.002, 0.003), "metres");
        assert_eq!(points[0].pixel, Point2::new(10.0, 20.5), "pixels");
    }

    #[test]
    fn errors_name_the_place() {
        for (text, expected) in [
            (r#"[{"pixel": [1, 2], "point_mm": [1, 2, 3]}]"#, "1 points are too few"),
            (r#"{"pixel": [1, 2]}"#, "not a list"),
            (r#"[{"pixel": [1]}, {}, {}, {}]"#, "[0].pixel: 1 numbers instead of 2"),
            (r#"[{"pixel": [1, 2]}, {}, {}, {}]"#, "[0]: the field point_mm is missing"),
        ] {
            let error = with_file("p.json", text.as_bytes(), read_points).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    proptest! {
        #[test]
        fn no_damaged_file_panics(bytes in damaged(POINTS)) {
            let _ = with_file("p.json", &bytes, read_points);
        }
    }
}
