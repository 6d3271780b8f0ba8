//! Results of a run, written frame by frame: a killed program loses no finished frame, and the final name appears
//! only when everything is there.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::align::{PoseEstimate, to_ros_order};
use crate::dataset::ResultRow;
use crate::dataset::results::ResultWriter;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::model::Model;
use crate::track::{FrameTimes, Status, Tracked};

/// A file that is written to `<path>.partial` and renamed when it is complete; devices and pipes are written
/// directly.
#[derive(Debug)]
struct Partial {
    path: PathBuf,
    partial: PathBuf,
}

impl Partial {
    fn create(path: &Path) -> Result<(Self, File)> {
        // A link must keep pointing to its file: replace the file, not the link.
        let path = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let device = std::fs::metadata(&path).is_ok_and(|m| !m.is_file() && !m.is_dir());
        let mut name = path.as_os_str().to_owned();
        if !device {
            name.push(".partial");
        }
        let partial = PathBuf::from(name);
        if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        }
        let file = File::create(&partial).map_err(|e| Error::io(&partial, e))?;
        Ok((Self { path, partial }, file))
    }

    fn error(&self, source: io::Error) -> Error {
        Error::io(&self.partial, source)
    }

    fn rename(&self) -> Result<()> {
        if self.partial == self.path {
            return Ok(());
        }
        std::fs::rename(&self.partial, &self.path).map_err(|e| Error::io(&self.path, e))
    }
}

/// Results in the BOP format.
#[derive(Debug)]
pub(super) struct ResultsFile {
    partial: Partial,
    writer: ResultWriter<File>,
}

impl ResultsFile {
    pub(super) fn create(path: &Path) -> Result<Self> {
        let (partial, file) = Partial::create(path)?;
        let writer = ResultWriter::new(file).map_err(|e| partial.error(e))?;
        Ok(Self { partial, writer })
    }

    pub(super) fn write(&mut self, row: &ResultRow) -> Result<()> {
        self.writer.write(row).map_err(|e| self.partial.error(e))
    }

    pub(super) fn finish(self) -> Result<()> {
        drop(self.writer);
        self.partial.rename()
    }
}

/// Everything known about each frame, one JSON object per line.
#[derive(Debug)]
pub(super) struct DetailsFile {
    partial: Partial,
    out: BufWriter<File>,
}

impl DetailsFile {
    pub(super) fn create(path: &Path) -> Result<Self> {
        let (partial, file) = Partial::create(path)?;
        Ok(Self { partial, out: BufWriter::new(file) })
    }

    pub(super) fn write(&mut self, record: &FrameRecord) -> Result<()> {
        let write = |out: &mut BufWriter<File>| {
            serde_json::to_writer(&mut *out, record)?;
            out.write_all(b"\n")?;
            out.flush()
        };
        write(&mut self.out).map_err(|e| self.partial.error(e))
    }

    pub(super) fn finish(mut self) -> Result<()> {
        self.out.flush().map_err(|e| self.partial.error(e))?;
        drop(self.out);
        self.partial.rename()
    }
}

/// One line of the details file (`docs/formats.md`).
#[derive(Debug, Serialize)]
pub(super) struct FrameRecord {
    scene_id: u32,
    frame: u32,
    status: Status,
    probability: f64,
    spread_px: f64,
    camera_from_object: PoseRecord,
    appearance: Vec<f64>,
    /// Row-major 6x6, `x y z rotX rotY rotZ`, metres and radians, fixed axes of the camera frame.
    covariance_ros: Vec<f64>,
    rms: f64,
    iterations: usize,
    converged: bool,
    visible: f64,
    correlation: f64,
    recognised: f64,
    time_ms: f64,
    times: StageTimes,
}

/// Where the time of a frame went, milliseconds.
#[derive(Debug, Serialize)]
struct StageTimes {
    decode_ms: f64,
    #[serde(flatten)]
    frame: FrameTimes,
}

#[derive(Debug, Serialize)]
struct PoseRecord {
    /// Row-major 3x3.
    rotation: Vec<f64>,
    translation_mm: [f64; 3],
}

impl PoseRecord {
    fn new(pose: &Pose) -> Self {
        let rotation = pose.rotation().transpose().iter().copied().collect();
        Self { rotation, translation_mm: (pose.translation() * 1000.0).into() }
    }
}

impl FrameRecord {
    pub(super) fn new(
        model: &Model,
        (scene_id, frame): (u32, u32),
        tracked: &Tracked,
        decode_ms: f64,
    ) -> Self {
        let e = &tracked.estimate;
        let covariance = to_ros_order(&e.covariance, &e.camera_from_object, &model.shape.centre);
        Self {
            scene_id,
            frame,
            status: tracked.status,
            probability: tracked.probability,
            spread_px: tracked.spread_px,
            camera_from_object: PoseRecord::new(&e.camera_from_object),
            appearance: e.appearance.clone(),
            // Symmetric: row-major is column-major.
            covariance_ros: covariance.iter().copied().collect(),
            rms: e.rms,
            iterations: e.iterations,
            converged: e.converged,
            visible: e.score.visible,
            correlation: e.score.correlation,
            recognised: e.score.recognised,
            time_ms: tracked.time_ms,
            times: StageTimes { decode_ms, frame: tracked.times },
        }
    }
}

/// The row of an estimate: its score is the probability that the pose is right, 0 where there is none.
pub(super) fn row(
    (scene_id, im_id, obj_id): (u32, u32, u32),
    estimate: &PoseEstimate,
    (status, probability): (Status, f64),
    time_ms: f64,
) -> ResultRow {
    let score = if status.has_pose() { probability } else { 0.0 };
    ResultRow {
        scene_id,
        im_id,
        obj_id,
        score,
        pose: estimate.camera_from_object,
        time_s: Some(time_ms / 1e3),
    }
}
