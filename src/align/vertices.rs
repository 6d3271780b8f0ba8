//! Where the vertices of the shape are in the image and how they move with the pose: worked out once per pose for all
//! triangles that share them.

use nalgebra::{Matrix2x6, Matrix3, Matrix6, Point2, Point3};

use crate::geometry::warp::increment_jacobian_at;
use crate::geometry::{Camera, Pose, TriangleMesh};

/// A vertex in front of the camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct MovingVertex {
    /// Its place in the image, pixels.
    pub(super) image: Point2<f64>,
    /// D: motion in the image per increment of the pose.
    pub(super) motion: Matrix2x6<f64>,
}

impl MovingVertex {
    /// The object point `x` at a pose whose rotation matrix is `rotation`, moved by increments about `centre`; `None`
    /// behind the camera.
    pub(super) fn new(
        camera: &Camera,
        pose: &Pose,
        rotation: &Matrix3<f64>,
        x: &Point3<f64>,
        centre: &Point3<f64>,
    ) -> Option<Self> {
        let in_camera = pose.transform_point(x);
        let image = camera.project(&in_camera)?;
        let motion = increment_jacobian_at(camera, &in_camera, rotation, &(x - centre));
        Some(Self { image, motion })
    }
}

/// All vertices at one pose.
#[derive(Debug, Default)]
pub(super) struct Vertices {
    of_mesh: Vec<Option<MovingVertex>>,
    /// How many of the triangles in use a vertex belongs to.
    uses: Vec<f64>,
}

impl Vertices {
    /// Moves all vertices to a pose.
    pub(super) fn place(&mut self, camera: &Camera, pose: &Pose, mesh: &TriangleMesh, centre: &Point3<f64>) {
        let rotation = pose.rotation();
        let vertex = |x| MovingVertex::new(camera, pose, &rotation, x, centre);
        self.of_mesh.clear();
        self.of_mesh.extend(mesh.vertices.iter().map(vertex));
        self.uses.clear();
        self.uses.resize(mesh.vertices.len(), 0.0);
    }

    /// The corners of a triangle; `None` if one of them is behind the camera.
    pub(super) fn corners(&self, triangle: &[u32; 3]) -> Option<[&MovingVertex; 3]> {
        let [a, b, c] = triangle.map(|v| self.of_mesh[v as usize].as_ref());
        Some([a?, b?, c?])
    }

    /// Counts a triangle as one that is in use.
    pub(super) fn use_triangle(&mut self, triangle: &[u32; 3]) {
        triangle.iter().for_each(|&v| self.uses[v as usize] += 1.0);
    }

    /// Mean of D^T D over the corners of the triangles in use; zero without any.
    pub(super) fn displacement(&self) -> Matrix6<f64> {
        let (mut sum, mut corners) = (Matrix6::zeros(), 0.0);
        for (vertex, uses) in self.of_mesh.iter().zip(&self.uses).filter(|(_, uses)| **uses > 0.0) {
            let Some(MovingVertex { motion, .. }) = vertex else { continue };
            sum += motion.tr_mul(motion) * *uses;
            corners += uses;
        }
        if corners > 0.0 { sum / corners } else { sum }
    }
}
