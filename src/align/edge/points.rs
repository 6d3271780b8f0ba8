//! Edge points of a model: strong edges of the template and the borders of its faces, as points in space.

use std::collections::HashMap;

use nalgebra::{Point3, Vector2, Vector3};

use crate::model::{ChartGeometry, LevelTemplate, Model};

/// Weaker template edges are not used, grey levels per pixel.
const MIN_CONTRAST: f64 = 8.0;
/// An edge must keep its direction this well (cosine) to both sides: corners cannot be placed by a search along one
/// line.
const MIN_STRAIGHTNESS: f64 = 0.95;
/// How far to both sides it is looked at, pixels.
const REACH_PX: f64 = 2.0;

/// A point on an edge, object frame.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct EdgePoint {
    /// The triangle it lies on, for visibility.
    pub(super) triangle: usize,
    /// Metres.
    pub(super) point: Point3<f64>,
    /// A step along the edge, metres; some pixels long.
    pub(super) along: Vector3<f64>,
    /// For edges of the template: a step of one template pixel towards the brighter side, metres, and the slope there,
    /// grey levels per template pixel. Nothing is known about what lies beyond a border.
    pub(super) bright: Option<(Vector3<f64>, f64)>,
}

/// About `count` points of a level, template edges evenly spread over it.
pub(super) fn template_edges(level: &LevelTemplate, count: usize) -> Vec<EdgePoint> {
    let map = GradientMap::new(level);
    let mut candidates: Vec<Candidate> = map.at.values().filter_map(|&p| map.candidate(p)).collect();
    // Strongest first; the pixel decides between equals, so that the order of the map does not.
    candidates.sort_by(|a, b| b.slope.total_cmp(&a.slope).then(a.pixel.cmp(&b.pixel)));
    #[expect(clippy::cast_precision_loss, reason = "pixel counts are far below 2^52")]
    let spacing = (level.pixels.len() as f64 / (2 * count.max(1)) as f64).sqrt().max(2.0);
    #[expect(clippy::cast_possible_truncation, reason = "pixel coordinates")]
    let cell = |view: u32, x: f64, y: f64| (view, (x / spacing).floor() as i64, (y / spacing).floor() as i64);
    let mut taken: HashMap<_, Vec<Vector2<f64>>> = HashMap::new();
    let mut points = Vec::new();
    for candidate in candidates {
        let at = candidate.position;
        let (view, i, j) = cell(candidate.view, at.x, at.y);
        let near = (-1..=1).flat_map(|a| (-1..=1).map(move |b| (view, i + a, j + b)));
        if near.filter_map(|c| taken.get(&c)).flatten().any(|o| (o - at).norm() < spacing) {
            continue;
        }
        if let Some(point) = candidate.lift(level) {
            taken.entry((view, i, j)).or_default().push(at);
            points.push(point);
        }
        if points.len() == count {
            break;
        }
    }
    points
}

/// An edge pixel with its place between pixels.
struct Candidate {
    pixel: usize,
    triangle: usize,
    view: u32,
    /// Absolute in the view's level image.
    position: Vector2<f64>,
    /// Unit vector towards the brighter side.
    normal: Vector2<f64>,
    slope: f64,
}

impl Candidate {
    fn lift(&self, level: &LevelTemplate) -> Option<EdgePoint> {
        let geometry = level.geometry[self.triangle].as_ref()?;
        let origin = level.charts[self.triangle].origin.map(f64::from);
        let at = self.position - Vector2::from(origin);
        let tangent = Vector2::new(-self.normal.y, self.normal.x);
        let point = surface(geometry, at)?;
        let along = surface(geometry, at + REACH_PX * tangent)? - point;
        let bright = surface(geometry, at + self.normal)? - point;
        Some(EdgePoint { triangle: self.triangle, point, along, bright: Some((bright, self.slope)) })
    }
}

/// The object point under a chart position.
fn surface(geometry: &ChartGeometry, at: Vector2<f64>) -> Option<Point3<f64>> {
    let x = geometry.object_from_chart * Vector3::new(at.x, at.y, 1.0);
    (x.w.abs() > f64::MIN_POSITIVE).then(|| Point3::from(x.xyz() / x.w))
}

/// Template gradients by their pixel in the reference views.
struct GradientMap<'a> {
    level: &'a LevelTemplate,
    triangle_of: Vec<usize>,
    at: HashMap<(u32, i64, i64), usize>,
}

