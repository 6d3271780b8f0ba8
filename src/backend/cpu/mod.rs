//! The CPU backend: runs everywhere, rayon over triangles and poses.

pub mod accumulate;
pub mod downsample;
mod fast;
pub mod linearize;
pub mod scan;

use std::sync::Arc;

use image::GrayImage;
use rayon::prelude::*;

use super::{Backend, Linearization, ModelId, Request, ScanPeak, ScanRequest, Sums, scanning};
use crate::error::{Error, Result};
use crate::imaging::Pyramid;
use crate::model::{LevelTemplate, Model};
use fast::{FastLevel, PairsPyramid, Tile, Work};

pub(super) use fast::FastScanner;

/// A thread of the fast implementation gets at least this many pixels (times poses): waking a thread for less costs
/// more processor time than it saves.
const PIXELS_PER_THREAD: usize = 48_000;
/// Poses that share a pass over the template at most; so many rows stay in the cache.
const POSES_PER_PASS: usize = 16;

/// How the CPU backend does its work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Implementation {
    /// f32 in vectors.
    Fast(Instructions),
    /// The readable twins of the shaders in f64: the reference of all others.
    Twin,
}

impl Default for Implementation {
    fn default() -> Self {
        Self::Fast(Instructions::Best)
    }
}

/// Vector instructions of the fast implementation; what the processor lacks falls back to the best it has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Instructions {
    /// The widest the processor has.
    #[default]
    Best,
    /// At most AVX2 with FMA.
    Avx2,
    /// At most SSE4.2.
    Sse42,
}

/// A level, also as the fast implementation wants it.
#[derive(Debug)]
struct Loaded {
    template: LevelTemplate,
    fast: Option<FastLevel>,
}

/// Does the image work on the CPU.
#[derive(Debug)]
pub struct CpuBackend {
    implementation: Implementation,
    level: fearless_simd::Level,
    /// Shared with the backends of other streams.
    models: Vec<Arc<Vec<Loaded>>>,
    /// The frame, for the twin.
    frame: Pyramid,
    /// The same for the fast implementation; one of both is filled.
    pairs: PairsPyramid,
}

impl Default for CpuBackend {
    fn default() -> Self {
        Self::with(Implementation::default())
    }
}

impl CpuBackend {
    /// The fast implementation, without models or frame.
    pub fn new() -> Self {
        Self::default()
    }

    /// The readable reference, some ten times slower.
    pub fn twin() -> Self {
        Self::with(Implementation::Twin)
    }

    /// A backend that works in the given way.
    pub fn with(implementation: Implementation) -> Self {
        let instructions = match implementation {
            Implementation::Fast(instructions) => instructions,
            Implementation::Twin => Instructions::Best,
        };
        Self {
            implementation,
            level: fast::level(instructions),
            models: Vec::new(),
            frame: Pyramid::default(),
            pairs: PairsPyramid::default(),
        }
    }

    /// Name of the vector instructions in use.
    pub fn instructions(&self) -> String {
        match self.implementation {
            Implementation::Fast(_) => fast::name(self.level),
            Implementation::Twin => "scalar".into(),
        }
    }

    /// Bytes that one pass of the fast implementation over a level of a model reads; 0 for the twin.
    pub fn bytes_per_pass(&self, model: ModelId, level: usize) -> usize {
        let level = self.models.get(model.0).and_then(|levels| levels.get(level));
        level.and_then(|level| level.fast.as_ref()).map_or(0, FastLevel::bytes)
    }
}

impl CpuBackend {
    /// The level a request is about, its sizes checked.
    fn find(&self, request: &Request<'_>) -> Result<&Loaded> {
        let level = self
            .models
            .get(request.model.0)
            .and_then(|levels| levels.get(request.level))
            .ok_or_else(|| Error::invalid("request", "no such model or level", "load the model first"))?;
        request.check(
            level.template.charts.len(),
            level.template.pixels.modes.len(),
            (1, self.frame.len().max(self.pairs.len())),
        )?;
        Ok(level)
    }
}

impl Backend for CpuBackend {
    fn name(&self) -> String {
        match self.implementation {
            Implementation::Fast(_) => "cpu".into(),
            Implementation::Twin => "cpu (twin)".into(),
        }
    }

    fn another(&self) -> Result<Box<dyn Backend>> {
        Ok(Box::new(Self {
            implementation: self.implementation,
            level: self.level,
            models: self.models.clone(),
            frame: Pyramid::default(),
            pairs: PairsPyramid::default(),
        }))
    }

    fn load(&mut self, model: &Model) -> Result<ModelId> {
        let is_fast = self.implementation != Implementation::Twin;
        let load = |level: &LevelTemplate| Loaded {
            template: level.clone(),
            fast: is_fast.then(|| FastLevel::new(level)),
        };
        self.models.push(Arc::new(model.levels.iter().map(load).collect()));
        Ok(ModelId(self.models.len() - 1))
    }

    fn set_frame(&mut self, image: &GrayImage, levels: usize) -> Result<()> {
        match self.implementation {
            Implementation::Fast(_) => self.pairs.rebuild(image, levels),
            Implementation::Twin => self.frame.rebuild(image, levels),
        }
        Ok(())
    }

