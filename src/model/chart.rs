//! The chart of a triangle: its pixels in the reference view that sees it best, and the geometry that
//! takes them to the object and to barycentric coordinates.

use nalgebra::{Matrix3, Matrix4x3, Point2, Point3};
use serde::{Deserialize, Serialize};

use super::shape::Shape;
use super::template::View;
use crate::geometry::warp;

/// Pixels of one triangle at one level. `start == end` where the triangle has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Chart {
    /// Reference view.
    pub view: u32,
    /// Pixel of that view's level image to which the positions are relative.
    pub origin: [u32; 2],
    /// First pixel in the level's [`super::Pixels`].
    pub start: u32,
    /// One past the last pixel.
    pub end: u32,
}

impl Chart {
    /// The pixels as an index range.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.start as usize..self.end as usize
    }

    /// True if the triangle has no pixels at this level.
    pub fn is_empty(&self) -> bool {
        self.start == self.end
    }
}

/// What can be computed from a chart, its view and its triangle, once per model.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartGeometry {
    /// Chart position (u, v, 1), relative to the origin, to the homogeneous object point in metres (`M` in
    /// `docs/maths.md`).
    pub object_from_chart: Matrix4x3<f64>,
    /// Chart position (u, v, 1) to the barycentric coordinates of the triangle.
    pub barycentric: Matrix3<f64>,
    /// The triangle's corners in chart positions.
    pub corners: [Point2<f64>; 3],
    /// The triangle's corners in the object frame, metres.
    pub points: [Point3<f64>; 3],
}

impl ChartGeometry {
    /// Centroid of the triangle, chart position.
    pub fn centroid(&self) -> Point2<f64> {
        let [a, b, c] = self.corners.map(|p| p.coords);
        Point2::from((a + b + c) / 3.0)
    }

    /// Geometry of triangle `triangle` of `shape` seen at pyramid level `level` of `view`; `None` if the triangle
    /// is edge-on or behind that view.
    pub fn new(shape: &Shape, triangle: usize, view: &View, level: usize, origin: [u32; 2]) -> Option<Self> {
        let camera = view.camera.at_level(level);
        let points = shape.mesh.corners(triangle);
        let in_view = points.map(|x| view.camera_from_object.transform_point(&x));
        let plane = warp::plane(&in_view)?;
        let shift = nalgebra::Vector2::new(f64::from(origin[0]), f64::from(origin[1]));
        let mut corners = [Point2::origin(); 3];
        for (corner, x) in corners.iter_mut().zip(&in_view) {
            *corner = camera.project(x)? - shift;
        }
        let barycentric = warp::barycentric_rows(&corners)?;
        let absolute = Matrix3::new(1.0, 0.0, shift.x, 0.0, 1.0, shift.y, 0.0, 0.0, 1.0);
        let object_from_chart = warp::object_from_chart(&camera, &view.camera_from_object, plane) * absolute;
        Some(Self { object_from_chart, barycentric, corners, points })
    }
}