impl<'a> GradientMap<'a> {
    fn new(level: &'a LevelTemplate) -> Self {
        let mut triangle_of = vec![0; level.pixels.len()];
        let mut at = HashMap::new();
        for (t, chart) in level.charts.iter().enumerate() {
            for p in chart.range() {
                triangle_of[p] = t;
                let [u, v] =
                    [0, 1].map(|k| i64::from(chart.origin[k]) + i64::from(level.pixels.position[p][k]));
                at.insert((chart.view, u, v), p);
            }
        }
        Self { level, triangle_of, at }
    }

    fn gradient(&self, p: usize) -> Vector2<f64> {
        Vector2::from(self.level.pixels.gradient[p].map(f64::from))
    }

    /// Bilinear; `None` where a pixel is missing.
    fn sample(&self, view: u32, x: Vector2<f64>) -> Option<Vector2<f64>> {
        let (corner, f) = (x.map(f64::floor), x - x.map(f64::floor));
        #[expect(clippy::cast_possible_truncation, reason = "pixel coordinates")]
        let (u, v) = (corner.x as i64, corner.y as i64);
        let g = |a: i64, b: i64| self.at.get(&(view, u + a, v + b)).map(|&p| self.gradient(p));
        let top = g(0, 0)? * (1.0 - f.x) + g(1, 0)? * f.x;
        let bottom = g(0, 1)? * (1.0 - f.x) + g(1, 1)? * f.x;
        Some(top * (1.0 - f.y) + bottom * f.y)
    }

    /// The pixel as an edge point, if its slope is the largest across a straight edge.
    fn candidate(&self, p: usize) -> Option<Candidate> {
        let gradient = self.gradient(p);
        let slope = gradient.norm();
        if slope < MIN_CONTRAST {
            return None;
        }
        let normal = gradient / slope;
        let triangle = self.triangle_of[p];
        let chart = &self.level.charts[triangle];
        let position = self.level.pixels.position[p];
        let at = Vector2::new(0, 1).map(|k: usize| f64::from(chart.origin[k]) + f64::from(position[k]));
        let across = |d: f64| Some(self.sample(chart.view, at + d * normal)?.dot(&normal));
        let (before, after) = (across(-1.0)?, across(1.0)?);
        if before > slope || after > slope {
            return None;
        }
        let offset = 0.5 * (before - after) / (before - 2.0 * slope + after).min(-1e-9);
        let tangent = Vector2::new(-normal.y, normal.x);
        for side in [-REACH_PX, REACH_PX] {
            let there = self.sample(chart.view, at + side * tangent)?;
            if there.dot(&normal) < MIN_STRAIGHTNESS * there.norm() || there.norm() < 0.5 * slope {
                return None;
            }
        }
        let position = at + offset.clamp(-0.6, 0.6) * normal;
        Some(Candidate { pixel: p, triangle, view: chart.view, position, normal, slope })
    }
}

/// About `count` points on the borders of the faces, evenly spaced.
pub(super) fn border_points(model: &Model, count: usize) -> Vec<EdgePoint> {
    let shape = &model.shape;
    let edges = || shape.faces.borders.iter().enumerate().flat_map(|(f, b)| b.iter().map(move |e| (f, e)));
    let total: f64 = edges().map(|(_, [a, b])| (b - a).norm()).sum();
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    let spacing = total / count.max(1) as f64;
    let mut points = Vec::new();
    // Distance to the next point, carried over from edge to edge.
    let mut next = spacing / 2.0;
    for (face, [a, b]) in edges() {
        let length = (b - a).norm();
        while next < length {
            let point = a + (b - a) * (next / length);
            if let Some(triangle) = triangle_at(model, face, &point) {
                let along = (b - a) * (0.003 / length);
                points.push(EdgePoint { triangle, point, along, bright: None });
            }
            next += spacing;
        }
        next -= length;
    }
    points
}

/// The triangle of a face whose border passes nearest to a point.
fn triangle_at(model: &Model, face: usize, point: &Point3<f64>) -> Option<usize> {
    let shape = &model.shape;
    let of_face = shape.faces.of_triangle.iter().enumerate().filter(|(_, f)| **f as usize == face);
    let distance = |t: usize| {
        let [a, b, c] = shape.mesh.corners(t);
        [(a, b), (b, c), (c, a)].map(|(a, b)| to_segment(point, &a, &b)).into_iter().fold(f64::MAX, f64::min)
    };
    of_face.map(|(t, _)| (t, distance(t))).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(t, _)| t)
}

fn to_segment(point: &Point3<f64>, a: &Point3<f64>, b: &Point3<f64>) -> f64 {
    let (along, to) = (b - a, point - a);
    let share = (to.dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    (to - along * share).norm()
}
