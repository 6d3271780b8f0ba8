//! The CPU backend: runs everywhere, rayon over triangles and poses.

pub mod accumulate;
pub mod downsample;

use image::GrayImage;
use rayon::prelude::*;

use super::{Backend, ModelId, Request, Sums};
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
        let level = self
            .models
            .get(request.model.0)
            .and_then(|levels| levels.get(request.level))
            .ok_or_else(|| Error::invalid("request", "no such model or level", "load the model first"))?;
        let (triangles, modes) = (level.charts.len(), level.pixels.modes.len());
        request.check(triangles, modes, self.frame.len())?;
        let image = self.frame.level(request.level);
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
}
