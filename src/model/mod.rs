//! What is known about an object: its shape, and how its triangles look in their reference views.

pub mod calibration;
pub mod chart;
pub mod curvature;
pub mod file;
pub mod groups;
pub mod moments;
mod selection;
pub mod shape;
pub mod template;
pub mod weights;

pub use calibration::Calibration;
pub use chart::{Chart, ChartGeometry};
pub use groups::{Grouping, Groups};
pub use moments::Moments;
pub use shape::Shape;
pub use template::{LevelTemplate, Model, Pixels, View, steps};
