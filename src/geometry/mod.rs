//! Cameras, poses, meshes and warps. Metres, radians, f64; no I/O.

pub mod camera;
pub mod mesh;
pub mod pose;
pub mod raster;
pub mod warp;

pub use camera::{Camera, Distortion};
pub use mesh::TriangleMesh;
pub use pose::Pose;
