//! The CPU backend: runs everywhere, rayon over triangles and poses.

pub mod accumulate;
pub mod downsample;
pub mod linearize;

use image::GrayImage;
use rayon::prelude::*;

use super::{Backend, Linearization, ModelId, Request, Sums};
use crate::error::{Error, Result};
use crate::imaging::Pyramid;
use crate::model::{LevelTemplate, Model};

/// Does the image work on the CPU.
#[derive(Debug, Default)]
pub struct CpuBackend {
    models: Vec<Vec<LevelTemplate>>,
    frame: Pyramid,
}

impl CpuBackend {
    /// A backend without models or frame.
    pub fn new() -> Self {
        Self::default()
    }
}

impl CpuBackend {
    /// The template and the image a request is about, its sizes checked.
    fn find(&self, request: &Request<'_>) -> Result<(&LevelTemplate, &GrayImage)> {
        let level = self
            .models
            .get(request.model.0)
            .and_then(|levels| levels.get(request.level))
            .ok_or_else(|| Error::invalid("request", "no such model or level", "load the model first"))?;
        request.check(level.charts.len(), level.pixels.modes.len(), self.frame.len())?;
        Ok((level, self.frame.level(request.level)))
    }
}

impl Backend for CpuBackend {
    fn name(&self) -> String {
        "cpu".into()
    }

    fn load(&mut self, model: &Model) -> Result<ModelId> {
        self.models.push(model.levels.clone());
        Ok(ModelId(self.models.len() - 1))
    }

    fn set_frame(&mut self, image: &GrayImage, levels: usize) -> Result<()> {
        self.frame = Pyramid::new(image.clone(), levels);
        Ok(())
    }

    fn accumulate(&mut self, request: &Request<'_>, sums: &mut Sums) -> Result<()> {
        let (level, image) = self.find(request)?;
        let (triangles, modes) = (level.charts.len(), level.pixels.modes.len());
        sums.reset(request.items, triangles, modes);
        let row_len = Sums::row_len(modes);
        sums.data_mut().par_chunks_mut(row_len).with_min_len(16).enumerate().for_each(|(i, row)| {
            let warp = &request.warps[i];
            let (item, triangle) = (i / triangles, i % triangles);
            let appearance = &request.appearance[item * modes..][..modes];
            if warp.active {
                accumulate::accumulate(&level.pixels, &level.charts[triangle], warp, appearance, image, row);
            }
        });
        Ok(())
    }

    fn linearize(&mut self, request: &Request<'_>, out: &mut Linearization) -> Result<()> {
        let (level, image) = self.find(request)?;
        let (triangles, modes) = (level.charts.len(), level.pixels.modes.len());
        out.reset(request.items, triangles, modes);
        let (first, second) = out.data_mut();
        let rows = first
            .par_chunks_mut(Sums::row_len(modes))
            .zip(second.par_chunks_mut(Linearization::row_len(modes)));
        rows.with_min_len(16).enumerate().for_each(|(i, rows)| {
            let warp = &request.warps[i];
            let (item, triangle) = (i / triangles, i % triangles);
            let appearance = &request.appearance[item * modes..][..modes];
            if warp.active {
                linearize::linearize(&level.pixels, &level.charts[triangle], warp, appearance, image, rows);
            }
        });
        Ok(())
    }
}
