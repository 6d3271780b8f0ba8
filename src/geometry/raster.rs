//! Which pixel centres a projected triangle covers, and which triangles of a mesh are hidden by others.

use std::ops::Range;

use nalgebra::{Point2, Point3, Vector3};

use super::camera::Camera;
use super::mesh::TriangleMesh;
use super::pose::Pose;
use super::warp::{double_area, plane};

/// A surface counts as hidden when something lies in front of it by more than this share of its depth.
const DEPTH_TOLERANCE: f64 = 0.004;
/// Pixel centres count as on a border if their distance times the border's length is below this, pixels squared.
const BORDER: f64 = 1e-9;
/// How much wider than between its edges a row of a triangle is looked at, pixels: the test of every pixel decides.
const SLACK: f64 = 1e-6;

/// Calls `visit(u, v)` for every pixel centre of a `width` x `height` image inside the triangle, borders included.
pub fn for_each_pixel(t: &[Point2<f64>; 3], width: u32, height: u32, mut visit: impl FnMut(u32, u32)) {
    for_each_run(t, width, height, |run| run.columns.for_each(|u| visit(u, run.row)));
}

/// Pixels side by side.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Run {
    row: u32,
    columns: Range<u32>,
}

/// Calls `visit` for the pixels of every row that [`for_each_pixel`] visits.
fn for_each_run(t: &[Point2<f64>; 3], width: u32, height: u32, mut visit: impl FnMut(Run)) {
    let sign = double_area(t).signum();
    let (lo, hi) = (t[0].inf(&t[1]).inf(&t[2]), t[0].sup(&t[1]).sup(&t[2]));
    let Some(rows) = span(lo.y, hi.y, height) else { return };
    let edges = [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (t[a], sign * (t[b] - t[a])));
    for row in rows {
        // On a row the side of an edge is `along - edge.y (u - start.x)`.
        let along = edges.map(|(start, edge)| edge.x * (f64::from(row) - start.y));
        let (mut left, mut right) = (lo.x, hi.x);
        for ((start, edge), along) in edges.iter().zip(along) {
            let crossing = start.x + (along + BORDER) / edge.y;
            if edge.y > 0.0 {
                right = right.min(crossing + SLACK);
            } else if edge.y < 0.0 {
                left = left.max(crossing - SLACK);
            }
        }
        let Some(mut columns) = span(left, right, width) else { continue };
        let is_inside = |u: u32| {
            let side = |k: usize| along[k] - edges[k].1.y * (f64::from(u) - edges[k].0.x);
            side(0) >= -BORDER && side(1) >= -BORDER && side(2) >= -BORDER
        };
        // What lies between two pixels inside is inside, whatever the rounding.
        while !columns.is_empty() && !is_inside(columns.start) {
            columns.start += 1;
        }
        while !columns.is_empty() && !is_inside(columns.end - 1) {
            columns.end -= 1;
        }
        if !columns.is_empty() {
            visit(Run { row, columns });
        }
    }
}

