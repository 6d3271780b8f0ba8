//! Grey images: reading and writing, sampling, pyramids, rectification.

pub mod corners;
pub mod gray;
pub mod pyramid;
pub mod rectify;
pub mod sample;

pub use gray::GrayImage;
pub use pyramid::Pyramid;
pub use rectify::Rectifier;
