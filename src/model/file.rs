//! The model file: versioned and checksummed (`docs/formats.md`).

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::calibration::Calibration;
use super::chart::Chart;
use super::shape::Shape;
use super::template::{LevelTemplate, Model, Pixels, View};
use crate::dataset::sealed::Seal;
use crate::dataset::write_atomically;
use crate::error::{Error, Result};

/// Version 2; raised whenever the payload changes.
const SEAL: Seal =
    Seal { magic: *b"AAM6DMDL", version: 2, what: "model file", remedy: "train the model again" };

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
        let bytes = SEAL.close(&self.payload().map_err(|e| Error::io(path, io::Error::other(e)))?);
        write_atomically(path, |out| out.write_all(&bytes))
    }

    /// A number that nearly all other models do not share: CRC-32 of what would be stored.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the model cannot be stored.
    pub fn fingerprint(&self) -> Result<u32> {
        let payload = self.payload();
        let payload = payload.map_err(|e| Error::invalid("model", e.to_string(), "train the model again"))?;
        Ok(crc32fast::hash(&payload))
    }

    /// Reads a model file.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read; [`Error::Field`] if it is no model file, of another version, truncated,
    /// damaged (checksum), or inconsistent.
    pub fn load(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        let payload = SEAL.open(path, &bytes)?;
        let damaged = |problem: String| Error::field(path, "payload", problem, "train the model again");
        let (stored, rest) = postcard::take_from_bytes::<Payload>(payload)
            .map_err(|e| damaged(format!("cannot be decoded ({e})")))?;
        if !rest.is_empty() {
            return Err(damaged(format!("{} bytes too many", rest.len())));
        }
        Self::from_stored(stored).map_err(|e| damaged(e.to_string()))
    }

    fn payload(&self) -> Result<Vec<u8>, postcard::Error> {
        let level = |l: &LevelTemplate| Level { pixels: l.pixels.clone(), charts: l.charts.clone() };
        postcard::to_stdvec(&Payload {
            object_id: self.object_id,
            shape: self.shape.clone(),
            views: self.views.clone(),
            levels: self.levels.iter().map(level).collect(),
            calibration: self.calibration,
        })
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
