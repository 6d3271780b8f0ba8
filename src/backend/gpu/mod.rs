//! The wgpu backend: Vulkan, Metal or DX12, on real GPUs and on software adapters such as lavapipe.
//!
//! Per call one submit and one map. The stages are in `shaders/`; which piece of work goes where on which kind of
//! adapter is decided by [`shaders::Partition`] and [`PyramidPlace`].

mod adapter;
mod batch;
pub mod buffers;
mod context;
mod frame;
mod halving;
mod options;
mod readback;
mod rows;
mod scan;
pub mod shaders;
mod table;

use std::collections::BTreeMap;
use std::sync::Arc;

use image::GrayImage;
use wgpu::{BindGroupLayout, ComputePipeline};

use super::{
    Backend, Implementation, Linearization, ModelId, Request, ScanPeak, ScanRequest, Sums, Traffic,
    TriangleWarp, scanning,
};
use crate::error::{Error, Result};
use crate::model::{LevelTemplate, Model};
use batch::{Batch, LoadedLevel, Pass, Target, max_items};
use buffers::{DeviceLevel, small};
use context::Context;
use frame::Frames;
use readback::Readback;
use scan::Scanner;
use shaders::{ACCUMULATE, DOWNSAMPLE, LINEARIZE, Partition, Stage, accumulate_planes, linearize_planes};

pub use adapter::{AdapterSelection, AdapterSummary, adapters};
pub use options::{GpuOptions, PyramidPlace};

/// Does the image work on a graphics adapter.
#[derive(Debug)]
pub struct GpuBackend {
    context: Arc<Context>,
    options: GpuOptions,
    partition: Partition,
    /// Layouts of the stages that add up charts, group by group.
    layouts: Vec<BindGroupLayout>,
    /// Those stages by name and number of mode planes, compiled when they are needed.
    passes: BTreeMap<(&'static str, u32), Pass>,
    downsample: Option<ComputePipeline>,
    /// Compiled when it is first needed.
    scanner: Option<Scanner>,
    /// Shared with the backends of other streams.
    models: Vec<Arc<Vec<LoadedLevel>>>,
    frames: Option<Frames>,
    batch: Batch,
    readback: Readback,
}

impl GpuBackend {
    /// Opens an adapter.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] if there is none like that, [`Error::Gpu`] if it cannot be opened.
    pub fn open(selection: &AdapterSelection) -> Result<Self> {
        Self::open_with(selection, GpuOptions::default())
    }

    /// Opens an adapter to be used in a particular way.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with(selection: &AdapterSelection, options: GpuOptions) -> Result<Self> {
        let context = Arc::new(Context::open(selection)?);
        let is_software = context.adapter.is_software;
        let partition = Partition::of_adapter(options.as_software.unwrap_or(is_software));
        let on_device = match options.pyramid {
            PyramidPlace::Auto => !is_software,
            PyramidPlace::Host => false,
            PyramidPlace::Device => true,
        };
        let layouts = context.scoped("opening", || ACCUMULATE.layouts(&context, partition.class))?;
        let downsample = if on_device {
            let layouts = context.scoped("opening", || DOWNSAMPLE.layouts(&context, partition.class))?;
            Some(DOWNSAMPLE.pipeline(&context, &layouts, (partition.class, 0), partition.workgroup)?)
        } else {
            None
        };
        Ok(Self {
            context,
            options,
            partition,
            layouts,
            passes: BTreeMap::new(),
            downsample,
            scanner: None,
            models: Vec::new(),
            frames: None,
            batch: Batch::default(),
            readback: Readback::default(),
        })
    }

    /// The adapter in use.
    pub fn adapter(&self) -> &AdapterSummary {
        &self.context.adapter
    }

    /// Gives the device back. Everything after that is [`Error::DeviceLost`], as after a driver reset.
    pub fn destroy(&self) {
        self.context.device.destroy();
    }

    /// Uploads a level.
    fn load_level(&self, template: &LevelTemplate) -> Result<LoadedLevel> {
        let context = &self.context;
        let level = DeviceLevel::upload(context, template, self.partition)?;
        max_items(context, &level, accumulate_planes(small(level.modes.div_ceil(4))), self.limit())?;
        let bind_group = context.scoped("binding the template", || {
            context.bind("template", &self.layouts[0], level.resources())
        })?;
        Ok(LoadedLevel { level, bind_group })
    }

    /// Largest buffer or table of a dispatch, bytes.
    fn limit(&self) -> u64 {
        let most = table::most_bytes(&self.context, self.partition.class);
        self.options.max_dispatch_bytes.unwrap_or(u64::MAX).min(most)
    }

    /// Compiles a stage for a number of modes, once; true if it is new.
    fn compile(&mut self, stage: &'static Stage, planes: fn(u32) -> u32, modes: usize) -> Result<bool> {
        let mode_planes = small(modes.div_ceil(4));
        let key = (stage.name, mode_planes);
        if self.passes.contains_key(&key) {
            return Ok(false);
        }
        let planes = planes(mode_planes);
        let workgroup = self.partition.workgroup_for(planes);
        let variant = (self.partition.class, mode_planes);
        let pipeline = stage.pipeline(&self.context, &self.layouts, variant, workgroup)?;
        self.passes.insert(key, Pass { stage, pipeline, planes });
        Ok(true)
    }

