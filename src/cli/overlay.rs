//! Pictures of the estimated pose: the object's outline and axes over the frame.

use std::path::Path;

use image::{GrayImage, ImageEncoder};
use nalgebra::{Point3, Vector3};
use tiny_skia::{Color, Paint, PathBuilder, Pixmap, Stroke, Transform};

use crate::dataset::write_atomically;
use crate::error::{Error, Result};
use crate::geometry::raster::visible_shares;
use crate::geometry::{Camera, Pose};
use crate::model::Shape;
use crate::track::Status;

/// Straight lines are drawn in this many pieces, so that lens distortion bends them.
const PIECES: u32 = 12;

/// Draws the visible outline of the shape (green: tracked, yellow: uncertain, red: lost) and its axes (x red, y green, z blue) and
/// writes a PNG.
pub(super) fn write(
    path: &Path,
    image: &GrayImage,
    camera: &Camera,
    pose: &Pose,
    shape: &Shape,
    status: Status,
) -> Result<()> {
    let mut picture = from_gray(image).ok_or_else(|| {
        Error::invalid(path.display().to_string(), "the picture has no size", "give images with pixels")
    })?;
    let colour = match status {
        Status::Tracking => Color::from_rgba8(40, 230, 80, 255),
        Status::Uncertain => Color::from_rgba8(250, 200, 40, 255),
        Status::Lost | Status::Searching => Color::from_rgba8(240, 50, 40, 255),
    };
    let shares = visible_shares(&shape.mesh, camera, pose);
    for (face, border) in shape.faces.borders.iter().enumerate() {
        let triangles = shape.faces.of_triangle.iter().zip(&shares);
        if triangles.into_iter().any(|(f, share)| *f as usize == face && *share > 0.0) {
            for edge in border {
                line(&mut picture, camera, pose, edge, colour, 1.6);
            }
        }
    }
    let length = (shape.corners[7] - shape.corners[0]).norm() / 4.0;
    let axes = [(Vector3::x(), [255, 70, 60]), (Vector3::y(), [60, 200, 60]), (Vector3::z(), [70, 120, 255])];
    for (axis, [r, g, b]) in axes {
        let end = shape.centre + axis * length;
        line(&mut picture, camera, pose, &[shape.centre, end], Color::from_rgba8(r, g, b, 255), 2.2);
    }
    let mut png = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut png);
    encoder
        .write_image(picture.data(), picture.width(), picture.height(), image::ExtendedColorType::Rgba8)
        .map_err(|e| Error::io(path, std::io::Error::other(e)))?;
    write_atomically(path, |out| out.write_all(&png))
}

fn from_gray(image: &GrayImage) -> Option<Pixmap> {
    let mut picture = Pixmap::new(image.width(), image.height())?;
    for (rgba, grey) in picture.data_mut().chunks_exact_mut(4).zip(image.as_raw()) {
        rgba.copy_from_slice(&[*grey, *grey, *grey, 255]);
    }
    Some(picture)
}

fn line(
    picture: &mut Pixmap,
    camera: &Camera,
    pose: &Pose,
    ends: &[Point3<f64>; 2],
    colour: Color,
    width: f32,
) {
    let mut path = PathBuilder::new();
    let along = |k: u32| ends[0] + (ends[1] - ends[0]) * (f64::from(k) / f64::from(PIECES));
    for k in 0..=PIECES {
        let Some(p) = camera.project(&pose.transform_point(&along(k))) else { return };
        // The drawing library puts pixel centres at half integers.
        #[expect(clippy::cast_possible_truncation, reason = "a drawing needs no more than f32")]
        let (x, y) = ((p.x + 0.5) as f32, (p.y + 0.5) as f32);
        if k == 0 { path.move_to(x, y) } else { path.line_to(x, y) }
    }
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color(colour);
    if let Some(path) = path.finish() {
        picture.stroke_path(
            &path,
            &paint,
            &Stroke { width, ..Stroke::default() },
            Transform::identity(),
            None,
        );
    }
}
