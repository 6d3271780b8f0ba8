//! Grey images: reading and writing, sampling, gradients, pyramids, rectification.

pub mod corners;
pub mod gray;
pub mod keypoints;
pub mod normalised;
pub mod pyramid;
pub mod rectify;
pub mod sample;

pub use gray::GrayImage;
pub use normalised::NormalisedGradient;
pub use pyramid::Pyramid;
pub use rectify::Rectifier;
