//! Points of a rendered pose with their normalised gradient: what is compared with the image.

use nalgebra::Point3;

use super::render::Rendering;
use crate::geometry::{Camera, Pose};
use crate::imaging::normalised::normalise;

/// A point of the object as it should look at a pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct SurfacePoint {
    /// Position on the object, metres.
    pub(super) position: [f32; 3],
    /// Normalised gradient t.
    pub(super) value: [f32; 2],
    /// `dt_u/du, dt_u/dv, dt_v/du, dt_v/dv`, per pixel; NaN where unknown.
    pub(super) slope: [f32; 4],
    /// Pixel of the rendering.
    pub(super) pixel: [i32; 2],
    /// Size of the gradient, grey levels per pixel.
    pub(super) strength: f32,
}

/// Gradient of every pixel that has its neighbours, else NaN: the borders of the picture are not edges of the object.
fn gradients(picture: &Rendering) -> Vec<[f32; 2]> {
    let (w, h) = (picture.width, picture.height);
    let mut out = vec![[f32::NAN; 2]; w * h];
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let at = y * w + x;
            let g = &picture.grey;
            if !g[at].is_nan() {
                let [u, v] = [(g[at + 1] - g[at - 1]) / 2.0, (g[at + w] - g[at - w]) / 2.0];
                out[at] = if u.is_nan() || v.is_nan() { [f32::NAN; 2] } else { [u, v] };
            }
        }
    }
    out
}

/// All points of a rendered pose.
pub(super) fn surface_points(picture: &Rendering, camera: &Camera, pose: &Pose) -> Vec<SurfacePoint> {
    let (w, h) = (picture.width, picture.height);
    let gradient = gradients(picture);
    let value: Vec<[f32; 2]> = gradient.iter().map(|g| normalise(*g)).collect();
    let object_from_camera = pose.inverse();
    let mut points = Vec::new();
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let at = y * w + x;
            let [gu, gv] = gradient[at];
            if gu.is_nan() || gv.is_nan() {
                continue;
            }
            let slope = |k: usize, step: usize| (value[at + step][k] - value[at - step][k]) / 2.0;
            let pixel = [
                i32::try_from(x).unwrap_or(0) + picture.origin[0],
                i32::try_from(y).unwrap_or(0) + picture.origin[1],
            ];
            let depth = 1.0 / f64::from(picture.inverse_depth[at]);
            let ray = [
                (f64::from(pixel[0]) - camera.cx) / camera.fx,
                (f64::from(pixel[1]) - camera.cy) / camera.fy,
            ];
            let position =
                object_from_camera.transform_point(&Point3::new(ray[0] * depth, ray[1] * depth, depth));
            #[expect(clippy::cast_possible_truncation, reason = "points are f32")]
            let position = [position.x as f32, position.y as f32, position.z as f32];
            points.push(SurfacePoint {
                position,
                value: value[at],
                slope: [slope(0, 1), slope(0, w), slope(1, 1), slope(1, w)],
                pixel,
                strength: gu.hypot(gv),
            });
        }
    }
    points
}

/// Every n-th point, so that at most about `most` are left; also n.
pub(super) fn thinned(points: Vec<SurfacePoint>, most: usize) -> (Vec<SurfacePoint>, f32) {
    let step = points.len().div_ceil(most.max(1)).max(1);
    #[expect(clippy::cast_precision_loss, reason = "a small number")]
    let share = step as f32;
    (points.into_iter().step_by(step).collect(), share)
}

/// The strongest points, spread over the picture: at most `most`, not nearer to each other than `apart` pixels as long
/// as there are such.
pub(super) fn strongest(mut points: Vec<SurfacePoint>, most: usize, apart: i32) -> Vec<SurfacePoint> {
    points.sort_by(|a, b| b.strength.total_cmp(&a.strength).then(a.pixel.cmp(&b.pixel)));
    let mut chosen: Vec<SurfacePoint> = Vec::with_capacity(most);
    for p in points {
        if chosen.len() == most {
            break;
        }
        let far = |q: &SurfacePoint| (0..2).any(|k| (p.pixel[k] - q.pixel[k]).abs() >= apart);
        if chosen.iter().all(far) {
            chosen.push(p);
        }
    }
    chosen
}
