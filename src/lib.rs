#![doc = include_str!("../README.md")]

pub mod align;
pub mod backend;
pub mod error;
pub mod geometry;
pub mod imaging;
pub mod model;
pub mod track;
pub mod train;

pub use error::{Error, Result};
