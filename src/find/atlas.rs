//! The charts of a model laid out as pictures, so that any pose can be rendered from them.

use nalgebra::{Matrix4x3, Point3};

use crate::geometry::warp::{self, double_area};
use crate::model::{LevelTemplate, Model, View};

/// Pictures are continued by so many pixels beyond the charts: interpolation needs neighbours at seams and borders.
const MARGIN: usize = 2;

/// The charts of one view at one level; NaN where there is none.
#[derive(Debug, Clone, Default)]
pub(super) struct Canvas {
    /// Pixel of the view's level image in the upper left corner.
    pub(super) origin: [f64; 2],
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) grey: Vec<f32>,
}

/// A triangle that has a chart.
#[derive(Debug, Clone)]
pub(super) struct Facet {
    pub(super) view: usize,
    pub(super) corners: [Point3<f64>; 3],
    /// Pixels (u, v, 1) of the view's full-size image to homogeneous object points.
    pub(super) object_from_view: Matrix4x3<f64>,
    /// Area in the view's full-size image, pixels.
    pub(super) area: f64,
}

/// All charts of a model.
#[derive(Debug, Clone)]
pub(super) struct Atlas {
    pub(super) facets: Vec<Facet>,
    /// By level, then by view.
    canvases: Vec<Vec<Canvas>>,
}

impl Atlas {
    pub(super) fn new(model: &Model) -> Self {
        let facet = |t: usize| {
            let chart = model.levels[0].charts.get(t).filter(|c| !c.is_empty())?;
            facet(model, t, chart.view as usize)
        };
        let facets = (0..model.shape.triangles()).filter_map(facet).collect();
        let canvases =
            |level: &LevelTemplate| (0..model.views.len()).map(|view| Canvas::new(level, view)).collect();
        Self { facets, canvases: model.levels.iter().map(canvases).collect() }
    }

    pub(super) fn levels(&self) -> usize {
        self.canvases.len()
    }

    pub(super) fn canvas(&self, level: usize, view: usize) -> &Canvas {
        &self.canvases[level][view]
    }
}

fn facet(model: &Model, triangle: usize, view: usize) -> Option<Facet> {
    let corners = model.shape.mesh.corners(triangle);
    let View { camera, camera_from_object } = &model.views[view];
    let in_view = corners.map(|x| camera_from_object.transform_point(&x));
    let plane = warp::plane(&in_view)?;
    let mut pixels = [nalgebra::Point2::origin(); 3];
    for (pixel, x) in pixels.iter_mut().zip(&in_view) {
        *pixel = camera.project(x)?;
    }
    let object_from_view = warp::object_from_chart(camera, camera_from_object, plane);
    Some(Facet { view, corners, object_from_view, area: double_area(&pixels).abs() / 2.0 })
}

impl Canvas {
    fn new(level: &LevelTemplate, view: usize) -> Self {
        let charts = || level.charts.iter().filter(|c| !c.is_empty() && c.view as usize == view);
        let pixels = || {
            charts().flat_map(|c| {
                c.range().map(|p| {
                    let offset = level.pixels.position[p];
                    let at = [0, 1].map(|k| c.origin[k] as usize + usize::from(offset[k]));
                    (at, level.pixels.intensity[p])
                })
            })
        };
        let mut bounds = [[usize::MAX, 0], [usize::MAX, 0]];
        for (at, _) in pixels() {
            for (bound, x) in bounds.iter_mut().zip(at) {
                *bound = [bound[0].min(x), bound[1].max(x)];
            }
        }
        if bounds[0][0] == usize::MAX {
            return Self::default();
        }
        let [width, height] = bounds.map(|[lo, hi]| hi - lo + 1 + 2 * MARGIN);
        let mut grey = vec![f32::NAN; width * height];
        for ([u, v], value) in pixels() {
            grey[(v - bounds[1][0] + MARGIN) * width + u - bounds[0][0] + MARGIN] = value;
        }
        #[expect(clippy::cast_precision_loss, reason = "images are far below 2^52 wide")]
        let origin = bounds.map(|[lo, _]| lo as f64 - MARGIN as f64);
        let mut canvas = Self { origin, width, height, grey };
        (0..MARGIN).for_each(|_| canvas.grow());
        canvas
    }

    /// Gives pixels without a value the mean of their neighbours that have one.
    fn grow(&mut self) {
        let old = self.grey.clone();
        let (w, h) = (self.width, self.height);
        for (at, value) in self.grey.iter_mut().enumerate().filter(|(_, v)| v.is_nan()) {
            let (x, y) = (at % w, at / w);
            let (mut sum, mut count) = (0.0, 0.0);
            for v in y.saturating_sub(1)..=(y + 1).min(h - 1) {
                for u in x.saturating_sub(1)..=(x + 1).min(w - 1) {
                    let neighbour = old[v * w + u];
                    if !neighbour.is_nan() {
                        sum += neighbour;
                        count += 1.0;
                    }
                }
            }
            if count > 0.0 {
                *value = sum / count;
            }
        }
    }

    /// Bilinear; NaN where a neighbour has no value.
    #[inline]
    pub(super) fn sample(&self, u: f64, v: f64) -> f32 {
        let (w, h) = (self.width as f64, self.height as f64);
        if !(u >= 0.0 && v >= 0.0 && u < w - 1.0 && v < h - 1.0) {
            return f32::NAN;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside, checked above")]
        let (x, y) = (u as usize, v as usize);
        #[expect(clippy::cast_possible_truncation, reason = "a fraction")]
        let (fu, fv) = ((u - x as f64) as f32, (v - y as f64) as f32);
        let at = y * self.width + x;
        let [a, b] = [self.grey[at], self.grey[at + 1]];
        let [c, d] = [self.grey[at + self.width], self.grey[at + self.width + 1]];
        let (top, bottom) = (a + fu * (b - a), c + fu * (d - c));
        top + fv * (bottom - top)
    }
}
