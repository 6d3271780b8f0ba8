//! Triangle meshes from PLY files (ASCII and binary), as the BOP data sets keep them: millimetres.

use std::fs;
use std::path::Path;

use nalgebra::Point3;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyType};

use crate::error::{Error, Result};
use crate::geometry::TriangleMesh;

/// What to do about a PLY file that breaks off or does not parse.
const EXPORT_AGAIN: &str = "export the mesh again as PLY with vertices and faces";

/// One vertex or one face, whichever of the two the file's element fills in.
#[derive(Debug, Default)]
struct Element {
    position: [f64; 3],
    polygon: Vec<u32>,
    bad_index: bool,
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        match name {
            "x" => self.position[0] = scalar(&property),
            "y" => self.position[1] = scalar(&property),
            "z" => self.position[2] = scalar(&property),
            "vertex_indices" | "vertex_index" => match property.to_u32_list() {
                Some(indices) => self.polygon = indices,
                None => self.bad_index = true,
            },
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

/// A number of any type; NaN for a list, which the check of the mesh reports.
fn scalar(property: &Property) -> f64 {
    match property {
        Property::Char(v) => f64::from(*v),
        Property::UChar(v) => f64::from(*v),
        Property::Short(v) => f64::from(*v),
        Property::UShort(v) => f64::from(*v),
        Property::Int(v) => f64::from(*v),
        Property::UInt(v) => f64::from(*v),
        Property::Float(v) => f64::from(*v),
        Property::Double(v) => *v,
        _ => f64::NAN,
    }
}

/// Reads a mesh in millimetres; the result is in metres. Polygons become fans of triangles, properties other
/// than positions and vertex indices are ignored.
///
/// # Errors
/// [`Error::Io`]; [`Error::Line`] (header, ASCII) or [`Error::Field`] (binary, naming the element) if the file
/// is incomplete or wrong; [`Error::Field`] for a mesh without area, with numbers that are not finite, or with
/// indices out of range.
pub fn read(path: &Path) -> Result<TriangleMesh> {
    let bytes = fs::read(path).map_err(|e| Error::io(path, e))?;
    let parser = Parser::<Element>::new();
    let mut reader = Reader::new(bytes.as_slice());
    let header = parser.read_header(&mut reader).map_err(|e| located(path, "header", true, &e))?;
    check_header(path, &header, bytes.len())?;
    let mut mesh = TriangleMesh::default();
    for (name, definition) in &header.elements {
        let is_text = header.encoding == Encoding::Ascii;
        let elements = parser
            .read_payload_for_element(&mut reader, definition, &header)
            .map_err(|e| located(path, &format!("element {name}"), is_text, &e))?;
        match name.as_str() {
            "vertex" => {
                let metres = |e: &Element| Point3::from(e.position.map(|mm| mm / 1000.0));
                mesh.vertices = elements.iter().map(metres).collect();
            }
            "face" => mesh.triangles = fans(path, &elements)?,
            _ => {}
        }
    }
    mesh.validate().map_err(|e| e.in_field(path, "geometry"))?;
    Ok(mesh)
}

/// Checks that the header declares what is needed, and no more elements than the file has bytes: counts from a
/// damaged header must not make the reader loop or allocate without end.
fn check_header(path: &Path, header: &Header, file_size: usize) -> Result<()> {
    let properties = |element: &str| {
        header.elements.get(element).map(|e| &e.properties).ok_or_else(|| {
            Error::field(path, format!("element {element}"), "missing from the header", EXPORT_AGAIN)
        })
    };
    let vertex = properties("vertex")?;
    for axis in ["x", "y", "z"] {
        if !vertex.get(axis).is_some_and(|p| matches!(p.data_type, PropertyType::Scalar(_))) {
            let field = format!("element vertex, property {axis}");
            return Err(Error::field(path, field, "missing, or not a number", EXPORT_AGAIN));
        }
    }
    let face = properties("face")?;
    let indices = face.get("vertex_indices").or_else(|| face.get("vertex_index"));
    if !indices.is_some_and(|p| matches!(p.data_type, PropertyType::List(..))) {
        let field = "element face, property vertex_indices";
        return Err(Error::field(path, field, "missing, or not a list", EXPORT_AGAIN));
    }
    for (name, element) in &header.elements {
        let bytes_each = element.properties.len();
        if bytes_each == 0 || element.count > file_size / bytes_each {
            let problem = format!(
                "{} of {bytes_each} properties are announced, but the file has {file_size} bytes",
                element.count
            );
            return Err(Error::field(path, format!("element {name}"), problem, EXPORT_AGAIN));
        }
    }
    Ok(())
}

/// Splits polygons into triangles that share the first vertex.
fn fans(path: &Path, faces: &[Element]) -> Result<Vec<[u32; 3]>> {
    let mut triangles = Vec::with_capacity(faces.len());
    for (k, face) in faces.iter().enumerate() {
        let place = || format!("element face {k}, property vertex_indices");
        if face.bad_index {
            return Err(Error::field(path, place(), "not a list of whole numbers from 0", EXPORT_AGAIN));
        }
        let [first, rest @ ..] = face.polygon.as_slice() else {
            return Err(Error::field(path, place(), "the face has no vertices", EXPORT_AGAIN));
        };
        if rest.len() < 2 {
            return Err(Error::field(path, place(), "the face has fewer than 3 vertices", EXPORT_AGAIN));
        }
        triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
    }
    Ok(triangles)
}

/// The parser's error with its place: the line in text, the element in binary data.
fn located(path: &Path, field: &str, is_text: bool, error: &ParseError) -> Error {
    let text = error.to_string();
    let problem = text.split('\n').map(str::trim).filter(|s| !s.is_empty()).collect::<Vec<_>>().join(", ");
    match error.line().and_then(|line| u64::try_from(line).ok()) {
        Some(line) if is_text => {
            let prefix = format!("Line {line}: ");
            let problem = problem.strip_prefix(&prefix).unwrap_or(&problem);
            Error::line(path, line, format!("{field}: {problem}"), EXPORT_AGAIN)
        }
        _ => Error::field(path, field, problem, EXPORT_AGAIN),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use proptest::prelude::*;

    const SQUARE: &[u8] =
        b"ply\nformat ascii 1.0\ncomment a square of 2 m\nelement vertex 4\nproperty float x\n\
property double y\nproperty float z\nproperty uchar red\nelement face 1\nproperty uchar flags\n\
property list uchar int vertex_indices\nelement edge 1\nproperty int vertex1\nend_header\n\
0 0 0 255\n2000 0 0 255\n2000 2000 0 255\n0 2000 0 255\n1 4 0 1 2 3\n7\n";

    /// The same square in binary; `order` turns a number's little-endian bytes into the file's.
    fn binary(encoding: &str, order: fn(&mut [u8])) -> Vec<u8> {
        let mut out = format!(
            "ply\nformat {encoding} 1.0\nelement vertex 4\nproperty float x\nproperty double y\n\
             property short z\nelement face 1\nproperty list uchar uint vertex_index\nend_header\n"
        )
        .into_bytes();
        let mut put = |bytes: &mut [u8]| {
            order(bytes);
            out.extend_from_slice(bytes);
        };
        for (x, y) in [(0.0, 0.0), (2000.0, 0.0), (2000.0, 2000.0), (0.0, 2000.0)] {
            put(&mut f32::to_le_bytes(x));
            put(&mut f64::to_le_bytes(y));
            put(&mut i16::to_le_bytes(0));
        }
        put(&mut [4]);
        for k in 0..4_u32 {
            put(&mut k.to_le_bytes());
        }
        out
    }

    fn error(bytes: &[u8]) -> String {
        with_file("m.ply", bytes, read).expect_err("must be refused").to_string()
    }

    #[test]
    fn all_encodings_give_the_same_square() {
        let little = binary("binary_little_endian", |_| {});
        let big = binary("binary_big_endian", |b| b.reverse());
        for bytes in [SQUARE, &little, &big] {
            let mesh = with_file("m.ply", bytes, read).unwrap();
            assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]], "a fan");
            assert_eq!(mesh.vertices[2], Point3::new(2.0, 2.0, 0.0), "metres");
            assert!((mesh.area() - 4.0).abs() < 1e-12, "{}", mesh.area());
        }
    }