    fn accumulate(&mut self, request: &Request<'_>, sums: &mut Sums) -> Result<()> {
        let level = self.find(request)?;
        let (triangles, modes) = (level.template.charts.len(), level.template.pixels.modes.len());
        sums.reset(request.items, triangles, modes);
        match &level.fast {
            Some(level) => self.accumulate_fast(level, request, sums),
            None => accumulate_twin(&level.template, request, self.frame.level(request.image_level), sums),
        }
        Ok(())
    }

    fn linearize(&mut self, request: &Request<'_>, out: &mut Linearization) -> Result<()> {
        let level = self.find(request)?;
        let (triangles, modes) = (level.template.charts.len(), level.template.pixels.modes.len());
        out.reset(request.items, triangles, modes);
        match &level.fast {
            Some(level) => self.linearize_fast(level, request, out),
            None => linearize_twin(&level.template, request, self.frame.level(request.image_level), out),
        }
        Ok(())
    }

    fn scan(&mut self, request: &ScanRequest<'_>, peaks: &mut Vec<ScanPeak>) -> Result<()> {
        scanning::on_host(self.implementation, request, peaks)
    }
}

impl CpuBackend {
    fn work<'a>(&'a self, template: &'a FastLevel, request: &'a Request<'a>) -> Work<'a> {
        Work { level: self.level, template, request, image: self.pairs.level(request.image_level) }
    }

    fn accumulate_fast(&self, level: &FastLevel, request: &Request<'_>, sums: &mut Sums) {
        let Some(cut) = Cut::new(level, request) else { return };
        let work = self.work(level, request);
        let rows = sums.data_mut();
        let len = cut.rows * Sums::row_len(level.mode_count);
        // On this thread where one is enough, which allocates nothing.
        if cut.threads == 1 {
            rows.chunks_mut(len).enumerate().for_each(|(k, rows)| work.accumulate(&cut.tile(k), rows));
        } else {
            rows.par_chunks_mut(len).enumerate().for_each(|(k, rows)| work.accumulate(&cut.tile(k), rows));
        }
    }

    fn linearize_fast(&self, level: &FastLevel, request: &Request<'_>, out: &mut Linearization) {
        let Some(cut) = Cut::new(level, request) else { return };
        let work = self.work(level, request);
        let (first, second) = out.data_mut();
        let first = first.par_chunks_mut(cut.rows * Sums::row_len(level.mode_count));
        let second = second.par_chunks_mut(cut.rows * Linearization::row_len(level.mode_count));
        first.zip(second).enumerate().for_each(|(k, (first, second))| {
            work.linearize(&cut.tile(k), first, second);
        });
    }
}

/// How the rows are cut into tiles that are worth a thread: runs of poses, or of triangles for a single pose.
struct Cut {
    items: usize,
    triangles: usize,
    /// Rows of a tile.
    rows: usize,
    threads: usize,
}

impl Cut {
    /// `None` if there is nothing to do.
    fn new(level: &FastLevel, request: &Request<'_>) -> Option<Self> {
        let (items, triangles) = (request.items, level.triangles.len());
        let work = items * level.padded_pixels();
        let threads = (work / PIXELS_PER_THREAD).clamp(1, rayon::current_num_threads());
        let rows = if items == 1 {
            triangles.div_ceil(threads)
        } else {
            items.div_ceil(threads).min(POSES_PER_PASS) * triangles
        };
        (rows > 0).then_some(Self { items, triangles, rows, threads })
    }

    fn tile(&self, number: usize) -> Tile {
        let Self { items, triangles, rows, .. } = *self;
        let (from, to) = (number * rows, ((number + 1) * rows).min(items * triangles));
        if items == 1 {
            Tile { items: 0..1, triangles: from..to }
        } else {
            Tile { items: from / triangles..to / triangles, triangles: 0..triangles }
        }
    }
}

fn accumulate_twin(level: &LevelTemplate, request: &Request<'_>, image: &GrayImage, sums: &mut Sums) {
    let (triangles, modes) = (level.charts.len(), level.pixels.modes.len());
    let row_len = Sums::row_len(modes);
    sums.data_mut().par_chunks_mut(row_len).with_min_len(16).enumerate().for_each(|(i, row)| {
        let warp = &request.warps[i];
        let (item, triangle) = (i / triangles, i % triangles);
        let appearance = &request.appearance[item * modes..][..modes];
        if warp.active {
            accumulate::accumulate(level, &level.charts[triangle], warp, appearance, image, row);
        }
    });
}

fn linearize_twin(level: &LevelTemplate, request: &Request<'_>, image: &GrayImage, out: &mut Linearization) {
    let (triangles, modes) = (level.charts.len(), level.pixels.modes.len());
    let (first, second) = out.data_mut();
    let rows =
        first.par_chunks_mut(Sums::row_len(modes)).zip(second.par_chunks_mut(Linearization::row_len(modes)));
    rows.with_min_len(16).enumerate().for_each(|(i, rows)| {
        let warp = &request.warps[i];
        let (item, triangle) = (i / triangles, i % triangles);
        let appearance = &request.appearance[item * modes..][..modes];
        if warp.active {
            linearize::linearize(&level.pixels, &level.charts[triangle], warp, appearance, image, rows);
        }
    });
}
