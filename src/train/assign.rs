//! Which image sees which triangle, how well, and which one becomes its reference view.

use crate::error::{Error, Result};
use crate::geometry::raster::{facing, visible_shares};
use crate::model::{Shape, View};

/// Triangles seen more obliquely than this cosine give no chart.
const MIN_COSINE: f64 = 0.2;
/// A triangle must be free of occlusion by the object itself up to this share.
const MIN_VISIBLE: f64 = 0.98;
/// A triangle must lie this far inside the image, pixels.
const IMAGE_MARGIN_PX: f64 = 3.0;
/// A triangle accepts a view that is this good compared to its best one, so that few views serve many triangles and
/// charts have few seams.
const VIEW_TOLERANCE: f64 = 0.85;

/// How well every image sees every triangle.
#[derive(Debug)]
pub(super) struct Sight {
    /// `quality[image][triangle]`: cos(angle) * f / distance, the resolution (pixels per metre) in the worst
    /// direction; 0 where the triangle is hidden, oblique, or not wholly in the image.
    quality: Vec<Vec<f64>>,
}

impl Sight {
    pub(super) fn new(shape: &Shape, views: &[View]) -> Self {
        Self { quality: views.iter().map(|view| qualities(shape, view)).collect() }
    }

    pub(super) fn quality(&self, image: usize, triangle: usize) -> f64 {
        self.quality[image][triangle]
    }

    fn best(&self, triangle: usize) -> f64 {
        self.quality.iter().map(|q| q[triangle]).fold(0.0, f64::max)
    }
}

pub(super) fn qualities(shape: &Shape, view: &View) -> Vec<f64> {
    // Half resolution is enough to tell hidden from visible.
    let shares = visible_shares(&shape.mesh, &view.camera.at_level(1), &view.camera_from_object);
    let quality = |(triangle, share): (usize, f64)| {
        let points = shape.mesh.corners(triangle);
        let in_view = points.map(|x| view.camera_from_object.transform_point(&x));
        let inside = |x| view.camera.project(x).is_some_and(|p| view.camera.contains(&p, IMAGE_MARGIN_PX));
        let cosine = facing(&points, &view.camera_from_object);
        if share < MIN_VISIBLE || cosine < MIN_COSINE || !in_view.iter().all(inside) {
            return 0.0;
        }
        let distance = (in_view[0].coords + in_view[1].coords + in_view[2].coords).norm() / 3.0;
        cosine * view.camera.fx / distance
    };
    shares.into_iter().enumerate().map(quality).collect()
}

/// Chooses a reference view per triangle: repeatedly the image that is good enough for the largest area still
/// without a view. `None` for triangles that no image sees well.
pub(super) fn choose_views(shape: &Shape, sight: &Sight) -> Result<Vec<Option<u32>>> {
    let chosen = choose_views_where(shape, sight, |_, _| true);
    if chosen.iter().all(Option::is_none) {
        let problem = "no triangle of the mesh is visible in any of the images";
        let remedy = "check poses, units (mesh in millimetres) and that the mesh's normals point outwards";
        return Err(Error::invalid("training", problem, remedy));
    }
    Ok(chosen)
}

/// As [`choose_views`], for the triangles whose best quality is wanted: `wanted(triangle, quality)`.
pub(super) fn choose_views_where(
    shape: &Shape,
    sight: &Sight,
    wanted: impl Fn(usize, f64) -> bool,
) -> Vec<Option<u32>> {
    let n = shape.triangles();
    let area: Vec<f64> = (0..n).map(|t| shape.mesh.normal(t).norm()).collect();
    let best: Vec<f64> =
        (0..n).map(|t| Some(sight.best(t)).filter(|q| wanted(t, *q)).unwrap_or(0.0)).collect();
    let mut chosen = vec![None; n];
    loop {
        let serves = |v: usize, t: usize| {
            best[t] > 0.0 && chosen[t].is_none() && sight.quality(v, t) >= VIEW_TOLERANCE * best[t]
        };
        // Area times quality, so that of two images that serve the same triangles the better one wins.
        let gain =
            |v: usize| (0..n).filter(|&t| serves(v, t)).map(|t| area[t] * sight.quality(v, t)).sum::<f64>();
        let gains: Vec<f64> = (0..sight.quality.len()).map(gain).collect();
        let view = (0..gains.len()).fold(0, |b, v| if gains[v] > gains[b] { v } else { b });
        if gains[view] <= 0.0 {
            break;
        }
        let taken: Vec<usize> = (0..n).filter(|&t| serves(view, t)).collect();
        let number = u32::try_from(view).expect("fewer than 2^32 images");
        taken.into_iter().for_each(|t| chosen[t] = Some(number));
    }
    chosen
}
