//! Progress bars; silent where there is no terminal.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over `total` frames.
pub(super) fn frames(total: usize, what: &str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} [{bar:30}] {pos}/{len} frames, {per_sec}, {eta} left");
    let bar = ProgressBar::new(total as u64).with_message(what.to_owned());
    // The template is a constant; the default style is what remains if it were wrong.
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
