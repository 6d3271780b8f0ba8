//! What the tests share.

#![allow(dead_code, unused_imports, reason = "every test program uses its own part")]

pub(crate) mod data;
pub(crate) mod day;
#[cfg(feature = "gpu")]
pub(crate) mod gpu;
pub(crate) mod linear;
pub(crate) mod pair;
pub(crate) mod scan;
pub(crate) mod scene;
pub(crate) mod searched;
pub(crate) mod sums;
pub(crate) mod tracking;

pub(crate) use scene::{Scene, compare_images, image};
