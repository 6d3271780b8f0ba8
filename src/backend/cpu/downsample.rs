//! Twin of `shaders/downsample.wgsl`: image level k to k+1.
//!
//! The loop stands in [`crate::imaging::pyramid`], which needs it and must not know about backends; this is the same
//! function under the stage's name.

pub use crate::imaging::pyramid::downsample;
