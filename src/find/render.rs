//! The model as a camera would see it at a pose: grey values from the charts of the right size, and depths.

use nalgebra::{Matrix3, Point2, Point3, Vector3};

use super::atlas::{Atlas, Facet};
use crate::geometry::warp::{double_area, homography, plane};
use crate::geometry::{Camera, Pose};

/// Pictures do not become larger than this on a side, pixels: poses that need more are no hypotheses.
pub(super) const MAX_SIDE: f64 = 400.0;

/// A rendered pose. The picture covers the object and may reach beyond the camera's image.
#[derive(Debug, Clone, Default)]
pub(super) struct Rendering {
    /// Pixel of the image in the upper left corner.
    pub(super) origin: [i32; 2],
    pub(super) width: usize,
    pub(super) height: usize,
    /// NaN where the model shows nothing.
    pub(super) grey: Vec<f32>,
    /// 1 / depth, per metre; 0 where nothing is.
    pub(super) inverse_depth: Vec<f32>,
}

impl Rendering {
    /// Renders into the memory of the last picture; empty if the object is not in front of the camera.
    pub(super) fn render(&mut self, atlas: &Atlas, camera: &Camera, pose: &Pose) {
        (self.width, self.height) = (0, 0);
        self.grey.clear();
        self.inverse_depth.clear();
        let projected: Vec<Option<[Point2<f64>; 3]>> =
            atlas.facets.iter().map(|f| project(camera, pose, f)).collect();
        let mut lo = Point2::new(f64::INFINITY, f64::INFINITY);
        let mut hi = -lo;
        for p in projected.iter().flatten().flatten() {
            (lo, hi) = (lo.inf(p), hi.sup(p));
        }
        if !(hi.x - lo.x < MAX_SIDE && hi.y - lo.y < MAX_SIDE && hi.x >= lo.x) {
            return;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded above")]
        {
            self.origin = [lo.x.ceil() as i32, lo.y.ceil() as i32];
            self.width = (hi.x.floor() - lo.x.ceil() + 1.0).max(0.0) as usize;
            self.height = (hi.y.floor() - lo.y.ceil() + 1.0).max(0.0) as usize;
        }
        self.grey.resize(self.width * self.height, f32::NAN);
        self.inverse_depth.resize(self.width * self.height, 0.0);
        for (facet, corners) in atlas.facets.iter().zip(&projected) {
            if let Some(corners) = corners {
                self.fill(atlas, facet, corners, camera, pose);
            }
        }
    }

    fn fill(
        &mut self,
        atlas: &Atlas,
        facet: &Facet,
        corners: &[Point2<f64>; 3],
        camera: &Camera,
        pose: &Pose,
    ) {
        let Some(warp) = ChartWarp::new(atlas, facet, corners, camera, pose) else { return };
        let canvas = atlas.canvas(warp.level, facet.view);
        let first = Point2::new(f64::from(self.origin[0]), f64::from(self.origin[1]));
        let corners = corners.map(|p| p - first.coords);
        let (size_u, size_v) = (self.width as f64, self.height as f64);
        let lo = corners[0].inf(&corners[1]).inf(&corners[2]);
        let hi = corners[0].sup(&corners[1]).sup(&corners[2]);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the picture")]
        let span =
            |lo: f64, hi: f64, n: f64| lo.ceil().max(0.0) as usize..(hi.floor() + 1.0).clamp(0.0, n) as usize;
        for y in span(lo.y, hi.y, size_v) {
            for x in span(lo.x, hi.x, size_u) {
                let p = Point2::new(x as f64, y as f64);
                // Clockwise on screen: seen from outside.
                let inside = |a: usize, b: usize| (corners[b] - corners[a]).perp(&(p - corners[a])) >= -1e-9;
                if !(inside(0, 1) && inside(1, 2) && inside(2, 0)) {
                    continue;
                }
                let pixel = Vector3::new(p.x + first.x, p.y + first.y, 1.0);
                #[expect(clippy::cast_possible_truncation, reason = "pictures are f32")]
                let inverse_depth = warp.inverse_depth.dot(&pixel) as f32;
                let at = y * self.width + x;
                if inverse_depth > self.inverse_depth[at] {
                    let chart = warp.canvas_from_image * pixel;
                    self.grey[at] = canvas.sample(chart.x / chart.z, chart.y / chart.z);
                    self.inverse_depth[at] = inverse_depth;
                }
            }
        }
    }
}

/// The corners in the image if the triangle looks at the camera.
fn project(camera: &Camera, pose: &Pose, facet: &Facet) -> Option<[Point2<f64>; 3]> {
    let mut corners = [Point2::origin(); 3];
    for (corner, x) in corners.iter_mut().zip(&facet.corners) {
        *corner = camera.project(&pose.transform_point(x))?;
    }
    // Counter-clockwise from outside is negative with v down; turned round here.
    corners.swap(1, 2);
    (double_area(&corners) > 1e-6).then_some(corners)
}

/// From the image to the chart of a triangle.
struct ChartWarp {
    level: usize,
    canvas_from_image: Matrix3<f64>,
    /// 1 / depth = this times (u, v, 1).
    inverse_depth: Vector3<f64>,
}

impl ChartWarp {
    fn new(
        atlas: &Atlas,
        facet: &Facet,
        corners: &[Point2<f64>; 3],
        camera: &Camera,
        pose: &Pose,
    ) -> Option<Self> {
        let view_from_image = homography(camera, pose, &facet.object_from_view).try_inverse()?;
        // The chart whose pixels are about as large as the image's.
        let ratio = (2.0 * facet.area / double_area(corners)).sqrt().log2().round();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let level = ratio.clamp(0.0, (atlas.levels() - 1) as f64) as usize;
        let canvas = atlas.canvas(level, facet.view);
        let scale = 0.5_f64.powi(i32::try_from(level).unwrap_or(0));
        let shift = |k: usize| 0.5 * scale - 0.5 - canvas.origin[k];
        let canvas_from_view = Matrix3::new(scale, 0.0, shift(0), 0.0, scale, shift(1), 0.0, 0.0, 1.0);
        let points: [Point3<f64>; 3] = facet.corners.map(|x| pose.transform_point(&x));
        let (normal, offset) = plane(&points)?;
        Some(Self {
            level,
            canvas_from_image: canvas_from_view * view_from_image,
            inverse_depth: camera.inverse_matrix().transpose() * (normal / offset),
        })
    }
}
