//! The 3D shape that is tracked: a mesh cut into small flat triangles, grouped into smooth faces.

use std::collections::HashMap;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::geometry::mesh::{Faces, TriangleMesh};

/// Neighbouring triangles whose normals differ by more than this (50 degrees) belong to different faces.
pub const CREASE_ANGLE: f64 = 50.0 * std::f64::consts::PI / 180.0;

/// 3D shape in the object frame, metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shape {
    /// The triangles that carry charts.
    pub mesh: TriangleMesh,
    /// Smooth faces of the triangles, with their borders.
    pub faces: Faces,
    /// Corner points of the bounding box (metres), for errors in pixels and for overlays.
    pub corners: [Point3<f64>; 8],
    /// Centre of rotation of pose increments: the mean of the vertices of the uncut mesh, metres.
    pub centre: Point3<f64>,
}

impl Shape {
    /// Builds a shape from a mesh; triangles with an edge longer than `limit` in the measure `length` are cut.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] if the mesh is not usable ([`TriangleMesh::validate`]).
    pub fn from_mesh(
        mesh: &TriangleMesh,
        limit: f64,
        length: impl Fn(&Point3<f64>, &Point3<f64>) -> f64,
    ) -> Result<Self> {
        mesh.validate()?;
        let whole = mesh.welded();
        let faces = whole.faces(CREASE_ANGLE);
        let (pieces, source) = whole.subdivided(limit, length);
        let of_triangle = source.iter().map(|&s| faces.of_triangle[s]).collect();
        let (lo, hi) = whole.bounds();
        let pick = |bit: usize, k: usize| if k >> bit & 1 == 0 { lo[bit] } else { hi[bit] };
        let corners = std::array::from_fn(|k| Point3::new(pick(0, k), pick(1, k), pick(2, k)));
        let sum = whole.vertices.iter().fold(nalgebra::Vector3::zeros(), |s, v| s + v.coords);
        #[expect(clippy::cast_precision_loss, reason = "vertex counts are far below 2^52")]
        let centre = Point3::from(sum / whole.vertices.len() as f64);
        Ok(Self { mesh: pieces, faces: Faces { of_triangle, ..faces }, corners, centre })
    }

    /// Checks a shape that comes from a file.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] if mesh, faces or centre do not fit together.
    pub fn validate(&self) -> Result<()> {
        self.mesh.validate()?;
        let faces = &self.faces;
        let numbered = faces.of_triangle.iter().all(|&f| (f as usize) < faces.borders.len());
        let finite = self.corners.iter().chain([&self.centre]).all(|p| p.iter().all(|c| c.is_finite()));
        if faces.of_triangle.len() != self.triangles() || !numbered || !finite {
            return Err(Error::invalid(
                "shape",
                "faces and triangles do not fit together",
                "train the model again",
            ));
        }
        Ok(())
    }

    /// True if a triangle has been cut in two: neighbours whose outer corners have a common corner halfway between them.
    /// Of the last cut of [`Self::from_mesh`] both pieces are left, so none goes unnoticed.
    pub fn is_cut(&self) -> bool {
        let mut opposite = HashMap::new();
        self.mesh.triangles.iter().any(|t| {
            (0..3).any(|k| {
                let (a, b, outer) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
                let Some(other) = opposite.insert([a.min(b), a.max(b)], outer) else { return false };
                let [a, b, outer, other] = [a, b, outer, other].map(|v| self.mesh.vertices[v as usize]);
                let middle = nalgebra::center(&outer, &other);
                middle == a || middle == b
            })
        })
    }

    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.mesh.triangles.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_shape_knows_it() {
        let corner = |x: f64, y: f64| Point3::new(x, y, 0.1 * x * y);
        let vertices = vec![corner(0.0, 0.0), corner(1.0, 0.1), corner(1.1, 0.9), corner(0.1, 1.0)];
        let mesh = TriangleMesh { vertices, triangles: vec![[0, 1, 2], [0, 2, 3]] };
        let shape = |limit: f64| Shape::from_mesh(&mesh, limit, |a, b| (b - a).norm()).unwrap();
        assert!(!shape(f64::INFINITY).is_cut(), "as it was");
        for limit in [1.2, 0.7, 0.3, 0.1] {
            assert!(shape(limit).is_cut(), "{limit}");
        }
    }
}
