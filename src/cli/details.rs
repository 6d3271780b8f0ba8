//! Reads the details file of `aam6d track` back.

use std::path::Path;

use anyhow::Context;
use nalgebra::Matrix6;
use serde::Deserialize;

use crate::dataset::file::read_text;
use crate::track::Status;

/// What other commands need of a line.
#[derive(Debug, Deserialize)]
pub(super) struct Details {
    pub(super) scene_id: u32,
    pub(super) frame: u32,
    pub(super) status: Status,
    pub(super) iterations: f64,
    pub(super) correlation: f64,
    covariance_ros: Vec<f64>,
}

impl Details {
    /// Covariance in ROS order, metres and radians; `None` if it is not known.
    pub(super) fn covariance(&self) -> Option<Matrix6<f64>> {
        let known = self.covariance_ros.len() == 36 && self.covariance_ros.iter().any(|v| *v != 0.0);
        known.then(|| Matrix6::from_row_slice(&self.covariance_ros))
    }
}

/// Reads all lines.
pub(super) fn read(path: &Path) -> anyhow::Result<Vec<Details>> {
    let text = read_text(path)?;
    let lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
    lines
        .map(|(k, line)| {
            serde_json::from_str(line).with_context(|| {
                let place = format!("{}:{}", path.display(), k + 1);
                format!("{place}: not a line of details; give a file of `aam6d track --details`")
            })
        })
        .collect()
}
