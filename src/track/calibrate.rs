//! What a score is worth: the margins of poses that are known to be right or wrong, in the training images and in
//! corrupted copies of them.

use image::{GrayImage, Luma, imageops};
use nalgebra::Vector6;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::align::{Aligner, InverseCompositional, Start, Target};
use crate::backend::{Backend, CpuBackend};
use crate::error::Result;
use crate::geometry::Pose;
use crate::geometry::distance::rms_px;
use crate::model::{Calibration, Model};
use crate::train::TrainingImage;

/// Images that are looked at, at most.
const IMAGES: usize = 6;
/// Starts are this far from the pose of the image, pixels (rms over the corners).
const STARTS_PX: [f64; 4] = [3.0, 20.0, 40.0, 80.0];
/// A pose nearer than this to that of the training image is right,
const RIGHT_PX: f64 = 2.5;
/// one farther away is wrong; what is between them is neither.
const WRONG_PX: f64 = 8.0;
/// Blocks of an image are shuffled to have one of the same kind without the object, pixels.
const BLOCK_PX: u32 = 24;
/// Standard deviation of the noise of a bad image, grey levels, and of its blur, pixels.
const NOISE: f64 = 8.0;
const BLUR_PX: f32 = 1.5;
const SEED: u64 = 1;

/// Calibrates a model with the images it was trained on: each as it is, dark, noisy, blurred, half covered, and without
/// the object; from starts near and far. The same images give the same calibration.
///
/// # Errors
/// [`crate::Error::Invalid`] for images that do not fit their camera, and those of the backend.
pub fn calibrate(model: &mut Model, images: &[TrainingImage]) -> Result<()> {
    let mut backend = CpuBackend::new();
    let id = backend.load(model)?;
    let mut aligner = InverseCompositional::default();
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let (mut samples, mut estimates) = (Vec::new(), Vec::new());
    for image in images.iter().step_by(images.len().div_ceil(IMAGES).max(1)) {
        for (copy, has_object) in copies(model, image, &mut rng) {
            let starts = starts(model, image, &mut rng);
            backend.set_frame(&copy, aligner.levels(model))?;
            let target = Target { model, id, camera: image.camera, image: &copy };
            aligner.align(&mut backend, &target, &starts, &mut estimates)?;
            for estimate in &estimates {
                let px = moved_px(model, image, &estimate.camera_from_object);
                let right = has_object && px < RIGHT_PX;
                if right || !has_object || px > WRONG_PX {
                    samples.push((estimate.score.margin(), right));
                }
            }
        }
    }
    model.calibration = Calibration::fit(&samples);
    let right = samples.iter().filter(|s| s.1).count();
    tracing::debug!("calibrated with {right} right of {} poses: {:?}", samples.len(), model.calibration);
    Ok(())
}

/// The image as it may look on another day, and whether the object is in it.
fn copies(model: &Model, image: &TrainingImage, rng: &mut ChaCha8Rng) -> Vec<(GrayImage, bool)> {
    let plain = &image.image;
    let without = shuffled(plain, rng);
    let changed = |change: &mut dyn FnMut(f64) -> f64| {
        let mut copy = plain.clone();
        copy.pixels_mut().for_each(|p| p[0] = grey(change(f64::from(p[0]))));
        copy
    };
    let dark = changed(&mut |value| 0.5 * value + 5.0);
    // A sum of four uniform numbers has a variance of a third.
    let mut noise = || (0..4).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>() * 3f64.sqrt() * NOISE;
    let noisy = changed(&mut |value| value + noise());
    let mut covered = plain.clone();
    let half = half_of_object(model, image);
    for (u, v, pixel) in covered.enumerate_pixels_mut().filter(|(u, v, _)| half(*u, *v)) {
        *pixel = *without.get_pixel(u, v);
    }
    vec![
        (plain.clone(), true),
        (dark, true),
        (noisy, true),
        (imageops::blur(plain, BLUR_PX), true),
        (covered, true),
        (without, false),
    ]
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the range of u8")]
fn grey(value: f64) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// The blocks of an image in another order.
fn shuffled(image: &GrayImage, rng: &mut ChaCha8Rng) -> GrayImage {
    let (columns, rows) = (image.width() / BLOCK_PX, image.height() / BLOCK_PX);
    let places: Vec<[u32; 2]> = (0..rows).flat_map(|j| (0..columns).map(move |i| [i, j])).collect();
    let mut order = places.clone();
    order.shuffle(rng);
    let mut out = image.clone();
    for ([i, j], [from_i, from_j]) in places.into_iter().zip(order) {
        for (u, v) in (0..BLOCK_PX).flat_map(|u| (0..BLOCK_PX).map(move |v| (u, v))) {
            let Luma(value) = *image.get_pixel(from_i * BLOCK_PX + u, from_j * BLOCK_PX + v);
            out.put_pixel(i * BLOCK_PX + u, j * BLOCK_PX + v, Luma(value));
        }
    }
    out
}

/// The half of the image left of the object's centre.
fn half_of_object(model: &Model, image: &TrainingImage) -> impl Fn(u32, u32) -> bool + use<> {
    let centre = image.camera.project(&image.camera_from_object.transform_point(&model.shape.centre));
    let u = centre.map_or(0.0, |c| c.x);
    move |x, _| f64::from(x) < u
}

/// Random motions that move the corners by given distances.
fn starts(model: &Model, image: &TrainingImage, rng: &mut ChaCha8Rng) -> Vec<Start> {
    let size = (model.shape.corners[7] - model.shape.corners[0]).norm();
    let mut start = |px: f64| {
        let d = Vector6::from_fn(|k, _| rng.random_range(-1.0..1.0) * if k < 3 { 0.5 * size } else { 1.0 });
        let at = |scale: f64| {
            image.camera_from_object.compose(&Pose::increment(&(d * scale), &model.shape.centre))
        };
        // To first order the distance is proportional to the motion.
        let small = 1e-3;
        let scale = small * px / moved_px(model, image, &at(small)).max(f64::MIN_POSITIVE);
        Start { camera_from_object: at(scale), appearance: vec![0.0; model.modes()] }
    };
    STARTS_PX.map(&mut start).into_iter().filter(|s| s.camera_from_object.is_finite()).collect()
}

/// Distance of the corners from where they are in a training image, root mean square.
fn moved_px(model: &Model, image: &TrainingImage, pose: &Pose) -> f64 {
    let corners = &model.shape.corners;
    rms_px(&image.camera, corners, &image.camera_from_object, pose).unwrap_or(f64::INFINITY)
}
