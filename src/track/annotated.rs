//! Annotated training in all its steps: poses and landmarks from the annotations, poses from the images, landmarks from
//! the images.
//!
//! A person clicks to a third of a pixel; the training images themselves show every landmark to a few hundredths. A model
//! is trained, each image says how far every landmark is from where the model has it, and poses and landmarks are
//! adjusted to that; then the triangles between them are looked at again. What no image can tell, position, orientation and scale of the object frame, stays with the
//! triangulated landmarks.

use super::pair::StereoPair;
use super::realign::{moved_px, realign};
use super::survey::Survey;
use super::triangulation::improve;
use crate::dataset::Landmark;
use crate::error::Result;
use crate::geometry::bundle::{self, Mark, Prior, Sighting};
use crate::geometry::pnp::PnpSolution;
use crate::geometry::{Pose, TriangleMesh};
use crate::train::TrainingImage;
use crate::train::annotated::{AnnotatedImage, AnnotationOptions, Posed, Refinement, pose, priors};

/// How often images are aligned with the model of all of them; the third time changes little.
const REALIGNMENTS: usize = 2;
/// How often landmarks are measured in the images.
const MEASUREMENTS: usize = 3;

/// Annotated images ready for [`crate::train::train`].
#[derive(Debug, Clone)]
pub struct Prepared {
    /// The landmarks' mesh.
    pub mesh: TriangleMesh,
    /// The images with their poses.
    pub images: Vec<TrainingImage>,
    /// How well the annotations fit, per image.
    pub fits: Vec<PnpSolution>,
    /// How far the vertices moved in each image after the annotations were fitted, root mean square, pixels.
    pub moved_px: Vec<f64>,
    /// What became of the landmarks, if they were refined.
    pub refinement: Option<Refinement>,
    /// Triangles with another diagonal than Delaunay's, and those left out.
    pub triangles_changed: usize,
}

/// Poses of annotated images and the mesh of their landmarks (object frame), refined unless `options` say otherwise. With
/// the stereo pair in which the landmarks were clicked its images say how large they are, else the landmarks' covariance.
///
/// # Errors
/// Those of [`pose`], [`crate::train::train`], [`super::Tracker::align`] and [`bundle::refine`].
pub fn prepare(
    landmarks: &[Landmark],
    pair: Option<&StereoPair>,
    images: Vec<AnnotatedImage>,
    options: &AnnotationOptions,
) -> Result<Prepared> {
    let annotations: Vec<Vec<Mark>> = images.iter().map(|i| i.rectified_marks(options.sigma_px)).collect();
    let posed = pose(landmarks, images, options)?;
    let Posed { mut images, fits, mut refinement, mesh: first_mesh, reference } = posed;
    let first_poses: Vec<Pose> = images.iter().map(|i| i.camera_from_object).collect();
    let mut mesh = first_mesh.clone();
    let mut triangles_changed = 0;
    if options.refine {
        realign(&mesh, &mut images, REALIGNMENTS)?;
    }
    if let Some(refinement) = &mut refinement {
        let known = priors(landmarks);
        let mut points = Vec::new();
        for _ in 0..MEASUREMENTS {
            // First: landmarks of wrong triangles would be pulled to where these fit best.
            triangles_changed += improve(&mut mesh, &images, reference)?;
            let mut survey = Survey::new(&mesh, &images, true)?;
            let priors = pair.map_or_else(|| Ok(known.clone()), |pair| pair.landmarks(&mut survey))?;
            points = adjust(&mut survey, &priors, &annotations, &mut images)?;
            mesh.vertices.iter_mut().zip(&points).for_each(|(vertex, point)| *vertex = point.position);
        }
        *refinement = Refinement::between(&known, &points);
    }
    let moved = |(image, first): (&TrainingImage, &Pose)| moved_px(&first_mesh, image, first);
    let moved_px = images.iter().zip(&first_poses).map(moved).collect();
    Ok(Prepared { mesh, images, fits, moved_px, refinement, triangles_changed })
}

/// Landmarks measured in all images, then landmarks and poses adjusted to that; returns the landmarks.
fn adjust(
    survey: &mut Survey,
    priors: &[Prior],
    annotations: &[Vec<Mark>],
    images: &mut [TrainingImage],
) -> Result<Vec<Prior>> {
    let sighting = |(image, annotations): (&TrainingImage, &Vec<Mark>)| {
        let TrainingImage { camera, camera_from_object, .. } = *image;
        let marks = survey.marks((&image.image, &camera), &camera_from_object, annotations)?;
        Ok(Sighting { camera, camera_from_object, marks })
    };
    let sightings: Result<Vec<Sighting>> = images.iter().zip(annotations).map(sighting).collect();
    let adjusted = bundle::refine(priors, &sightings?)?;
    for (image, pose) in images.iter_mut().zip(adjusted.poses) {
        image.camera_from_object = pose;
    }
    Ok(adjusted.points)
}
