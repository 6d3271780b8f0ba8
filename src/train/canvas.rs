//! The pixels of all charts of one level, and the template gradient on them.

use std::collections::HashMap;

use nalgebra::Point2;

use crate::geometry::raster::for_each_pixel;
use crate::model::{Shape, View};

/// A pixel of a reference view that belongs to a triangle.
#[derive(Debug, Clone, Copy)]
pub(super) struct ChartPixel {
    /// Pixel of the view's level image.
    pub(super) position: [u32; 2],
    /// Far enough from the border of its face to be used.
    pub(super) inner: bool,
}

/// All chart pixels of one level.
#[derive(Debug)]
pub(super) struct LevelCharts {
    pub(super) pixels: Vec<ChartPixel>,
    /// Pixel indices of every triangle.
    pub(super) by_triangle: Vec<Vec<usize>>,
    pub(super) view_of_triangle: Vec<Option<u32>>,
    pub(super) face_of_triangle: Vec<u32>,
    /// Pixel index by (view, face, u, v): neighbours exist only within one face in one view.
    index: HashMap<(u32, u32, u32, u32), usize>,
}

impl LevelCharts {
    /// Finds the pixels of every triangle in its reference view; a pixel on an edge belongs to the first triangle.
    pub(super) fn rasterise(
        shape: &Shape,
        views: &[View],
        view_of_triangle: &[Option<u32>],
        level: usize,
        margin: f64,
    ) -> Self {
        let mut charts = Self {
            pixels: Vec::new(),
            by_triangle: vec![Vec::new(); shape.triangles()],
            view_of_triangle: view_of_triangle.to_vec(),
            face_of_triangle: shape.faces.of_triangle.clone(),
            index: HashMap::new(),
        };
        let mut borders = HashMap::new();
        for (triangle, view) in view_of_triangle.iter().enumerate() {
            let Some(number) = *view else { continue };
            let face = shape.faces.of_triangle[triangle];
            let view = &views[number as usize];
            let border =
                borders.entry((number, face)).or_insert_with(|| project_border(shape, face, view, level));
            charts.add_triangle(shape, triangle, (number, view), level, |p| distance_to(border, p) >= margin);
        }
        charts
    }

    fn add_triangle(
        &mut self,
        shape: &Shape,
        triangle: usize,
        (number, view): (u32, &View),
        level: usize,
        inner: impl Fn(&Point2<f64>) -> bool,
    ) {
        let face = shape.faces.of_triangle[triangle];
        let camera = view.camera.at_level(level);
        let project = |x| camera.project(&view.camera_from_object.transform_point(&x));
        let [Some(a), Some(b), Some(c)] = shape.mesh.corners(triangle).map(project) else { return };
        for_each_pixel(&[a, b, c], camera.width, camera.height, |u, v| {
            let next = self.pixels.len();
            if *self.index.entry((number, face, u, v)).or_insert(next) == next {
                let inner = inner(&Point2::new(f64::from(u), f64::from(v)));
                self.pixels.push(ChartPixel { position: [u, v], inner });
                self.by_triangle[triangle].push(next);
            }
        });
    }

    /// Template gradient (u, v) per pixel by central differences, one-sided where one neighbour is not of the same
    /// face and view, so that nothing of the background or of another face gets in; `None` where both are missing.
    pub(super) fn gradients(&self, mean: &[f64]) -> Vec<Option<[f64; 2]>> {
        let mut gradients = vec![None; self.pixels.len()];
        for (triangle, members) in self.by_triangle.iter().enumerate() {
            let (view, face) =
                (self.view_of_triangle[triangle].unwrap_or(0), self.face_of_triangle[triangle]);
            for &p in members {
                let [u, v] = self.pixels[p].position;
                let at = |du: i32, dv: i32| {
                    let (u, v) = (u.checked_add_signed(du)?, v.checked_add_signed(dv)?);
                    self.index.get(&(view, face, u, v)).map(|&i| mean[i])
                };
                let along = |du: i32, dv: i32| difference(at(-du, -dv), mean[p], at(du, dv));
                gradients[p] = along(1, 0).zip(along(0, 1)).map(|(gu, gv)| [gu, gv]);
            }
        }
        gradients
    }
}

fn difference(before: Option<f64>, here: f64, after: Option<f64>) -> Option<f64> {
    match (before, after) {
        (Some(b), Some(a)) => Some((a - b) / 2.0),
        (Some(b), None) => Some(here - b),
        (None, Some(a)) => Some(a - here),
        (None, None) => None,
    }
}

/// Border edges of a face in a view's level image; edges that reach behind the camera are left out.
fn project_border(shape: &Shape, face: u32, view: &View, level: usize) -> Vec<[Point2<f64>; 2]> {
    let camera = view.camera.at_level(level);
    let project = |x| camera.project(&view.camera_from_object.transform_point(x));
    let edges = shape.faces.borders[face as usize].iter();
    edges.filter_map(|[a, b]| Some([project(a)?, project(b)?])).collect()
}

fn distance_to(border: &[[Point2<f64>; 2]], p: &Point2<f64>) -> f64 {
    let distance = |[a, b]: &[Point2<f64>; 2]| {
        let along = b - a;
        let s = ((p - a).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        (p - (a + along * s)).norm()
    };
    border.iter().map(distance).fold(f64::INFINITY, f64::min)
}
