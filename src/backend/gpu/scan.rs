//! The `scan` stage on the device.

use wgpu::{Buffer, BufferUsages, ComputePipeline};

use super::buffers::{Scan, small};
use super::context::Context;
use super::readback::Readback;
use super::shaders::{Partition, SCAN};
use crate::backend::templates::{ScanPeak, ScanRequest, TILE};
use crate::error::Result;

/// Templates per dispatch: groups per dimension are limited to 65535, and no dispatch should take long.
const TEMPLATES_PER_DISPATCH: usize = 8192;

/// The compiled stage.
#[derive(Debug)]
pub(super) struct Scanner {
    pipeline: ComputePipeline,
}

impl Scanner {
    pub(super) fn new(context: &Context, partition: Partition) -> Result<Self> {
        let layouts = context.scoped("opening", || SCAN.layouts(context, partition.class))?;
        Ok(Self { pipeline: SCAN.pipeline(context, &layouts, (partition.class, 0), partition.workgroup)? })
    }

    /// Scores the templates of a checked request.
    pub(super) fn scan(
        &self,
        context: &Context,
        readback: &mut Readback,
        request: &ScanRequest<'_>,
        peaks: &mut Vec<ScanPeak>,
    ) -> Result<()> {
        peaks.clear();
        for chosen in request.chosen.chunks(TEMPLATES_PER_DISPATCH) {
            self.dispatch(context, readback, &ScanRequest { chosen, ..*request }, peaks)?;
        }
        Ok(())
    }

    fn dispatch(
        &self,
        context: &Context,
        readback: &mut Readback,
        request: &ScanRequest<'_>,
        peaks: &mut Vec<ScanPeak>,
    ) -> Result<()> {
        let tiles: usize = request.tiles().iter().product();
        let bytes = (tiles * request.chosen.len() * size_of::<[u32; 2]>()) as u64;
        let contents = encoded(request);
        for (label, content) in &contents {
            context.require(&format!("scan buffer {label} (bytes)"), content.len() as u64)?;
        }
        context.require("scan buffer peaks (bytes)", bytes)?;
        let (submission, _) = context.scoped("scanning", || -> Result<_> {
            let inputs = contents.map(|(label, content)| {
                let usage = if label == "scanned" { BufferUsages::UNIFORM } else { BufferUsages::STORAGE };
                let buffer = context.buffer(label, content.len() as u64, usage);
                context.queue.write_buffer(&buffer, 0, &content);
                buffer
            });
            let out = context.buffer("peaks", bytes, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
            let [scanned, gradient, points, templates] = &inputs;
            let layout = self.pipeline.get_bind_group_layout(0);
            let buffers = [scanned, gradient, points, templates, &out].map(Buffer::as_entire_binding);
            let group = context.bind(SCAN.name, &layout, buffers);
            let mut encoder = context.device.create_command_encoder(&Default::default());
            {
                let mut pass = encoder.begin_compute_pass(&Default::default());
                pass.set_pipeline(&self.pipeline);
                pass.set_bind_group(0, &group, &[]);
                pass.dispatch_workgroups(small(tiles), small(request.chosen.len()), 1);
            }
            encoder.copy_buffer_to_buffer(&out, 0, readback.buffer(context, bytes)?, 0, bytes);
            Ok((context.submit(encoder), out))
        })??;
        let width = small(request.image.width);
        readback.read(context, submission, bytes, |bytes| {
            let found: &[[u32; 2]] = bytemuck::cast_slice(bytes);
            peaks.extend(found.iter().map(|[score, pixel]| ScanPeak {
                score: f32::from_bits(*score),
                position: [pixel % width, pixel / width].map(|x| u16::try_from(x).unwrap_or(u16::MAX)),
            }));
        })
    }
}

/// The contents of the bindings before the last, in their order.
fn encoded(request: &ScanRequest<'_>) -> [(&'static str, Vec<u8>); 4] {
    let [columns, _] = request.tiles();
    let scanned = Scan {
        width: small(request.image.width),
        height: small(request.image.height),
        columns: small(columns),
        tile: small(TILE),
    };
    let (mut points, mut templates) = (Vec::<[f32; 4]>::new(), Vec::<[u32; 4]>::new());
    for template in request.chosen {
        let (of_template, scale) = request.templates.get(*template as usize);
        let first = small(points.len());
        points.extend(of_template.iter().map(|p| {
            let [u, v] = p.offset.map(f32::from);
            [u, v, p.value[0], p.value[1]]
        }));
        templates.push([first, small(points.len()), scale.to_bits(), 0]);
    }
    [
        ("scanned", bytemuck::bytes_of(&scanned).to_vec()),
        ("gradient", bytemuck::cast_slice(&request.image.values).to_vec()),
        ("points", bytemuck::cast_slice(&points).to_vec()),
        ("templates", bytemuck::cast_slice(&templates).to_vec()),
    ]
}