/// Integers in [lo, hi] that are also in [0, n).
fn span(lo: f64, hi: f64, n: u32) -> Option<Range<u32>> {
    let (lo, hi) = (lo.max(0.0), hi.min(f64::from(n) - 1.0));
    if lo > hi {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the image")]
    let (first, last) = (lo as u32, hi as u32);
    // Without a call of `ceil`.
    Some(first + u32::from(f64::from(first) < lo)..last + 1)
}

/// For every triangle of the mesh the share (0..1) of its pixels inside the image that nothing hides, by z-buffer
/// at the camera's resolution. Triangles that face away, reach behind the camera or lie outside get 0. A triangle
/// too small for any pixel is judged by the pixel nearest to its centroid.
pub fn visible_shares(mesh: &TriangleMesh, camera: &Camera, pose: &Pose) -> Vec<f64> {
    let mut shares = Vec::new();
    ZBuffer::default().visible_shares(mesh, camera, pose, &mut shares);
    shares
}

/// The memory of [`visible_shares`], for calls in a row.
#[derive(Debug, Default)]
pub struct ZBuffer {
    /// Vertices in the camera frame, with their pixels.
    vertices: Vec<(Point3<f64>, Option<Point2<f64>>)>,
    facets: Vec<Option<Facet>>,
    /// Inverse of the smallest depth per pixel, 0 where there is nothing.
    nearness: Vec<f64>,
    /// Pixels of all facets, one after the other.
    runs: Vec<Run>,
}

impl ZBuffer {
    /// As the function [`visible_shares`]; replaces what is in `shares`.
    pub fn visible_shares(
        &mut self,
        mesh: &TriangleMesh,
        camera: &Camera,
        pose: &Pose,
        shares: &mut Vec<f64>,
    ) {
        self.project(mesh, camera, pose);
        let Self { facets, nearness, runs, .. } = self;
        let (w, h) = (camera.width, camera.height);
        nearness.clear();
        nearness.resize(w as usize * h as usize, 0.0);
        runs.clear();
        for facet in facets.iter_mut().flatten() {
            let first = runs.len();
            for_each_run(&facet.corners, w, h, |run| runs.push(run));
            for run in &runs[first..] {
                for (nearest, nearness) in nearness[run.of_image(w)].iter_mut().zip(facet.nearness_of(run)) {
                    *nearest = if nearness > *nearest { nearness } else { *nearest };
                }
            }
            if runs.len() == first {
                // Too small to hide anything.
                for_each_run(&[facet.centroid_pixel(); 3], w, h, |run| runs.push(run));
            }
            facet.runs = first..runs.len();
        }
        // Room for an object that comes nearer: most tracks then never ask for more.
        runs.reserve(runs.len());
        let share = |facet: &Facet| {
            let (mut free, mut all) = (0_u32, 0);
            for run in &runs[facet.runs.clone()] {
                all += run.columns.end - run.columns.start;
                for (nearest, nearness) in nearness[run.of_image(w)].iter().zip(facet.nearness_of(run)) {
                    free += u32::from(nearness >= nearest * (1.0 - DEPTH_TOLERANCE));
                }
            }
            if all == 0 { 0.0 } else { f64::from(free) / f64::from(all) }
        };
        shares.clear();
        shares.extend(facets.iter().map(|facet| facet.as_ref().map_or(0.0, share)));
    }

    /// A triangle as the last call saw it; `None` if it faces away or reaches behind the camera.
    pub fn facet(&self, triangle: usize) -> Option<&Facet> {
        self.facets[triangle].as_ref()
    }

    fn project(&mut self, mesh: &TriangleMesh, camera: &Camera, pose: &Pose) {
        let Self { vertices, facets, .. } = self;
        let placed = |x| {
            let in_camera = pose.transform_point(x);
            (in_camera, camera.project(&in_camera))
        };
        vertices.clear();
        vertices.extend(mesh.vertices.iter().map(placed));
        let facet = |t: &[u32; 3]| Facet::new(&t.map(|v| vertices[v as usize]), camera);
        facets.clear();
        facets.extend(mesh.triangles.iter().map(facet));
    }
}

impl Run {
    /// Where its pixels are in an image of a width.
    fn of_image(&self, width: u32) -> Range<usize> {
        let row = self.row as usize * width as usize;
        row + self.columns.start as usize..row + self.columns.end as usize
    }
}

/// A triangle that faces the camera, in the image.
#[derive(Debug)]
pub struct Facet {
    /// Its corners, pixels.
    pub corners: [Point2<f64>; 3],
    /// Cosine between its normal and the direction from its centroid to the camera.
    pub cosine: f64,
    /// The inverse of its depth at pixel (u, v) is the inner product with (u, v, 1), 1/m.
    nearness: Vector3<f64>,
    /// Where its pixels are among the runs.
    runs: Range<usize>,
}

impl Facet {
    /// The triangle of three points in the camera frame, which come with their pixels.
    fn new(corners: &[(Point3<f64>, Option<Point2<f64>>); 3], camera: &Camera) -> Option<Self> {
        let points = corners.map(|(x, _)| x);
        let (normal, offset) = plane(&points)?;
        // Outward normals point towards the camera at the origin: n.(0 - X) > 0.
        if offset >= 0.0 {
            return None;
        }
        let [a, b, c] = corners.map(|(_, pixel)| pixel);
        // The point seen through a pixel is depth times ray with n.X = offset.
        let scaled = normal / offset;
        let (x, y, z) = (scaled.x / camera.fx, scaled.y / camera.fy, scaled.z);
        Some(Self {
            corners: [a?, b?, c?],
            cosine: -offset / centroid(&points).norm(),
            nearness: Vector3::new(x, y, z - x * camera.cx - y * camera.cy),
            runs: 0..0,
        })
    }

    fn centroid_pixel(&self) -> Point2<f64> {
        let [a, b, c] = self.corners;
        Point2::from((a.coords + b.coords + c.coords) / 3.0).map(f64::round)
    }

    /// Inverse depths of the pixels of a run.
    fn nearness_of(&self, run: &Run) -> impl Iterator<Item = f64> + use<> {
        let (slope, start) = (self.nearness.x, self.nearness.y * f64::from(run.row) + self.nearness.z);
        run.columns.clone().map(move |u| slope * f64::from(u.cast_signed()) + start)
    }
}

fn centroid([a, b, c]: &[Point3<f64>; 3]) -> Vector3<f64> {
    (a.coords + b.coords + c.coords) / 3.0
}

/// Cosine between a triangle's outward normal and the direction from its centroid to the camera; negative from
/// behind.
pub fn facing(points: &[Point3<f64>; 3], pose: &Pose) -> f64 {
    let points = points.map(|x| pose.transform_point(&x));
    let [a, b, c] = &points;
    let (normal, centroid) = ((b - a).cross(&(c - a)), centroid(&points));
    -normal.dot(&centroid) / (normal.norm() * centroid.norm()).max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_of_a_right_triangle() {
        let t = [Point2::new(1.0, 1.0), Point2::new(4.0, 1.0), Point2::new(1.0, 4.0)];
        let mut pixels = Vec::new();
        for_each_pixel(&t, 100, 100, |u, v| pixels.push((u, v)));
        assert_eq!(pixels.len(), 10, "{pixels:?}");
        let mut clipped = 0;
        for_each_pixel(&t.map(|p| p - Vector3::new(2.0, 2.0, 0.0).xy()), 100, 100, |_, _| clipped += 1);
        assert_eq!(clipped, 3, "only (0,0), (1,0), (0,1) are in the image");
    }

    /// Two squares facing the camera, the nearer one covering the left half of the farther one.
    #[test]
    fn a_near_square_hides_half_of_a_far_one() {
        let square = |x0: f64, x1: f64, z: f64| {
            [(x0, -0.1), (x0, 0.1), (x1, 0.1), (x1, -0.1)].map(|(x, y)| Point3::new(x * z, y * z, z))
        };
        let mut mesh = TriangleMesh::default();
        for (q, points) in [square(-0.1, 0.1, 1.0), square(-0.1, 0.0, 0.5)].iter().enumerate() {
            let k = 4 * u32::try_from(q).expect("small");
            mesh.vertices.extend(points);
            mesh.triangles.extend([[k, k + 1, k + 2], [k, k + 2, k + 3]]);
        }
        let camera = Camera::pinhole(400.0, 400.0, 79.5, 59.5, 160, 120);
        let shares = visible_shares(&mesh, &camera, &Pose::identity());
        assert!((shares[0] + shares[1] - 1.0).abs() < 0.06, "half of the far square: {shares:?}");
        assert!(shares[2] == 1.0 && shares[3] == 1.0, "the near square is free: {shares:?}");
        let behind = Pose::new(nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), 3.0), Vector3::z());
        assert!(visible_shares(&mesh, &camera, &behind).iter().all(|&s| s == 0.0), "backs are not visible");
        assert!(facing(&mesh.corners(0), &Pose::identity()) > 0.95, "the square faces the camera");
    }
}
