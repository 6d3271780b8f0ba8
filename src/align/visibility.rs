//! Which triangles can be seen well enough to say something.

use nalgebra::Matrix2x3;

use super::Target;
use super::derivative::image_from_chart;
use crate::geometry::Pose;
use crate::geometry::raster::{Facet, ZBuffer};
use crate::model::ChartGeometry;

/// Triangles seen more obliquely than this cosine are left out.
const MIN_COSINE: f64 = 0.06;
/// Triangles whose chart the image shows more compressed in one direction than in the other by this factor are left out:
/// their chart keeps its distance from the border of the face in pixels of the chart, which in the image is then less
/// than the width of a pixel that mixes the face with what lies behind.
const MIN_ASPECT: f64 = 0.25;
/// Visibility is judged on an image of this pyramid level.
const VISIBILITY_LEVEL: usize = 2;
/// Triangles with less than this share free of occlusion by the object itself are left out.
const MIN_VISIBLE: f64 = 0.5;

/// Share of every triangle that can be seen: 0 for backs, grazing triangles and those mostly hidden or much
/// compressed.
pub(super) fn visibility(target: &Target<'_>, pose: &Pose) -> Vec<f64> {
    let mut visibility = Vec::new();
    look_at(target, pose, &mut ZBuffer::default(), &mut visibility);
    visibility
}

/// [`visibility`] in the memory of earlier calls.
pub(super) fn look_at(target: &Target<'_>, pose: &Pose, zbuffer: &mut ZBuffer, visibility: &mut Vec<f64>) {
    let mesh = &target.model.shape.mesh;
    zbuffer.visible_shares(mesh, &target.camera.at_level(VISIBILITY_LEVEL), pose, visibility);
    for (share, (t, geometry)) in
        visibility.iter_mut().zip(target.model.levels[0].geometry.iter().enumerate())
    {
        let is_clear = |facet: &Facet| {
            let is_open = geometry.as_ref().is_some_and(|geometry| is_open(facet, geometry));
            *share >= MIN_VISIBLE && facet.cosine >= MIN_COSINE && is_open
        };
        *share = if zbuffer.facet(t).is_some_and(is_clear) { *share } else { 0.0 };
    }
}

/// Does the image show a triangle less compressed than [`MIN_ASPECT`] says, at whatever size?
fn is_open(facet: &Facet, geometry: &ChartGeometry) -> bool {
    let a = image_from_chart(&Matrix2x3::from_columns(&facet.corners.map(|c| c.coords)), geometry);
    // With singular values s1 >= s2: |det A| = s1 s2 and |A|^2 = s1^2 + s2^2, and s1 s2 / (s1^2 + s2^2) grows with s2 / s1.
    let least = MIN_ASPECT / (1.0 + MIN_ASPECT * MIN_ASPECT);
    a.determinant().abs() >= least * a.norm_squared()
}