    /// Runs a level once without active triangles: drivers compile at the first dispatch, which takes up to seconds.
    fn warm_up(&mut self, level: &LoadedLevel) -> Result<()> {
        let mut frames = self.new_frames(((16, 16), 1), 2)?;
        frames.upload(&self.context, &[&GrayImage::new(16, 16)])?;
        let idle = TriangleWarp::idle();
        let (warps, appearance) = (vec![idle; level.level.centres.len()], vec![0.0; level.level.modes]);
        let model = ModelId(self.models.len());
        let (warps, appearance) = (&*warps, &*appearance);
        let request = Request { model, level: 0, image_level: 0, items: 1, frames: &[], warps, appearance };
        let target = Target {
            context: &self.context,
            layout: &self.layouts[1],
            level,
            pass: &self.passes[&(ACCUMULATE.name, small(level.level.modes.div_ceil(4)))],
            image: frames.bind_group(0),
            limit: self.limit(),
        };
        self.batch.run(target, &mut self.readback, &request, |_, _| ())
    }

    /// Checks a request; returns triangles and modes of its level.
    fn check(&self, request: &Request<'_>) -> Result<(usize, usize)> {
        self.context.check()?;
        let level = self
            .models
            .get(request.model.0)
            .and_then(|levels| levels.get(request.level))
            .ok_or_else(|| Error::invalid("request", "no such model or level", "load the model first"))?;
        let (triangles, modes) = (level.level.centres.len(), level.level.modes);
        request.check(triangles, modes, self.counts())?;
        Ok((triangles, modes))
    }

    /// Runs a compiled stage for a checked request.
    fn run(
        &mut self,
        stage: &Stage,
        request: &Request<'_>,
        mut write: impl FnMut(&DeviceLevel, std::ops::Range<usize>, &[f32]),
    ) -> Result<()> {
        let level = &self.models[request.model.0][request.level];
        let Some(frames) = &self.frames else { return Ok(()) };
        let target = Target {
            context: &self.context,
            layout: &self.layouts[1],
            level,
            pass: &self.passes[&(stage.name, small(level.level.modes.div_ceil(4)))],
            image: frames.bind_group(request.image_level),
            limit: self.limit(),
        };
        let write = |items: std::ops::Range<usize>, data: &[f32]| write(&level.level, items, data);
        self.batch.run(target, &mut self.readback, request, write)
    }
}

impl Backend for GpuBackend {
    fn name(&self) -> String {
        self.context.adapter.name.clone()
    }

    fn another(&self) -> Result<Box<dyn Backend>> {
        self.context.check()?;
        Ok(Box::new(Self {
            context: self.context.clone(),
            options: self.options,
            partition: self.partition,
            layouts: self.layouts.clone(),
            passes: self.passes.clone(),
            downsample: self.downsample.clone(),
            scanner: None,
            models: self.models.clone(),
            frames: None,
            batch: Batch::default(),
            readback: Readback::default(),
        }))
    }

    fn traffic(&self) -> Traffic {
        self.context.traffic()
    }

    fn load(&mut self, model: &Model) -> Result<ModelId> {
        let mut levels = Vec::with_capacity(model.levels.len());
        for template in &model.levels {
            let level = self.load_level(template)?;
            if self.compile(&ACCUMULATE, accumulate_planes, level.level.modes)? {
                self.warm_up(&level)?;
            }
            levels.push(level);
        }
        self.models.push(Arc::new(levels));
        Ok(ModelId(self.models.len() - 1))
    }

    fn set_frame(&mut self, image: &GrayImage, levels: usize) -> Result<()> {
        self.set_frames(&[image], levels)
    }

    fn frames_at_once(&self, size: (u32, u32)) -> usize {
        self.most_frames(size)
    }

    fn set_frames(&mut self, images: &[&GrayImage], levels: usize) -> Result<()> {
        self.take_frames(images, levels)
    }

    fn accumulate(&mut self, request: &Request<'_>, sums: &mut Sums) -> Result<()> {
        let (triangles, modes) = self.check(request)?;
        sums.reset(request.items, triangles, modes);
        let rows = sums.data_mut();
        self.run(&ACCUMULATE, request, |level, items, data| rows::add_sums(level, items, data, rows))
    }

    fn scan(&mut self, request: &ScanRequest<'_>, peaks: &mut Vec<ScanPeak>) -> Result<()> {
        // Without inner products in vectors of 16 a software adapter takes some ten times the host's time.
        if self.options.as_software.unwrap_or(self.context.adapter.is_software) {
            return scanning::on_host(Implementation::default(), request, peaks);
        }
        request.check()?;
        self.context.check()?;
        let scanner = match self.scanner.take() {
            Some(scanner) => scanner,
            None => Scanner::new(&self.context, self.partition)?,
        };
        self.scanner.insert(scanner).scan(&self.context, &mut self.readback, request, peaks)
    }

    fn linearize(&mut self, request: &Request<'_>, out: &mut Linearization) -> Result<()> {
        let (triangles, modes) = self.check(request)?;
        self.compile(&LINEARIZE, linearize_planes, modes)?;
        out.reset(request.items, triangles, modes);
        let (first, second) = out.data_mut();
        self.run(&LINEARIZE, request, |level, items, data| {
            rows::add_linearization(level, items, data, (&mut *first, &mut *second));
        })
    }
}
