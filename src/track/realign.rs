//! Training in more than one pass: the model of the first one says better where the object is in each training image.
//!
//! Poses from annotations are as wrong as the annotations; each image with its own error blurs the mean and bends the
//! shape. Aligned with the mean of all images, they agree to hundredths of a pixel. What they have in common stays: it
//! is the object frame.

use super::Tracker;
use crate::align::{InverseCompositional, Start};
use crate::backend::CpuBackend;
use crate::error::Result;
use crate::geometry::distance::rms_px;
use crate::geometry::{Pose, TriangleMesh};
use crate::model::Model;
use crate::train::{TrainOptions, TrainingImage, train};

/// An image whose vertices move further than this (root mean square) keeps its pose, pixels.
const MAX_MOVE_PX: f64 = 3.0;

/// Aligns images with the model of all of them, `passes` times. Poses in which the object is not found, or far from where
/// it was, stay.
///
/// # Errors
/// As [`train`], and those of [`Tracker::align`].
pub(super) fn realign(mesh: &TriangleMesh, images: &mut [TrainingImage], passes: usize) -> Result<()> {
    for _ in 0..passes {
        align_with(train(mesh, images, &TrainOptions::default())?, mesh, images)?;
    }
    Ok(())
}

fn align_with(model: Model, mesh: &TriangleMesh, images: &mut [TrainingImage]) -> Result<()> {
    let Some(first) = images.first() else { return Ok(()) };
    let aligner = Box::new(InverseCompositional::default());
    let mut tracker = Tracker::new(model, first.camera, Box::new(CpuBackend::new()), aligner)?;
    for image in images {
        tracker.set_camera(image.camera)?;
        let start = Start { camera_from_object: image.camera_from_object, appearance: Vec::new() };
        let found = tracker.align(&image.image, &[start])?.remove(0);
        if !found.score.is_lost() && moved_px(mesh, image, &found.camera_from_object) <= MAX_MOVE_PX {
            image.camera_from_object = found.camera_from_object;
        }
    }
    Ok(())
}

/// Distance between the vertices as seen from the image's pose and from another one, root mean square.
pub(super) fn moved_px(mesh: &TriangleMesh, image: &TrainingImage, other: &Pose) -> f64 {
    rms_px(&image.camera, &mesh.vertices, &image.camera_from_object, other).unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use crate::simulate::{Renderer, View, relief};
    use nalgebra::{Rotation3, Vector3};

    /// Six views, each with its own error of about half a pixel.
    fn views() -> (Vec<Pose>, Vec<TrainingImage>) {
        let camera = Camera::pinhole(400.0, 400.0, 159.5, 119.5, 320, 240);
        let renderer = Renderer::new(relief(1), camera).unwrap();
        let view = |k: u32| {
            let a = f64::from(k) * 2.4;
            let turn = Rotation3::new(Vector3::new(0.3 * a.cos(), 0.3 * a.sin(), 0.1));
            let pose = Pose::new(turn, Vector3::new(0.01, 0.0, 0.6));
            let image = renderer.render_view(&View { pose, ..View::default() });
            let off = Pose::new(
                Rotation3::new(Vector3::new(0.004 * (3.0 * a).sin(), 0.004 * (5.0 * a).cos(), 0.0)),
                Vector3::new(4e-4 * (7.0 * a).sin(), 4e-4 * (2.0 * a).cos(), 0.0),
            );
            (pose, TrainingImage { image, camera, camera_from_object: pose.compose(&off) })
        };
        (0..6).map(view).unzip()
    }

    /// Root mean square of the rotations that the images do not have in common, degrees.
    fn disagreement(truth: &[Pose], images: &[TrainingImage]) -> f64 {
        let off: Vec<Vector3<f64>> = truth
            .iter()
            .zip(images)
            .map(|(t, i)| t.inverse().compose(&i.camera_from_object).rotation_vector())
            .collect();
        let mean = off.iter().sum::<Vector3<f64>>() / off.len() as f64;
        (off.iter().map(|o| (o - mean).norm_squared()).sum::<f64>() / off.len() as f64).sqrt().to_degrees()
    }

    #[test]
    fn images_come_to_agree() {
        let (truth, mut images) = views();
        let mesh = relief(1).mesh;
        let before = disagreement(&truth, &images);
        realign(&mesh, &mut images, 2).unwrap();
        let after = disagreement(&truth, &images);
        assert!(before > 0.15 && after < before / 3.0, "{before} to {after} degrees");
    }

    #[test]
    fn passes_are_counted_and_what_is_not_found_stays() {
        let (truth, mut images) = views();
        let mesh = relief(1).mesh;
        let mut none = images.clone();
        realign(&mesh, &mut none, 0).unwrap();
        let stays = |(a, b): (&TrainingImage, &TrainingImage)| a.camera_from_object == b.camera_from_object;
        assert!(none.iter().zip(&images).all(stays), "no pass");
        let grey = image::GrayImage::from_pixel(320, 240, image::Luma([90]));
        images.truncate(2);
        let model = train(&mesh, &images, &TrainOptions::default()).unwrap();
        images[1].image = grey;
        let before = images[1].camera_from_object;
        align_with(model, &mesh, &mut images).unwrap();
        assert_eq!(images[1].camera_from_object, before, "nothing to see");
        assert!(truth.len() == 6 && realign(&mesh, &mut [], 1).is_err(), "no image");
    }
}