    #[test]
    fn errors_name_line_or_element() {
        let text = String::from_utf8(SQUARE.to_vec()).unwrap();
        let bad_number = error(text.replace("2000 2000 0 255", "2000 abc 0 255").as_bytes());
        assert!(bad_number.contains("m.ply:17:") && bad_number.contains("vertex"), "{bad_number}");
        let cut = error(&SQUARE[..SQUARE.len() - 30]);
        assert!(cut.contains("m.ply:") && cut.contains("end of file"), "{cut}");
        let little = binary("binary_little_endian", |_| {});
        let cut = error(&little[..little.len() - 30]);
        assert!(cut.contains("element vertex") && cut.contains("end of file"), "{cut}");
        let range = error(text.replace("4 0 1 2 3", "4 0 1 2 9").as_bytes());
        assert!(range.contains("triangle 1"), "{range}");
        let negative = error(text.replace("4 0 1 2 3", "4 0 1 -2 3").as_bytes());
        assert!(negative.contains("face 0"), "{negative}");
        let flat = error(text.replace("4 0 1 2 3", "3 0 1 1").as_bytes());
        assert!(flat.contains("area is zero"), "{flat}");
        let huge = error(text.replace("element edge 1", "element edge 99999999999").as_bytes());
        assert!(huge.contains("element edge"), "{huge}");
        let without = error(text.replace("property double y", "property double w").as_bytes());
        assert!(without.contains("property y"), "{without}");
        assert!(error(b"").contains("header"), "an empty file");
    }

    proptest! {
        #[test]
        fn no_damaged_text_panics(bytes in damaged(SQUARE)) {
            let _ = with_file("m.ply", &bytes, read);
        }

        #[test]
        fn no_damaged_binary_panics(cut in 0..300_usize, at in 0..300_usize, value in any::<u8>()) {
            let mut bytes = binary("binary_big_endian", |b| b.reverse());
            if let Some(byte) = bytes.get_mut(at) {
                *byte = value;
            }
            bytes.truncate(cut);
            let _ = with_file("m.ply", &bytes, read);
        }
    }
}
