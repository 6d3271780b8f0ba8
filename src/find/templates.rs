//! The templates: every pose of the grid rendered at the scanned size, and its strongest points.

use nalgebra::Point3;
use rayon::prelude::*;

use super::FindOptions;
use super::atlas::Atlas;
use super::points::{SurfacePoint, strongest, surface_points};
use super::render::Rendering;
use crate::backend::{ScanPoint, ScanTemplates};
use crate::geometry::{Camera, Pose};
use crate::model::Model;

/// A template has a point for so many of its pixels, up to the limit of the options.
const PIXELS_PER_POINT: usize = 3;
/// Smaller renderings say too little.
const LEAST_PIXELS: usize = 48;

/// Templates and the poses they show, with the object's centre on the optical axis.
#[derive(Debug)]
pub(super) struct Templates {
    pub(super) scan: ScanTemplates,
    pub(super) poses: Vec<Pose>,
    /// Centre of the object in its own frame, metres.
    pub(super) centre: Point3<f64>,
    /// Where the object's points lie about the anchor, pixels of the scanned image: the largest distance.
    pub(super) radius: Vec<f64>,
}

impl Templates {
    pub(super) fn render(model: &Model, atlas: &Atlas, camera: &Camera, options: &FindOptions) -> Self {
        // The anchor is a whole pixel: the object's centre is drawn there.
        let centred = Camera { cx: camera.cx.round(), cy: camera.cy.round(), ..*camera };
        let poses = super::grid::poses(model, atlas, camera, options);
        let rendered: Vec<Option<Vec<ScanPoint>>> = poses
            .par_iter()
            .map_init(Rendering::default, |picture, pose| {
                picture.render(atlas, &centred, pose);
                template(&surface_points(picture, &centred, pose), &centred, options.points)
            })
            .collect();
        let mut templates = Self::of(model);
        let anchor = nalgebra::Point2::new(centred.cx, centred.cy);
        for (pose, points) in poses.iter().zip(rendered) {
            let Some(points) = points else { continue };
            let distance = |x: &Point3<f64>| {
                centred.project(&pose.transform_point(x)).map_or(0.0, |p| (p - anchor).norm())
            };
            let radius = model.shape.mesh.vertices.iter().map(distance).fold(0.0, f64::max);
            templates.push(*pose, &points, radius);
        }
        templates
    }

    /// None yet.
    pub(super) fn of(model: &Model) -> Self {
        Self {
            scan: ScanTemplates::default(),
            poses: Vec::new(),
            centre: model.shape.centre,
            radius: Vec::new(),
        }
    }

    pub(super) fn push(&mut self, pose: Pose, points: &[ScanPoint], radius: f64) {
        self.scan.push(points);
        self.poses.push(pose);
        self.radius.push(radius);
    }
}

/// The points of a template; `None` if it shows too little.
fn template(points: &[SurfacePoint], camera: &Camera, most: usize) -> Option<Vec<ScanPoint>> {
    if points.len() < LEAST_PIXELS {
        return None;
    }
    let count = (points.len() / PIXELS_PER_POINT).clamp(LEAST_PIXELS.min(most), most);
    // So far apart that they fill the picture.
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "a few pixels")]
    let apart = ((points.len() as f64 / count as f64 / 1.5).sqrt() as i32).max(1);
    let offset = |x: i32, anchor: f64| {
        #[expect(clippy::cast_possible_truncation, reason = "pictures are a few hundred pixels wide")]
        let offset = (f64::from(x) - anchor) as i16;
        offset
    };
    let scan_point = |p: SurfacePoint| ScanPoint {
        offset: [offset(p.pixel[0], camera.cx), offset(p.pixel[1], camera.cy)],
        value: p.value,
    };
    Some(strongest(points.to_vec(), count, apart).into_iter().map(scan_point).collect())
}
