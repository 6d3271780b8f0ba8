//! Bringing results back to the host.

use std::sync::mpsc;
use std::time::Duration;

use wgpu::{Buffer, BufferDescriptor, BufferUsages, MapMode, PollType, SubmissionIndex};

use super::context::Context;
use crate::error::Result;

/// A device that has not answered after this long hangs.
const TIMEOUT: Duration = Duration::from_secs(30);

/// The one buffer that the host can read; grows as needed.
#[derive(Debug, Default)]
pub(super) struct Readback {
    staging: Option<Buffer>,
}

impl Readback {
    /// The staging buffer, of at least `bytes`, as the target of a copy.
    pub(super) fn buffer(&mut self, context: &Context, bytes: u64) -> Result<&Buffer> {
        let fits = self.staging.take().filter(|buffer| buffer.size() >= bytes);
        let buffer = match fits {
            Some(buffer) => buffer,
            None => context.scoped("creating the staging buffer", || {
                context.device.create_buffer(&BufferDescriptor {
                    label: Some("staging"),
                    size: bytes.next_multiple_of(4096),
                    usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                })
            })?,
        };
        Ok(self.staging.insert(buffer))
    }

    /// Waits for `submission` and hands the first `bytes` of the staging buffer to `read`.
    pub(super) fn read<T>(
        &mut self,
        context: &Context,
        submission: SubmissionIndex,
        bytes: u64,
        read: impl FnOnce(&[u8]) -> T,
    ) -> Result<T> {
        let fault = |message: String| context.fault("reading results", message);
        // Taken out, so that after an error the next call starts with a fresh buffer.
        let buffer = self.staging.take().ok_or_else(|| fault("there is no staging buffer".into()))?;
        let (sender, receiver) = mpsc::channel();
        let slice = buffer.slice(..bytes);
        slice.map_async(MapMode::Read, move |result| {
            // The receiver is gone only after a timeout, when nobody wants to know.
            let _ = sender.send(result);
        });
        let wait = PollType::Wait { submission_index: Some(submission), timeout: Some(TIMEOUT) };
        context.device.poll(wait).map_err(|e| fault(e.to_string()))?;
        // A destroyed device leaves the poll content; only the mapping tells. Another stream's thread may be the one that
        // calls back, and a moment later.
        receiver
            .recv_timeout(TIMEOUT)
            .map_err(|e| fault(format!("no answer to the mapping: {e}")))?
            .map_err(|e| fault(e.to_string()))?;
        let view = slice.get_mapped_range().map_err(|e| fault(e.to_string()))?;
        context.count_map(bytes);
        let value = read(&view);
        drop(view);
        buffer.unmap();
        self.staging = Some(buffer);
        Ok(value)
    }
}
