//! The one error type of the library. Every text says what is wrong, where, and what to do about it.

use std::path::{Path, PathBuf};

/// Result of everything in this crate that can fail.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What can go wrong. A lost object is not an error: it is [`crate::track::Status::Lost`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be opened, read, written or renamed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// An image file could not be decoded or encoded.
    #[error("{}: not a readable image ({source}); use an 8-bit PNG, JPEG, BMP, PNM or TIFF file", path.display())]
    Image {
        /// The image file.
        path: PathBuf,
        /// What the decoder said.
        source: image::ImageError,
    },
    /// A field of a structured file (JSON, YAML, PLY, model) is missing or wrong.
    #[error("{}: {field}: {problem}; {remedy}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// Where in the file, e.g. `"3"[0].cam_R_m2c`.
        field: String,
        /// What is wrong there.
        problem: String,
        /// What to do.
        remedy: String,
    },
    /// A line of a text file (CSV, ASCII PLY) is wrong.
    #[error("{}:{line}: {problem}; {remedy}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: u64,
        /// What is wrong there.
        problem: String,
        /// What to do.
        remedy: String,
    },
    /// A value handed to the library cannot be used.
    #[error("{what}: {problem}; {remedy}")]
    Invalid {
        /// Which value.
        what: String,
        /// What is wrong with it.
        problem: String,
        /// What to do.
        remedy: String,
    },
    /// No graphics adapter that could run the shaders.
    #[error(
        "no usable GPU adapter: {reason}; install a Vulkan driver (Debian/Ubuntu: mesa-vulkan-drivers) or use --backend cpu"
    )]
    NoAdapter {
        /// What the graphics system said.
        reason: String,
    },
    /// The adapter's limits are below what the model needs.
    #[error(
        "adapter {adapter} is too small: {what} needs {needed}, the limit is {limit}; use another adapter, a smaller model, or --backend cpu"
    )]
    AdapterTooSmall {
        /// Adapter name.
        adapter: String,
        /// Which resource.
        what: String,
        /// Needed amount.
        needed: u64,
        /// The adapter's limit.
        limit: u64,
    },
    /// The device was lost while working (driver reset, unplugged, destroyed).
    #[error("the GPU device {adapter} was lost ({reason}); open the backend again, results so far are kept")]
    DeviceLost {
        /// Adapter name.
        adapter: String,
        /// What the driver said.
        reason: String,
    },
    /// The graphics API refused something or did not answer in time.
    #[error("GPU {adapter}: {what}: {message}")]
    Gpu {
        /// Adapter name.
        adapter: String,
        /// What was attempted.
        what: String,
        /// What the graphics API said.
        message: String,
    },
}

impl Error {
    /// An operating-system error at a path.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().to_owned(), source }
    }

    /// A wrong value outside any file.
    pub fn invalid(what: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Invalid { what: what.into(), problem: problem.into(), remedy: remedy.into() }
    }

    /// A wrong field of a structured file.
    pub fn field(
        path: impl AsRef<Path>,
        field: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Field {
            path: path.as_ref().to_owned(),
            field: field.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// A wrong line of a text file; `line` counts from 1.
    pub fn line(
        path: impl AsRef<Path>,
        line: u64,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Line { path: path.as_ref().to_owned(), line, problem: problem.into(), remedy: remedy.into() }
    }

    /// Says in which field of which file the value behind an [`Error::Invalid`] stands; other errors stay.
    #[must_use]
    pub fn in_field(self, path: impl AsRef<Path>, field: impl Into<String>) -> Self {
        match self {
            Self::Invalid { what, problem, remedy } => {
                Self::field(path, field, format!("{what}: {problem}"), remedy)
            }
            other => other,
        }
    }

    /// Says on which line of which file the value behind an [`Error::Invalid`] stands; other errors stay.
    #[must_use]
    pub fn in_line(self, path: impl AsRef<Path>, line: u64) -> Self {
        match self {
            Self::Invalid { what, problem, remedy } => {
                Self::line(path, line, format!("{what}: {problem}"), remedy)
            }
            other => other,
        }
    }
}
