//! Keypoints of the object itself: found in pictures of it from all sides that the model knows.

use nalgebra::Point3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::FindOptions;
use super::atlas::Atlas;
use super::grid;
use super::render::{MAX_SIDE, Rendering};
use crate::geometry::{Camera, Pose};
use crate::imaging::keypoints::{DESCRIPTION, Keypoint, keypoints};
use crate::model::Model;

/// Pictures are taken from so many directions per steradian: 23 degrees from one to the next.
const DIRECTIONS: f64 = 6.0;
/// The object fills this share of the largest picture at most.
const FILLED: f64 = 0.9;
/// Grey level around the object.
const AROUND: f32 = 128.0;
/// Keypoints are at least so many of their blurs inside the object's outline.
const INSIDE: f64 = 1.5;

/// A keypoint on the object.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Landmark {
    /// Position on the object, metres.
    pub(super) position: [f64; 3],
    /// The picture it was found in.
    pub(super) view: u32,
    /// Blur and direction in that picture.
    pub(super) scale: f64,
    pub(super) angle: f64,
}

/// All of them, with the poses of the pictures.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Landmarks {
    pub(super) views: Vec<Pose>,
    pub(super) landmarks: Vec<Landmark>,
    /// One description after the other.
    descriptions: Vec<i16>,
}

impl Landmarks {
    /// `camera` is that of the full image.
    pub(super) fn render(model: &Model, atlas: &Atlas, camera: &Camera, options: &FindOptions) -> Self {
        let (near, far) = options.distance.unwrap_or_else(|| grid::default_distances(model));
        let farthest = |x: &Point3<f64>| (x - model.shape.centre).norm();
        let radius = model.shape.mesh.vertices.iter().map(farthest).fold(0.0, f64::max);
        let fitting = 2.0 * radius * camera.fx.max(camera.fy) / (FILLED * MAX_SIDE) + radius;
        let distance = (near * far).sqrt().max(fitting);
        let views = grid::views(model, atlas, DIRECTIONS, distance);
        let found: Vec<Vec<(Landmark, Keypoint)>> = (0_u32..)
            .zip(&views)
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|(view, pose)| {
                let mut picture = Rendering::default();
                picture.render(atlas, camera, pose);
                let grey: Vec<f32> =
                    picture.grey.iter().map(|g| if g.is_nan() { AROUND } else { *g }).collect();
                let all = if grey.is_empty() { Vec::new() } else { keypoints(&grey, picture.width) };
                let placed = all.into_iter().filter_map(|k| {
                    let position = position(&picture, camera, pose, &k)?;
                    Some((Landmark { position, view, scale: k.scale, angle: k.angle }, k))
                });
                placed.collect()
            })
            .collect();
        let mut all = Self { views, ..Self::default() };
        for (landmark, keypoint) in found.into_iter().flatten() {
            all.landmarks.push(landmark);
            all.descriptions.extend(keypoint.description);
        }
        all
    }

    /// Landmarks and their descriptions.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&Landmark, &[i16])> {
        self.landmarks.iter().zip(self.descriptions.chunks_exact(DESCRIPTION))
    }
}

/// Where a keypoint of a picture is on the object; `None` near the outline.
fn position(picture: &Rendering, camera: &Camera, pose: &Pose, k: &Keypoint) -> Option<[f64; 3]> {
    let inverse_depth = |u: f64, v: f64| {
        let (u, v) = (u.round(), v.round());
        if !(u >= 0.0 && v >= 0.0 && u < picture.width as f64 && v < picture.height as f64) {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside, checked above")]
        let at = v as usize * picture.width + u as usize;
        (!picture.grey[at].is_nan()).then(|| f64::from(picture.inverse_depth[at]))
    };
    let ([u, v], away) = (k.position, INSIDE * k.scale);
    for (du, dv) in [(-away, 0.0), (away, 0.0), (0.0, -away), (0.0, away)] {
        inverse_depth(u + du, v + dv)?;
    }
    let depth = 1.0 / inverse_depth(u, v)?;
    let (u, v) = (u + f64::from(picture.origin[0]), v + f64::from(picture.origin[1]));
    let seen = Point3::new((u - camera.cx) / camera.fx * depth, (v - camera.cy) / camera.fy * depth, depth);
    let x = pose.inverse().transform_point(&seen);
    Some([x.x, x.y, x.z])
}
