//! The `scan` stage on the host: rayon over templates.

use rayon::prelude::*;

use super::cpu::{self, Implementation};
use super::templates::{ScanPeak, ScanRequest};
use crate::error::Result;

/// Scores the chosen templates; see [`super::Backend::scan`]. One thread does a template, so the bytes do not depend
/// on the number of threads.
///
/// # Errors
/// Those of [`ScanRequest::check`].
pub fn on_host(
    implementation: Implementation,
    request: &ScanRequest<'_>,
    peaks: &mut Vec<ScanPeak>,
) -> Result<()> {
    request.check()?;
    let tiles = request.tiles().iter().product::<usize>();
    peaks.clear();
    peaks.resize(tiles * request.chosen.len(), ScanPeak::default());
    let rows = peaks.par_chunks_exact_mut(tiles).zip(request.chosen);
    match implementation {
        Implementation::Twin => rows.for_each(|(peaks, t)| cpu::scan::scan(request, *t as usize, peaks)),
        Implementation::Fast(instructions) => {
            let scanner = cpu::FastScanner::new(instructions, request);
            let rows = rows.with_min_len(16);
            rows.for_each_init(Default::default, |scratch, (peaks, t)| {
                scanner.scan(*t as usize, scratch, peaks);
            });
        }
    }
    Ok(())
}
