//! The open device: errors become values, and a lost device is noticed.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout, BindingResource, Buffer,
    BufferDescriptor, BufferUsages, CommandEncoder, ErrorFilter, Limits, PollType, SubmissionIndex,
};

use super::adapter::{AdapterSelection, AdapterSummary, select};
use crate::backend::Traffic;
use crate::error::{Error, Result};

/// An open device with its queue.
#[derive(Debug)]
pub(super) struct Context {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) adapter: AdapterSummary,
    signals: Arc<Signals>,
    submits: AtomicU64,
    maps: AtomicU64,
    bytes_read: AtomicU64,
}

/// What the device's callbacks left behind.
#[derive(Debug, Default)]
struct Signals {
    /// Set once, when the device is lost.
    lost: OnceLock<String>,
    /// First error that no scope caught.
    fault: Mutex<Option<String>>,
}

impl Context {
    /// Opens a device with the adapter's buffer limits and otherwise no more than WebGPU's defaults.
    pub(super) fn open(selection: &AdapterSelection) -> Result<Self> {
        let (adapter, summary) = select(selection)?;
        let limits = Limits {
            max_storage_buffer_binding_size: summary.max_binding_bytes,
            max_buffer_size: summary.max_buffer_bytes,
            max_texture_dimension_2d: summary.max_image_side,
            max_texture_array_layers: summary.max_layers,
            ..Limits::default().or_worse_values_from(&adapter.limits())
        };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("aam6d"),
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|e| Error::Gpu {
                adapter: summary.name.clone(),
                what: "opening the device".into(),
                message: e.to_string(),
            })?;
        let signals = Arc::new(Signals::default());
        listen(&device, &signals);
        tracing::debug!(adapter = summary.name, backend = summary.backend, "device opened");
        let (submits, maps, bytes_read) = Default::default();
        Ok(Self { device, queue, adapter: summary, signals, submits, maps, bytes_read })
    }

    /// Hands commands to the device.
    pub(super) fn submit(&self, encoder: CommandEncoder) -> SubmissionIndex {
        self.submits.fetch_add(1, Relaxed);
        self.queue.submit([encoder.finish()])
    }

    /// Counts a buffer that was mapped.
    pub(super) fn count_map(&self, bytes: u64) {
        self.maps.fetch_add(1, Relaxed);
        self.bytes_read.fetch_add(bytes, Relaxed);
    }

    /// What has crossed so far.
    pub(super) fn traffic(&self) -> Traffic {
        let [submits, maps, bytes_read] =
            [&self.submits, &self.maps, &self.bytes_read].map(|count| count.load(Relaxed));
        Traffic { submits, maps, bytes_read }
    }

    /// Fails if the device was lost or an error came up that no scope caught.
    pub(super) fn check(&self) -> Result<()> {
        if let Some(reason) = self.lost() {
            return Err(Error::DeviceLost { adapter: self.adapter.name.clone(), reason: reason.clone() });
        }
        let fault = self.signals.fault.lock().unwrap_or_else(PoisonError::into_inner).take();
        fault.map_or(Ok(()), |message| Err(self.fault("working", message)))
    }

    /// Why the device was lost, if it was. Losing it makes other calls fail first or not at all; the callback that
    /// tells comes with a poll.
    fn lost(&self) -> Option<&String> {
        if self.signals.lost.get().is_none() {
            // Its failures are those of earlier submissions, which are reported where they are waited for.
            let _ = self.device.poll(PollType::Poll);
        }
        self.signals.lost.get()
    }

    /// An error of the graphics interface; a lost device if it has been lost.
    pub(super) fn fault(&self, what: &str, message: impl Into<String>) -> Error {
        let adapter = self.adapter.name.clone();
        match self.lost() {
            Some(reason) => Error::DeviceLost { adapter, reason: reason.clone() },
            None => Error::Gpu { adapter, what: what.into(), message: message.into() },
        }
    }

    /// Does `work` and turns every error the device reports meanwhile into `Err`.
    pub(super) fn scoped<T>(&self, what: &str, work: impl FnOnce() -> T) -> Result<T> {
        self.check()?;
        let filters = [ErrorFilter::OutOfMemory, ErrorFilter::Internal, ErrorFilter::Validation];
        let scopes = filters.map(|filter| self.device.push_error_scope(filter));
        let value = work();
        // Scopes close in the reverse order; all of them must, even after an error.
        let errors: Vec<_> =
            scopes.into_iter().rev().filter_map(|scope| pollster::block_on(scope.pop())).collect();
        match errors.first() {
            Some(error) => Err(self.fault(what, error.to_string())),
            None => self.check().map(|()| value),
        }
    }

    /// Fails if a buffer that shaders are to see is larger than the device allows.
    pub(super) fn require(&self, what: &str, bytes: u64) -> Result<()> {
        self.require_below(what, bytes, self.max_bytes())
    }

    /// Fails if `needed` exceeds `limit`.
    pub(super) fn require_below(&self, what: &str, needed: u64, limit: u64) -> Result<()> {
        if needed <= limit {
            return Ok(());
        }
        let (adapter, what) = (self.adapter.name.clone(), what.to_owned());
        Err(Error::AdapterTooSmall { adapter, what, needed, limit })
    }

    /// Largest buffer that shaders can see, bytes, in whole vec4s.
    pub(super) fn max_bytes(&self) -> u64 {
        self.adapter.max_binding_bytes.min(self.adapter.max_buffer_bytes) & !15
    }

    /// A bind group of these, in their order.
    pub(super) fn bind<'a>(
        &self,
        label: &str,
        layout: &BindGroupLayout,
        resources: impl IntoIterator<Item = BindingResource<'a>>,
    ) -> BindGroup {
        let entry = |(binding, resource)| BindGroupEntry { binding, resource };
        let entries: Vec<_> = (0..).zip(resources).map(entry).collect();
        self.device.create_bind_group(&BindGroupDescriptor { label: Some(label), layout, entries: &entries })
    }

    /// A buffer that shaders see, of `bytes` rounded up to whole vec4s and never empty.
    pub(super) fn buffer(&self, label: &str, bytes: u64, usage: BufferUsages) -> Buffer {
        let size = bytes.next_multiple_of(16).max(16);
        let usage = usage | BufferUsages::COPY_DST;
        self.device.create_buffer(&BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }
}

fn listen(device: &wgpu::Device, signals: &Arc<Signals>) {
    let lost = Arc::clone(signals);
    device.set_device_lost_callback(move |reason, message| {
        let text = if message.is_empty() { format!("{reason:?}") } else { format!("{reason:?}: {message}") };
        tracing::warn!(reason = text, "device lost");
        lost.lost.get_or_init(|| text);
    });
    let fault = Arc::clone(signals);
    device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
        tracing::error!(%error, "uncaught device error");
        fault.fault.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(|| error.to_string());
    }));
}
