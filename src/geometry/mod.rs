//! Cameras, poses, meshes and warps. Metres, radians, f64; no I/O.

pub mod bundle;
pub mod camera;
pub mod distance;
pub mod few_points;
pub mod hand_eye;
mod least_squares;
pub mod mesh;
pub mod pnp;
pub mod pose;
pub mod raster;
pub mod rigid_fit;
pub mod stereo;
pub mod symmetry;
pub mod warp;

pub use camera::{Camera, Distortion};
pub use hand_eye::HandEye;
pub use mesh::TriangleMesh;
pub use pose::Pose;
pub use stereo::StereoRig;
pub use symmetry::Symmetries;
