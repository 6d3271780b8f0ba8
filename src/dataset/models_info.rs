//! What `models_info.json` of a data set in BOP layout says about an object's symmetries.

use std::path::Path;

use nalgebra::{Matrix3, Point3, Unit, Vector3};

use super::json::{Document, Node};
use crate::error::Result;
use crate::geometry::Pose;
use crate::geometry::symmetry::Symmetries;

/// Reads the symmetries of an object; an object without an entry, or an entry without symmetries, has none.
///
/// # Errors
/// [`crate::Error::Io`], [`crate::Error::Line`] or [`crate::Error::Field`] for what cannot be read.
pub fn read_symmetries(path: &Path, object_id: u32) -> Result<Symmetries> {
    let document = Document::read(path)?;
    let entries = document.root().by_id()?;
    let Some((_, entry)) = entries.iter().find(|(id, _)| *id == object_id) else {
        return Ok(Symmetries::default());
    };
    let list = |name: &str| entry.optional(name).map_or(Ok(Vec::new()), |list| list.items());
    Ok(Symmetries {
        discrete: list("symmetries_discrete")?.iter().map(motion).collect::<Result<_>>()?,
        continuous: list("symmetries_continuous")?.iter().map(axis).collect::<Result<_>>()?,
    })
}

/// A 4x4 matrix, row-major, millimetres.
fn motion(node: &Node<'_>) -> Result<Pose> {
    let m: [f64; 16] = node.array()?;
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let translation = Vector3::new(m[3], m[7], m[11]) / 1000.0;
    Pose::from_matrix(&rotation, translation).map_err(|e| e.in_field(node.path(), node.place()))
}

fn axis(node: &Node<'_>) -> Result<(Unit<Vector3<f64>>, Point3<f64>)> {
    let member = node.member("axis")?;
    let direction: [f64; 3] = member.array()?;
    let direction = Unit::try_new(Vector3::from(direction), 1e-9)
        .ok_or_else(|| member.error("the axis has no direction", "write a vector that is not zero"))?;
    let offset: [f64; 3] = node.optional("offset").map_or(Ok([0.0; 3]), |o| o.array())?;
    Ok((direction, Point3::from(Vector3::from(offset) / 1000.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use proptest::prelude::*;

    const INFO: &[u8] = br#"{"1": {"diameter": 100, "symmetries_discrete":
  [[-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 20, 0, 0, 0, 1]],
  "symmetries_continuous": [{"axis": [0, 0, 2], "offset": [10, 0, 0]}]}, "2": {"diameter": 5}}"#;

    #[test]
    fn reads_both_kinds_in_metres() {
        let found = with_file("models_info.json", INFO, |p| read_symmetries(p, 1)).unwrap();
        assert_eq!(found.discrete[0].translation(), Vector3::new(0.0, 0.0, 0.02), "metres");
        assert_eq!(found.continuous, [(Vector3::z_axis(), Point3::new(0.01, 0.0, 0.0))], "an axis");
        for other in [2, 3] {
            let none = with_file("models_info.json", INFO, |p| read_symmetries(p, other)).unwrap();
            assert_eq!(none, Symmetries::default(), "object {other}");
        }
    }

    #[test]
    fn errors_name_the_field() {
        let text = String::from_utf8(INFO.to_vec()).unwrap();
        for (from, to, expected) in [
            ("[-1, 0,", "[-2, 0,", "orthonormal"),
            ("20, 0, 0, 0, 1]", "20]", "12 numbers instead of 16"),
            ("[0, 0, 2]", "[0, 0, 0]", "no direction"),
        ] {
            let bytes = text.replacen(from, to, 1);
            assert_ne!(bytes, text, "{from} is in the sample");
            let error =
                with_file("models_info.json", bytes.as_bytes(), |p| read_symmetries(p, 1)).unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
        }
    }

    proptest! {
        #[test]
        fn no_damaged_file_panics(bytes in damaged(INFO)) {
            let _ = with_file("models_info.json", &bytes, |p| read_symmetries(p, 1));
        }
    }
}
