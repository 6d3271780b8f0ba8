//! Templates and landmarks kept in a file: rendering them takes some seconds, reading them a hundredth of that.

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::FindOptions;
use super::Known;
use super::landmarks::Landmarks;
use super::templates::Templates;
use crate::backend::ScanPoint;
use crate::dataset::sealed::Seal;
use crate::dataset::write_atomically;
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose};
use crate::model::Model;

/// The version is raised whenever the payload changes, or what is rendered.
const SEAL: Seal = Seal { magic: *b"AAM6DTPL", version: 2, what: "file of templates", remedy: "delete it" };

/// All that the templates depend on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Key {
    model: u32,
    camera: Camera,
    distance: Option<(f64, f64)>,
    distance_ratio: f64,
    density: f64,
    points: usize,
}

impl Key {
    /// `camera` is that of the scanned image.
    pub(super) fn new(model: &Model, camera: &Camera, options: &FindOptions) -> Result<Self> {
        let FindOptions { distance, distance_ratio, density, points, .. } = *options;
        Ok(Self { model: model.fingerprint()?, camera: *camera, distance, distance_ratio, density, points })
    }
}

#[derive(Debug, Serialize, Deserialize)]
struct Payload {
    key: Key,
    templates: Vec<Stored>,
    landmarks: Landmarks,
}

#[derive(Debug, Serialize, Deserialize)]
struct Stored {
    pose: Pose,
    radius: f64,
    points: Vec<ScanPoint>,
}

/// The templates of a file; `None` if there is no such file or it is of other templates.
///
/// # Errors
/// [`Error::Io`] if it cannot be read, [`Error::Field`] if it is no such file, or damaged.
pub(super) fn load(path: &Path, key: &Key, model: &Model) -> Result<Option<Known>> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(Error::io(path, e)),
    };
    let payload = SEAL.open(path, &bytes)?;
    let stored: Payload = postcard::from_bytes(payload)
        .map_err(|e| Error::field(path, "payload", format!("cannot be decoded ({e})"), "delete the file"))?;
    if stored.key != *key {
        return Ok(None);
    }
    let mut templates = Templates::of(model);
    for Stored { pose, radius, points } in stored.templates {
        templates.push(pose, &points, radius);
    }
    Ok(Some(Known { templates, landmarks: stored.landmarks }))
}

/// Writes templates to a file, which appears complete or not at all.
///
/// # Errors
/// [`Error::Io`] if it cannot be written.
pub(super) fn save(path: &Path, key: &Key, known: &Known) -> Result<()> {
    let Known { templates, landmarks } = known;
    let stored = |k: usize| Stored {
        pose: templates.poses[k],
        radius: templates.radius[k],
        points: templates.scan.get(k).0.to_vec(),
    };
    let payload = Payload {
        key: key.clone(),
        templates: (0..templates.poses.len()).map(stored).collect(),
        landmarks: landmarks.clone(),
    };
    let payload = postcard::to_stdvec(&payload).map_err(|e| Error::io(path, io::Error::other(e)))?;
    write_atomically(path, |out| out.write_all(&SEAL.close(&payload)))
}
