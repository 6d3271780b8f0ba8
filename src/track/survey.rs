//! Where landmarks are in an image, by the image itself: a model of all training images is bent to fit.

use image::GrayImage;
use nalgebra::{Matrix2, Point2};

use crate::align::{Target, VertexShift, vertex_shifts};
use crate::backend::{Backend, CpuBackend, ModelId};
use crate::error::Result;
use crate::geometry::bundle::Mark;
use crate::geometry::{Camera, Pose, TriangleMesh};
use crate::model::Model;
use crate::train::{TrainOptions, TrainingImage, train};

/// What a measured landmark may be off by beside the noise of the image, pixels.
const LEAST_SIGMA_PX: f64 = 0.02;
/// A landmark measured further than this from where it should be is something else, pixels.
const MAX_SHIFT_PX: f64 = 1.5;

/// A model whose vertices are the landmarks, for measurements at full size.
pub(super) struct Survey {
    pub(super) model: Model,
    backend: CpuBackend,
    id: ModelId,
}

impl Survey {
    /// Trains on whole triangles, with the weights of eq. (10) or without.
    pub(super) fn new(mesh: &TriangleMesh, images: &[TrainingImage], edge_weights: bool) -> Result<Self> {
        // The second level is for the score.
        let rest = TrainOptions::default();
        let options = TrainOptions { levels: 2, max_edge_px: f64::INFINITY, edge_weights, ..rest };
        let model = train(mesh, images, &options)?;
        let mut backend = CpuBackend::new();
        let id = backend.load(&model)?;
        Ok(Self { model, backend, id })
    }

    /// Shows an image to what reports on it.
    pub(super) fn look<T>(
        &mut self,
        (image, camera): (&GrayImage, &Camera),
        report: impl FnOnce(&mut dyn Backend, &Target<'_>) -> Result<T>,
    ) -> Result<T> {
        self.backend.set_frame(image, self.model.levels.len())?;
        report(&mut self.backend, &Target { model: &self.model, id: self.id, camera: *camera, image })
    }

    /// The landmarks in a rectified image whose pose is right to a pixel: `known` (one per landmark) and what is measured,
    /// each by its covariance. Where the image does not show a landmark, or far from where it should be, the known mark
    /// stays.
    pub(super) fn marks(
        &mut self,
        (image, camera): (&GrayImage, &Camera),
        pose: &Pose,
        known: &[Mark],
    ) -> Result<Vec<Mark>> {
        let shifts = self.look((image, camera), |backend, target| vertex_shifts(backend, target, pose))?;
        let landmarks = &self.model.shape.mesh.vertices;
        let measured = |((x, known), shift): ((_, &Mark), Option<VertexShift>)| {
            let expected = camera.project(&pose.transform_point(x))?;
            let shift = shift.filter(|s| s.shift.norm() <= MAX_SHIFT_PX)?;
            Some(joined(known, &expected, &shift))
        };
        let all = landmarks.iter().zip(known).zip(shifts);
        Ok(all.map(|found| measured(found).unwrap_or(*found.0.1)).collect())
    }
}

/// A known mark and a measurement of the same landmark, each by its covariance.
fn joined(known: &Mark, expected: &Point2<f64>, found: &VertexShift) -> Mark {
    let least = Matrix2::identity() * (LEAST_SIGMA_PX * LEAST_SIGMA_PX);
    let measured = (found.covariance + least).try_inverse().unwrap_or_else(Matrix2::zeros);
    let before = known.whitening.tr_mul(&known.whitening);
    let pull = measured * found.shift + before * (known.pixel - expected);
    match (measured + before).cholesky() {
        Some(factor) => Mark { pixel: expected + factor.solve(&pull), whitening: factor.l().transpose() },
        None => *known,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    /// Certain along one axis only: there the measurement counts, along the other the click.
    #[test]
    fn each_counts_by_its_covariance() {
        let known = Mark::new(Point2::new(10.0, 20.0), 0.3);
        let covariance = Matrix2::new(1e-6, 0.0, 0.0, 4.0);
        let found = VertexShift { shift: Vector2::new(0.5, 0.5), covariance };
        let mark = joined(&known, &Point2::new(10.1, 20.0), &found);
        assert!((mark.pixel.x - 10.6).abs() < 0.005, "{mark:?}");
        assert!((mark.pixel.y - 20.0 - 0.5 * 0.09 / 4.09).abs() < 1e-3, "{mark:?}");
        let sigma = [0, 1].map(|k| 1.0 / mark.whitening[(k, k)]);
        assert!((sigma[0] - 0.02).abs() < 1e-3 && (sigma[1] - 0.297).abs() < 1e-2, "{sigma:?}");
    }
}
