#![doc = include_str!("../README.md")]

pub mod align;
pub mod backend;
#[cfg(feature = "cli")]
pub mod cli;
pub mod dataset;
pub mod error;
pub mod eval;
pub mod find;
pub mod geometry;
pub mod imaging;
pub mod model;
pub mod simulate;
pub mod track;
pub mod train;

pub use error::{Error, Result};
