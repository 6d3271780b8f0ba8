//! The data set of an experiment: rendered once, and what is needed of it for training.

use std::path::Path;

use anyhow::Context;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::record::{Options, write_json};
use crate::cli::frames::{self, annotated_images, training_images};
use crate::cli::progress;
use crate::cli::simulate::Choice;
use crate::dataset::landmarks::{read_annotations, read_landmarks};
use crate::dataset::stereo::{read_clicks, read_stereo};
use crate::dataset::{Landmark, PoseSource};
use crate::geometry::TriangleMesh;
use crate::geometry::rigid_fit::rigid_fit;
use crate::geometry::stereo::{ClickOptions, ClickPair, StereoPoint};
use crate::simulate::{CellOptions, SceneKind, SequenceOptions, write_cell, write_dataset};
use crate::track::StereoPair;
use crate::track::annotated::{Prepared, prepare};
use crate::train::TrainingImage;
use crate::train::annotated::AnnotationOptions;

/// Training images per sequence, as many as in the paper.
pub(super) const TRAINING_IMAGES: u32 = 16;
/// Annotations further than this from where their landmark should be are refused.
const MAX_ANNOTATION_PX: f64 = 10.0;

/// What `data/` was rendered from.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Rendered {
    version: String,
    what: What,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum What {
    Sequences(Vec<SequenceOptions>),
    Cell(CellOptions),
}

impl What {
    fn new(options: &Options) -> Self {
        let frames = options.frames as usize;
        let (seed, light) = (options.seed, options.light);
        let scene = match options.scene {
            Choice::Cell => {
                let click_noise_px = options.click_noise_px;
                let training_views = TRAINING_IMAGES as usize;
                let rest = CellOptions::default();
                return Self::Cell(CellOptions {
                    frames,
                    seed,
                    light,
                    click_noise_px,
                    training_views,
                    ..rest
                });
            }
            Choice::Relief => SceneKind::Relief,
            Choice::Box => SceneKind::Box,
            Choice::Turntable => SceneKind::Turntable,
        };
        let base = SequenceOptions { scene, frames, seed, light, ..SequenceOptions::default() };
        Self::Sequences([1, 2].map(|sequence| SequenceOptions { sequence, ..base }).into())
    }

    fn write(&self, data: &Path, progress: impl FnMut(usize, usize)) -> crate::Result<()> {
        match self {
            Self::Sequences(all) => write_dataset(data, all, progress),
            Self::Cell(options) => write_cell(data, options, progress),
        }
    }
}

/// Renders `data/`, unless it is there already.
pub(super) fn render(out: &Path, options: &Options) -> anyhow::Result<()> {
    let data = out.join("data");
    let wanted = Rendered { version: env!("CARGO_PKG_VERSION").into(), what: What::new(options) };
    let note = out.join("data.json");
    let present = std::fs::read(&note).ok().and_then(|text| serde_json::from_slice(&text).ok());
    if present.as_ref() == Some(&wanted) && data.is_dir() {
        return Ok(());
    }
    if data.exists() {
        std::fs::remove_dir_all(&data).with_context(|| format!("{}: cannot be removed", data.display()))?;
    }
    let bar = progress::frames(0, "rendering");
    wanted.what.write(&data, |done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    write_json(&note, &wanted)
}

/// Posed training images of a sequence, and the mesh that is trained on. In the cell both come from clicks; elsewhere
/// they are exact.
pub(super) fn training(
    data: &Path,
    options: &Options,
    sequence: u32,
) -> anyhow::Result<(TriangleMesh, Vec<TrainingImage>)> {
    let (dataset, scene) = frames::open(data, sequence)?;
    if options.scene != Choice::Cell {
        let source = PoseSource::GroundTruth;
        let poses = dataset.poses(sequence, 1, &source)?;
        let images = training_images(&scene, &poses, &source, &spread(options.frames))?;
        return Ok((dataset.mesh(1)?, images));
    }
    let annotations = read_annotations(&scene.folder.join("annotations.json"))?;
    let (landmarks, pair) = clicked_landmarks(data, &annotations.names)?;
    let shape = annotations.shape(&landmarks)?;
    let ids: Vec<u32> = annotations.frames.keys().copied().collect();
    let images = annotated_images(&scene, &annotations, &ids)?;
    let default = AnnotationOptions::default();
    let sigma_px = annotations.sigma_px.unwrap_or(default.sigma_px).max(1e-3);
    let noise = AnnotationOptions { max_distance_px: MAX_ANNOTATION_PX, sigma_px, ..default };
    let prepared = prepare(&shape, Some(&pair), images, &noise)?;
    in_object_frame(data, &annotations.names, prepared)
}

/// Landmarks triangulated from the clicks of the stereo pair, in the frame of its left camera, and the pair.
fn clicked_landmarks(data: &Path, names: &[String]) -> anyhow::Result<(Vec<Landmark>, StereoPair)> {
    let calibration = read_stereo(&data.join("stereo.json"))?;
    let clicks = read_clicks(&data.join("clicks.json"))?;
    // Clicks of a noise above the usual one are what was asked for: only gross mistakes are refused.
    let sigma_px = clicks.sigma_px.unwrap_or(ClickOptions::default().sigma_px).max(1e-3);
    let usual = ClickOptions::default().max_epipolar_px;
    let click = ClickOptions { sigma_px, max_epipolar_px: usual.max(8.0 * sigma_px) };
    let points = calibration.rig.triangulate_all(&clicks.pairs, &click)?;
    let landmark = |(click, point): (&ClickPair, &StereoPoint)| Landmark {
        name: click.name.clone(),
        position: point.position,
        covariance: point.covariance,
    };
    let landmarks = clicks.pairs.iter().zip(&points).map(landmark).collect();
    Ok((landmarks, frames::stereo_pair(data, &calibration, &clicks, sigma_px, names)?))
}

/// Moves what is trained with rigidly to where the exact landmarks are, so that poses can be compared with the truth: the
/// frame of the object is a convention. Size and shape stay.
fn in_object_frame(
    data: &Path,
    names: &[String],
    prepared: Prepared,
) -> anyhow::Result<(TriangleMesh, Vec<TrainingImage>)> {
    let Prepared { mut mesh, mut images, .. } = prepared;
    let exact = read_landmarks(&data.join("landmarks_gt.json"))?;
    let known =
        |(name, x): (&String, &Point3<f64>)| Some((*x, exact.iter().find(|e| e.name == *name)?.position));
    let (from, to): (Vec<Point3<f64>>, Vec<Point3<f64>>) =
        names.iter().zip(&mesh.vertices).filter_map(known).unzip();
    let (object_from_clicked, _) = rigid_fit(&from, &to)?;
    mesh.vertices.iter_mut().for_each(|x| *x = object_from_clicked.transform_point(x));
    let clicked_from_object = object_from_clicked.inverse();
    for image in &mut images {
        image.camera_from_object = image.camera_from_object.compose(&clicked_from_object);
    }
    Ok((mesh, images))
}

/// Frame numbers spread over `0..frames`, first and last included.
fn spread(frames: u32) -> Vec<u32> {
    let count = TRAINING_IMAGES.min(frames);
    (0..count).map(|k| k * (frames - 1) / (count - 1).max(1)).collect()
}
