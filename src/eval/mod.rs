//! Judges poses, of this tracker or any other: errors against known poses, their statistics, a report.
//!
//! Errors are in millimetres, degrees and pixels, and their names say which. The axes are those of the camera:
//! x right, y down, z along the view.

pub mod errors;
pub mod frames;
pub mod report;
pub mod robot;
pub mod statistics;
mod table;

pub use errors::EvalObject;
pub use frames::{Estimate, FrameErrors};
pub use report::{Evaluation, evaluate, evaluate_in_cell};
pub use robot::{RobotCell, RobotErrors};
pub use statistics::ErrorStatistics;
