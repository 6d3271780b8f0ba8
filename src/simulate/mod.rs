//! Synthetic sequences with exact ground truth: two textured objects, a CPU renderer, smooth paths, a BOP exporter.
//!
//! What is rendered is exactly the triangle mesh that is exported, and every number comes from seeded `ChaCha`
//! streams, `libm` and the four basic operations: a sequence is the same, byte for byte, on every machine.
//!
//! ```
//! use aam6d::simulate::{Sequence, SequenceOptions};
//!
//! let sequence = Sequence::new(SequenceOptions { frames: 2, ..SequenceOptions::default() })?;
//! for (camera_from_object, image) in sequence.frames() {
//!     assert!(camera_from_object.translation().z > 0.5);
//!     assert_eq!(image.dimensions(), (640, 480));
//! }
//! # Ok::<(), aam6d::Error>(())
//! ```

pub mod cell;
pub mod export;
mod export_cell;
pub mod light;
pub mod object;
pub mod occluder;
mod paint;
mod path;
mod random;
mod raster;
pub mod render;
pub mod sequence;
pub mod texture;

pub use cell::{Cell, CellOptions};
pub use export::write_dataset;
pub use export_cell::write_cell;
pub use light::Light;
pub use object::{Patch, TexturedMesh, relief, textured_box};
pub use occluder::Occluder;
pub use render::{Noise, Renderer, View};
pub use sequence::{SceneKind, Sequence, SequenceOptions};
pub use texture::Texture;
