//! What the `scan` stage takes and hands back: sparse templates of a normalised gradient, scored at every position.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::imaging::NormalisedGradient;

/// Positions are looked at in squares of this side; the best of each is handed back.
pub const TILE: usize = 20;

/// One point of a template.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScanPoint {
    /// Where it is, pixels from the template's anchor.
    pub offset: [i16; 2],
    /// The normalised gradient there.
    pub value: [f32; 2],
}

/// Sparse templates, one after the other.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScanTemplates {
    points: Vec<ScanPoint>,
    /// Ends of the templates in `points`.
    ends: Vec<u32>,
    /// 1 / sqrt(sum of the squared values).
    scales: Vec<f32>,
    reach: usize,
}

impl ScanTemplates {
    /// Appends a template.
    pub fn push(&mut self, points: &[ScanPoint]) {
        let energy: f32 = points.iter().map(|p| p.value[0] * p.value[0] + p.value[1] * p.value[1]).sum();
        self.scales.push(if energy > 0.0 { 1.0 / energy.sqrt() } else { 0.0 });
        let offsets = points.iter().flat_map(|p| p.offset);
        self.reach = offsets.map(|o| usize::from(o.unsigned_abs())).fold(self.reach, usize::max);
        self.points.extend_from_slice(points);
        self.ends.push(u32::try_from(self.points.len()).expect("fewer than 2^32 points"));
    }

    /// Number of templates.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The points of a template, and 1 / sqrt(sum of their squared values).
    pub fn get(&self, template: usize) -> (&[ScanPoint], f32) {
        let start = if template == 0 { 0 } else { self.ends[template - 1] as usize };
        (&self.points[start..self.ends[template] as usize], self.scales[template])
    }

    /// Largest offset along an axis, pixels.
    pub fn reach(&self) -> usize {
        self.reach
    }
}

/// One call of the `scan` stage.
#[derive(Debug, Clone, Copy)]
pub struct ScanRequest<'a> {
    /// Normalised gradient of the image.
    pub image: &'a NormalisedGradient,
    /// All templates.
    pub templates: &'a ScanTemplates,
    /// Those to score.
    pub chosen: &'a [u32],
}

impl ScanRequest<'_> {
    /// Tiles along u and v.
    pub fn tiles(&self) -> [usize; 2] {
        [self.image.width.div_ceil(TILE), self.image.height.div_ceil(TILE)]
    }

    /// Checks that the chosen templates exist and the image has its pixels.
    ///
    /// # Errors
    /// [`Error::Invalid`] saying what does not fit.
    pub fn check(&self) -> Result<()> {
        if let Some(t) = self.chosen.iter().find(|t| **t as usize >= self.templates.len()) {
            let problem = format!("template {t} of {}", self.templates.len());
            return Err(Error::invalid("scan request", problem, "choose templates that exist"));
        }
        if self.image.values.len() != self.image.width * self.image.height || self.image.values.is_empty() {
            let problem = "the image has no pixels or not all of them";
            return Err(Error::invalid("scan request", problem, "give the gradient of a frame"));
        }
        Ok(())
    }
}

/// The best position of a template in a tile.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ScanPeak {
    /// z = sum t.F / sqrt(sum |t|^2) with the image's values F; points outside the image count 0.
    pub score: f32,
    /// Where the anchor is, pixels.
    pub position: [u16; 2],
}
