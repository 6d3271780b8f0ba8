//! Tracks the 6-DoF pose of a known, textured, rigid object in calibrated video.

pub mod backend;
pub mod error;
pub mod geometry;
pub mod imaging;
pub mod model;
pub mod simulate;

pub use error::{Error, Result};
