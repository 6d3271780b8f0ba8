//! The wgpu backend.
/// GPU.
#[derive(Debug)]
pub struct GpuBackend;
