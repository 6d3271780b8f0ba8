//! Files in and out: data sets in the BOP layout, calibrations, meshes, result and trajectory files.
//!
//! Files hold millimetres where their format says so; everything handed on is in metres and radians.
//! `docs/formats.md` describes each file field by field.

pub mod bop;
pub mod calibration;
pub mod file;
mod json;
pub mod landmarks;
pub mod models_info;
pub mod ply;
pub mod points;
pub mod poses;
pub mod results;
pub mod robot;
pub mod sealed;
pub mod stereo;
pub mod trajectory;

pub use bop::{Dataset, FrameInfo, Scene};
pub use file::write_atomically;
pub use landmarks::{Annotations, Landmark};
pub use poses::PoseSource;
pub use results::ResultRow;
pub use stereo::StereoCalibration;
pub use trajectory::{StampedPose, Trajectory};

#[cfg(test)]
mod damage;
