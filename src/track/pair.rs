//! The stereo pair in which the landmarks were clicked: it alone knows how large the object is.

use image::GrayImage;

use super::survey::Survey;
use crate::error::Error;
use crate::error::Result;
use crate::geometry::bundle::{Mark, Prior};
use crate::geometry::pnp;
use crate::geometry::stereo::{ClickPair, StereoRig};
use crate::imaging::Rectifier;

/// Both images with the clicks in them.
#[derive(Debug, Clone)]
pub struct StereoPair {
    /// The pair without lens distortion.
    rig: StereoRig,
    /// Rectified images, left and right.
    images: [GrayImage; 2],
    /// Name and clicks in the rectified images of every landmark.
    clicks: Vec<(String, [Mark; 2])>,
}

impl StereoPair {
    /// Images as taken, left and right, and clicks of standard deviation `sigma_px`, one pair per landmark in their order.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an image of another size than its camera, and clicks that a lens model does not cover.
    pub fn new(rig: &StereoRig, images: [GrayImage; 2], clicks: &[ClickPair], sigma_px: f64) -> Result<Self> {
        for (image, camera) in images.iter().zip([&rig.left, &rig.right]) {
            if image.dimensions() != (camera.width, camera.height) {
                let (problem, remedy) =
                    ("an image of another size than its camera", "give the clicked images");
                return Err(Error::invalid("stereo pair", problem, remedy));
            }
        }
        let [left, right] = images;
        let pinhole = StereoRig { left: rig.left.rectified(), right: rig.right.rectified(), ..*rig };
        let marks = |click: &ClickPair| {
            let left = pinhole.left.project(&rig.left.ray(&click.left)?.into())?;
            let right = pinhole.right.project(&rig.right.ray(&click.right)?.into())?;
            Some((click.name.clone(), [left, right].map(|p| Mark::new(p, sigma_px))))
        };
        let rectified = |click| {
            marks(click).ok_or_else(|| {
                let what = format!("landmark {:?}", click.name);
                Error::invalid(
                    what,
                    "a click is outside of what the lens model covers",
                    "click inside the image",
                )
            })
        };
        let clicks: Result<Vec<_>> = clicks.iter().map(rectified).collect();
        let images = [Rectifier::new(&rig.left).rectify(left), Rectifier::new(&rig.right).rectify(right)];
        Ok(Self { rig: pinhole, images, clicks: clicks? })
    }

    /// The landmarks measured in both images and triangulated anew, in the object frame as the survey's model has it.
    pub(super) fn landmarks(&self, survey: &mut Survey) -> Result<Vec<Prior>> {
        let points = survey.model.shape.mesh.vertices.clone();
        let side = |k: usize| -> Vec<Mark> { self.clicks.iter().map(|(_, marks)| marks[k]).collect() };
        let pose = |left: &[Mark]| {
            let pixels: Vec<_> = left.iter().map(|m| m.pixel).collect();
            pnp::solve(&self.rig.left, &points, &pixels).map(|fit| fit.camera_from_object)
        };
        let cameras = [self.rig.left, self.rig.right];
        let first = pose(&side(0))?;
        let left = survey.marks((&self.images[0], &cameras[0]), &first, &side(0))?;
        // What is measured fits the model better than the clicks do.
        let left_from_object = pose(&left)?;
        let right_from_object = self.rig.right_from_left.compose(&left_from_object);
        let right = survey.marks((&self.images[1], &cameras[1]), &right_from_object, &side(1))?;
        let back = left_from_object.inverse();
        let prior = |((name, _), (left, right)): (&(String, _), (&Mark, &Mark))| {
            let point = self.rig.triangulate_marks(name, &[*left, *right])?;
            let turn = back.rotation();
            let covariance = turn * point.covariance * turn.transpose();
            Ok(Prior { position: back.transform_point(&point.position), covariance })
        };
        self.clicks.iter().zip(left.iter().zip(&right)).map(prior).collect()
    }
}
