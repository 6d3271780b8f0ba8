//! Fewer chart pixels: those that say most about the pose.

use super::template::{LevelTemplate, Model, Pixels};
use crate::error::{Error, Result};

impl Pixels {
    /// The pixels with these numbers, in this order and with the first `modes` modes.
    pub fn picked(&self, numbers: &[usize], modes: usize) -> Self {
        let column = |values: &Vec<f32>| numbers.iter().map(|&p| values[p]).collect();
        Self {
            position: numbers.iter().map(|&p| self.position[p]).collect(),
            gradient: numbers.iter().map(|&p| self.gradient[p]).collect(),
            intensity: column(&self.intensity),
            weight: column(&self.weight),
            modes: self.modes.iter().take(modes).map(column).collect(),
        }
    }

    /// What a pixel adds to JtQJ, up to the geometry it shares with its neighbours: q |g|^2.
    fn information(&self, p: usize) -> f32 {
        let [u, v] = self.gradient[p];
        self.weight[p] * (u * u + v * v)
    }
}

impl Model {
    /// A model that keeps, at full size, `share` (0..1) of the pixels of every chart, those with the largest `q |g|^2`; coarser
    /// levels, which are small and carry the score, stay as they are. Less time for less accuracy: `docs/maths.md`, "Fewer
    /// pixels".
    ///
    /// # Errors
    /// [`Error::Invalid`] for a share that is not in (0, 1].
    pub fn thinned(&self, share: f64) -> Result<Self> {
        if !(share > 0.0 && share <= 1.0) {
            let problem = format!("a share of {share} of the pixels");
            return Err(Error::invalid("template", problem, "keep more than 0 and at most 1 of them"));
        }
        let Some(full) = self.levels.first() else { return Ok(self.clone()) };
        let (mut kept, mut charts) = (Vec::new(), full.charts.clone());
        for chart in &mut charts {
            let mut order: Vec<usize> = chart.range().collect();
            let information = |p: &usize| full.pixels.information(*p);
            // Of equal ones the first, so that the result is always the same.
            order.sort_by(|a, b| information(b).total_cmp(&information(a)).then(a.cmp(b)));
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                clippy::cast_precision_loss,
                reason = "a number of pixels"
            )]
            order.truncate((order.len() as f64 * share).ceil() as usize);
            // In the order of the chart, in which neighbours share cache lines of the image.
            order.sort_unstable();
            let index = |n: usize| u32::try_from(n).expect("no more pixels than before");
            chart.start = index(kept.len());
            kept.extend(order);
            chart.end = index(kept.len());
        }
        let pixels = full.pixels.picked(&kept, self.modes());
        let mut levels = self.levels.clone();
        levels[0] = LevelTemplate::new(&self.shape, &self.views, 0, pixels, charts)?;
        Ok(Self { levels, ..self.clone() })
    }
}
