//! The model file: versioned and checksummed (`docs/formats.md`).

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::calibration::Calibration;
use super::chart::Chart;
use super::shape::Shape;
use super::template::{LevelTemplate, Model, Pixels, View};
use crate::dataset::write_atomically;
use crate::error::{Error, Result};

const MAGIC: &[u8; 8] = b"AAM6DMDL";
/// Raised whenever the payload changes.
const VERSION: u32 = 2;
/// Magic, version, payload length, CRC-32.
const HEADER_LEN: usize = 8 + 4 + 8 + 4;

/// What is stored; everything else about a model follows from it.
#[derive(Debug, Serialize, Deserialize)]
struct Payload {
    object_id: u32,
    shape: Shape,
    views: Vec<View>,
    levels: Vec<Level>,
    calibration: Calibration,
}

#[derive(Debug, Serialize, Deserialize)]
struct Level {
    pixels: Pixels,
    charts: Vec<Chart>,
}

impl Model {
    /// Writes the model to a file, which appears complete or not at all.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let bytes = self.to_bytes().map_err(|e| Error::io(path, io::Error::other(e)))?;
        write_atomically(path, |out| out.write_all(&bytes))
    }

    /// Reads a model file.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read; [`Error::Field`] if it is no model file, of another version, truncated,
    /// damaged (checksum), or inconsistent.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        let payload = check_header(&bytes)
            .map_err(|(field, problem, remedy)| Error::field(path, field, problem, remedy))?;
        let damaged = |problem: String| Error::field(path, "payload", problem, "train the model again");
        let (stored, rest) = postcard::take_from_bytes::<Payload>(payload)
            .map_err(|e| damaged(format!("cannot be decoded ({e})")))?;
        if !rest.is_empty() {
            return Err(damaged(format!("{} bytes too many", rest.len())));
        }
        Self::from_stored(stored).map_err(|e| damaged(e.to_string()))
    }

    fn to_bytes(&self) -> Result<Vec<u8>, postcard::Error> {
        let level = |l: &LevelTemplate| Level { pixels: l.pixels.clone(), charts: l.charts.clone() };
        let payload = postcard::to_stdvec(&Payload {
            object_id: self.object_id,
            shape: self.shape.clone(),
            views: self.views.clone(),
            levels: self.levels.iter().map(level).collect(),
            calibration: self.calibration,
        })?;
        let mut bytes = Vec::with_capacity(HEADER_LEN + payload.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&(payload.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&crc32fast::hash(&payload).to_le_bytes());
        bytes.extend_from_slice(&payload);
        Ok(bytes)
    }

    fn from_stored(stored: Payload) -> Result<Self> {
        stored.shape.validate()?;
        stored.calibration.validate()?;
        for view in &stored.views {
            view.camera.validate()?;
        }
        if stored.levels.is_empty() {
            return Err(Error::invalid("model", "it has no pyramid level", "train the model again"));
        }
        let modes = stored.levels[0].pixels.modes.len();
        let mut levels = Vec::with_capacity(stored.levels.len());
        for (k, level) in stored.levels.into_iter().enumerate() {
            if level.pixels.modes.len() != modes {
                return Err(Error::invalid("model", "levels differ in their modes", "train the model again"));
            }
            levels.push(LevelTemplate::new(&stored.shape, &stored.views, k, level.pixels, level.charts)?);
        }
        let Payload { object_id, shape, views, calibration, .. } = stored;
        Ok(Self { object_id, shape, views, levels, calibration })
    }
}

/// Returns the payload, or field, problem and remedy.
fn check_header(bytes: &[u8]) -> Result<&[u8], (&'static str, String, &'static str)> {
    const REMEDY: &str = "copy the file again or train the model again";
    let truncated = || ("header", format!("the file ends after {} bytes", bytes.len()), REMEDY);
    let (magic, rest) = bytes.split_first_chunk::<8>().ok_or_else(truncated)?;
    if magic != MAGIC {
        return Err(("magic", "this is not a model file".into(), "give a file written by `aam6d train`"));
    }
    let (version, rest) = rest.split_first_chunk::<4>().ok_or_else(truncated)?;
    let version = u32::from_le_bytes(*version);
    if version != VERSION {
        let problem = format!("version {version}, this program reads version {VERSION}");
        return Err(("version", problem, "train the model again with this program"));
    }
    let (length, rest) = rest.split_first_chunk::<8>().ok_or_else(truncated)?;
    let (checksum, payload) = rest.split_first_chunk::<4>().ok_or_else(truncated)?;
    let length = u64::from_le_bytes(*length);
    if payload.len() as u64 != length {
        return Err(("payload", format!("{} bytes where the header says {length}", payload.len()), REMEDY));
    }
    if crc32fast::hash(payload) != u32::from_le_bytes(*checksum) {
        return Err(("payload", "the checksum is wrong: the file is damaged".into(), REMEDY));
    }
    Ok(payload)
}
