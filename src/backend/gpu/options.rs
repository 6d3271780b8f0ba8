//! How an adapter is used.

/// Who builds the image pyramid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PyramidPlace {
    /// The host for software adapters, the device for real ones.
    #[default]
    Auto,
    /// The host.
    Host,
    /// The device.
    Device,
}

/// How to use the adapter; the default is right for tracking.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct GpuOptions {
    /// Who builds the image pyramid.
    pub pyramid: PyramidPlace,
    /// Cuts the work as for a real GPU (`Some(false)`) or a software adapter (`Some(true)`), whatever it is.
    pub as_software: Option<bool>,
    /// Largest buffer of one dispatch, bytes, if below the adapter's limit; larger batches are split.
    pub max_dispatch_bytes: Option<u64>,
}
