//! Perspective-exact scan conversion of triangles into rows of samples.
//!
//! With P = [p0 p1 p2] the corners in the camera frame, `P^-1 ray` holds the barycentric coordinates over
//! depth: three linear functions of the pixel that are the edge functions, sum up to 1/z, and interpolate
//! texture coordinates exactly.

use nalgebra::{Matrix3, Point2, Point3, Vector3};

use super::texture::Texture;
use crate::geometry::Camera;

/// Triangles nearer than this to the camera plane are left out, metres.
const NEAR: f64 = 1e-3;

/// Slack of the edge functions (1/m), so that no sample falls between two neighbours.
const EDGE_SLACK: f64 = 1e-10;

/// A visible triangle; functions of the sample position (x, y, 1).
#[derive(Debug)]
pub(super) struct Facet<'a> {
    texture: &'a Texture,
    shade: f64,
    edges: [Vector3<f64>; 3],
    inverse_depth: Vector3<f64>,
    s_over_depth: Vector3<f64>,
    t_over_depth: Vector3<f64>,
    rows: [f64; 2],
}

/// Depth and grey value of the samples of one row.
#[derive(Debug, Clone)]
pub(super) struct SampleRow {
    /// 1/z, 0 where nothing is seen.
    pub(super) inverse_depth: Vec<f64>,
    /// Grey value.
    pub(super) value: Vec<f64>,
}

impl SampleRow {
    /// A row of `count` empty samples.
    pub(super) fn new(count: usize) -> Self {
        Self { inverse_depth: vec![0.0; count], value: vec![0.0; count] }
    }

    /// Empties the row.
    pub(super) fn clear(&mut self) {
        self.inverse_depth.fill(0.0);
    }
}

impl<'a> Facet<'a> {
    /// Prepares a triangle given in the camera frame (metres) with its corners in the texture (texels), for
    /// `density` samples per pixel and axis; `None` if its front is not seen.
    pub(super) fn new(
        corners: &[Point3<f64>; 3],
        texture: &'a Texture,
        texels: &[Point2<f64>; 3],
        shade: f64,
        camera: &Camera,
        density: usize,
    ) -> Option<Self> {
        let [a, b, c] = corners;
        let normal = (b - a).cross(&(c - a));
        if corners.iter().any(|p| p.z < NEAR) || normal.dot(&a.coords) >= 0.0 {
            return None;
        }
        // Sample k lies at pixel (k + 0.5) / density - 0.5.
        let step = 1.0 / density as f64;
        let offset = 0.5 * step - 0.5;
        let pixel_from_sample = Matrix3::new(step, 0.0, offset, 0.0, step, offset, 0.0, 0.0, 1.0);
        let barycentric = Matrix3::from_columns(&corners.map(|p| p.coords)).try_inverse()?;
        let m = barycentric * camera.inverse_matrix() * pixel_from_sample;
        let edges = [0, 1, 2].map(|i| m.row(i).transpose());
        let blend = |w: [f64; 3]| edges[0] * w[0] + edges[1] * w[1] + edges[2] * w[2];
        let rows = corners.map(|p| ((camera.fy * p.y / p.z + camera.cy) - offset) / step);
        Some(Self {
            texture,
            shade,
            edges,
            inverse_depth: blend([1.0; 3]),
            s_over_depth: blend(texels.map(|p| p.x)),
            t_over_depth: blend(texels.map(|p| p.y)),
            rows: [rows[0].min(rows[1]).min(rows[2]) - 1e-6, rows[0].max(rows[1]).max(rows[2]) + 1e-6],
        })
    }

    /// Writes the samples of row `y` (sample units) that this triangle hides least.
    pub(super) fn fill(&self, y: usize, row: &mut SampleRow) {
        let y = y as f64;
        if y < self.rows[0] || y > self.rows[1] {
            return;
        }
        let Some((first, last)) = self.span(y, row.value.len()) else { return };
        let at_zero = |f: &Vector3<f64>| f.y * y + f.z;
        let [w0, s0, t0] = [&self.inverse_depth, &self.s_over_depth, &self.t_over_depth].map(at_zero);
        let [dw, ds, dt] = [self.inverse_depth.x, self.s_over_depth.x, self.t_over_depth.x];
        let samples = row.inverse_depth[first..=last].iter_mut().zip(&mut row.value[first..=last]);
        for (k, (nearest, value)) in samples.enumerate() {
            let x = (first + k) as f64;
            let w = w0 + dw * x;
            if w > *nearest {
                let z = 1.0 / w;
                *nearest = w;
                *value = self.shade * self.texture.sample((s0 + ds * x) * z, (t0 + dt * x) * z);
            }
        }
    }

    /// First and last sample of a row inside all three edges.
    fn span(&self, y: f64, count: usize) -> Option<(usize, usize)> {
        let (mut lo, mut hi) = (0.0, count as f64 - 1.0);
        for edge in &self.edges {
            let rest = edge.y * y + edge.z + EDGE_SLACK;
            if edge.x > 0.0 {
                lo = (-rest / edge.x).ceil().max(lo);
            } else if edge.x < 0.0 {
                hi = (-rest / edge.x).floor().min(hi);
            } else if rest < 0.0 {
                return None;
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "clamped to the row above")]
        let span = (lo as usize, hi as usize);
        (lo <= hi).then_some(span)
    }
}
