//! The poses that are tried: directions of view, rolls and distances, spaced so that the object moves by about the same
//! number of pixels from one to the next.

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

use super::FindOptions;
use super::atlas::Atlas;
use crate::geometry::{Camera, Pose};
use crate::model::{Model, View};

/// Triangles count as seen well from this cosine on.
const GOOD_COSINE: f64 = 0.42;
/// At least this share of what a direction shows must be charted and seen well.
const LEAST_SHARE: f64 = 0.5;
/// Directions are at most this far (cosine of 25 degrees) from that of a reference view.
const NEAR_VIEW: f64 = 0.906;
/// Directions per steradian and rolls per turn for an object whose points are this far (rms, full-size pixels) from its
/// centre.
const REFERENCE_PX: f64 = 114.0;
const DIRECTIONS_PER_STERADIAN: f64 = 11.5;
const ROLLS: f64 = 24.0;
/// The density follows the size of the object in the image within these factors.
const DENSITY: [f64; 2] = [0.7, 1.5];
/// Range of distances of the default grid, in units of the (geometric) mean distance of the reference views.
const DISTANCES: [f64; 2] = [0.58, 1.75];

/// Distances (nearest, farthest) the grid covers if nothing is said, metres.
pub(super) fn default_distances(model: &Model) -> (f64, f64) {
    let depth = |v: &View| v.camera_from_object.transform_point(&model.shape.centre).coords.norm();
    let logs: Vec<f64> = model.views.iter().map(|v| depth(v).ln()).collect();
    let mean = (logs.iter().sum::<f64>() / logs.len().max(1) as f64).exp();
    (DISTANCES[0] * mean, DISTANCES[1] * mean)
}

/// Root mean square distance of the model's vertices from its centre, metres.
pub(super) fn extent(model: &Model) -> f64 {
    let points = &model.shape.mesh.vertices;
    let sum: f64 = points.iter().map(|p| (p - model.shape.centre).norm_squared()).sum();
    (sum / points.len().max(1) as f64).sqrt()
}

/// Poses with the object's centre on the optical axis.
pub(super) fn poses(model: &Model, atlas: &Atlas, camera: &Camera, options: &FindOptions) -> Vec<Pose> {
    let (near, far) = options.distance.unwrap_or_else(|| default_distances(model));
    let focal = (camera.fx * camera.fy).sqrt();
    let mut all = Vec::new();
    let steps = ((far / near).ln() / options.distance_ratio.ln()).round().max(0.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small number")]
    for k in 0..=steps as usize {
        let share = if steps > 0.0 { k as f64 / steps } else { 0.5 };
        let distance = near * (far / near).powf(share);
        let density = (focal * extent(model) / distance / REFERENCE_PX).clamp(DENSITY[0], DENSITY[1]);
        let density = density * options.density;
        let count = (4.0 * std::f64::consts::PI * DIRECTIONS_PER_STERADIAN * density).round() as usize;
        let rolls = (ROLLS * density).round().max(1.0) as usize;
        for (i, direction) in sphere(count).enumerate().filter(|(_, d)| is_charted(atlas, model, d)) {
            // Rolls are shifted from view to view, so that neighbours complement each other.
            let phase = (i as f64 * 0.618_034 + k as f64 * 0.382).fract();
            for j in 0..rolls {
                let roll = (j as f64 + phase) / rolls as f64 * std::f64::consts::TAU;
                all.push(looking(&direction, roll, distance, &model.shape.centre));
            }
        }
    }
    all
}

/// Poses of so many directions of view per steradian at one distance, without roll.
pub(super) fn views(model: &Model, atlas: &Atlas, per_steradian: f64, distance: f64) -> Vec<Pose> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small number")]
    let count = (4.0 * std::f64::consts::PI * per_steradian).round() as usize;
    let charted = sphere(count).filter(|d| is_charted(atlas, model, d));
    charted.map(|d| looking(&d, 0.0, distance, &model.shape.centre)).collect()
}

/// Points of a Fibonacci spiral on the unit sphere.
fn sphere(count: usize) -> impl Iterator<Item = Vector3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count).map(move |i| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
        let r = (1.0 - z * z).sqrt();
        let angle = golden * i as f64;
        Vector3::new(r * angle.cos(), r * angle.sin(), z)
    })
}

/// Does the model know what is seen from there?
fn is_charted(atlas: &Atlas, model: &Model, direction: &Vector3<f64>) -> bool {
    let projected = |corners: &[Point3<f64>; 3]| {
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        (normal.dot(direction), normal.norm())
    };
    let seen_from = |view: &View| {
        let camera = view.camera_from_object.inverse().translation();
        (camera - model.shape.centre.coords).normalize().dot(direction)
    };
    if !model.views.iter().any(|view| seen_from(view) >= NEAR_VIEW) {
        return false;
    }
    let mesh = &model.shape.mesh;
    let all: f64 = (0..mesh.triangles.len()).map(|t| projected(&mesh.corners(t)).0.max(0.0)).sum();
    let good = |corners: &[Point3<f64>; 3]| {
        let (area, size) = projected(corners);
        if area >= GOOD_COSINE * size { area } else { 0.0 }
    };
    let good: f64 = atlas.facets.iter().map(|f| good(&f.corners)).sum();
    good > LEAST_SHARE * all
}

/// The pose in which the camera looks at `centre` against `direction` (object frame, from the object to the camera).
fn looking(direction: &Vector3<f64>, roll: f64, distance: f64, centre: &Point3<f64>) -> Pose {
    let z = -direction;
    let aside = if z.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let y = z.cross(&aside).normalize();
    let x = y.cross(&z);
    let rows = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
    let rotation =
        Rotation3::from_axis_angle(&Vector3::z_axis(), roll) * Rotation3::from_matrix_unchecked(rows);
    Pose::new(rotation, Vector3::new(0.0, 0.0, distance) - rotation * centre.coords)
}

/// The pose seen at a pixel instead of the optical axis: turned with the line of sight, and as much farther along it as
/// keeps its size in the image.
pub(super) fn moved_to(camera: &Camera, pose: &Pose, centre: &Point3<f64>, u: f64, v: f64) -> Pose {
    let ray = Vector3::new((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0);
    let turn = Rotation3::rotation_between(&Vector3::z(), &ray).unwrap_or_default();
    let depth = pose.transform_point(centre).z;
    // Off the axis the image is magnified by 1/cos^2 along the radius and 1/cos across.
    let distance = depth * ray.norm().powf(1.5);
    let rotation = turn * Rotation3::from_matrix_unchecked(pose.rotation());
    Pose::new(rotation, ray.normalize() * distance - rotation * centre.coords)
}
