//! Frames of a scene, and the poses that belong to them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context;
use image::GrayImage;

use crate::dataset::stereo::Clicks;
use crate::dataset::{Annotations, Dataset, FrameInfo, PoseSource, Scene, StereoCalibration};
use crate::geometry::Pose;
use crate::geometry::stereo::ClickPair;
use crate::imaging::{Rectifier, gray};
use crate::track::StereoPair;
use crate::train::TrainingImage;
use crate::train::annotated::AnnotatedImage;

/// The dataset and scene of a command.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct SceneArgs {
    /// Dataset in BOP layout
    pub(super) dataset: PathBuf,
    /// Scene number
    #[arg(long, value_name = "S")]
    pub(super) scene: u32,
}

impl SceneArgs {
    pub(super) fn open(&self) -> anyhow::Result<(Dataset, Scene)> {
        open(&self.dataset, self.scene)
    }
}

pub(super) fn open(dataset: &Path, scene: u32) -> anyhow::Result<(Dataset, Scene)> {
    let dataset = Dataset::open(dataset)?;
    let scene = dataset.scene(scene)?;
    anyhow::ensure!(!scene.frames.is_empty(), "{}: the scene has no frames", scene.folder.display());
    Ok((dataset, scene))
}

/// Reads the image of a frame and checks its size.
pub(super) fn read(frame: &FrameInfo) -> anyhow::Result<GrayImage> {
    Ok(gray::read_sized(&frame.image, frame.camera.width, frame.camera.height)?)
}

/// The pose of a frame, or an error that says what is missing.
pub(super) fn pose_of(poses: &BTreeMap<u32, Pose>, frame: u32, source: &PoseSource) -> anyhow::Result<Pose> {
    poses.get(&frame).copied().with_context(|| {
        let name = match source {
            PoseSource::GroundTruth => "scene_gt.json".into(),
            PoseSource::Reference => "scene_ref.json".into(),
            PoseSource::File(path) => path.to_string_lossy(),
        };
        format!(
            "{name}: no pose for frame {frame}; choose another frame or give the poses with gt, ref or a file"
        )
    })
}

/// A frame of a scene by its id.
fn find(scene: &Scene, id: u32) -> anyhow::Result<&FrameInfo> {
    scene.frames.iter().find(|f| f.id == id).with_context(|| {
        let (first, last) = (scene.frames[0].id, scene.frames[scene.frames.len() - 1].id);
        format!("scene {} has no frame {id}; its frames go from {first} to {last}", scene.id)
    })
}

/// Rectified training images of the given frames with their annotations.
pub(super) fn annotated_images(
    scene: &Scene,
    annotations: &Annotations,
    frames: &[u32],
) -> anyhow::Result<Vec<AnnotatedImage>> {
    let image = |id: &u32| {
        let landmarks =
            annotations.frames.get(id).cloned().with_context(|| format!("frame {id} is not annotated"))?;
        let frame = find(scene, *id)?;
        let image = Rectifier::new(&frame.camera).rectify(read(frame)?);
        Ok(AnnotatedImage { frame: *id, image, camera: frame.camera, landmarks })
    };
    frames.iter().map(image).collect()
}

/// Rectified training images of the given frames with their poses.
pub(super) fn training_images(
    scene: &Scene,
    poses: &BTreeMap<u32, Pose>,
    source: &PoseSource,
    frames: &[u32],
) -> anyhow::Result<Vec<TrainingImage>> {
    let image = |id: &u32| {
        let frame = find(scene, *id)?;
        let rectified = Rectifier::new(&frame.camera).rectify(read(frame)?);
        Ok(TrainingImage {
            image: rectified,
            camera: frame.camera.rectified(),
            camera_from_object: pose_of(poses, *id, source)?,
        })
    };
    frames.iter().map(image).collect()
}

/// The stereo pair in which `names` were clicked, with what its clicks are worth.
pub(super) fn stereo_pair(
    dataset: &Path,
    calibration: &StereoCalibration,
    clicks: &Clicks,
    sigma_px: f64,
    names: &[String],
) -> anyhow::Result<StereoPair> {
    let frames =
        clicks.frames.context("clicks: left_frame and right_frame are missing; say which were clicked")?;
    let image = |scene: u32, frame: u32| read(find(&open(dataset, scene)?.1, frame)?);
    let left = image(calibration.left_scene, frames[0])?;
    let right = image(calibration.right_scene, frames[1])?;
    let click = |name: &String| {
        let found = clicks.pairs.iter().find(|p| p.name == *name).cloned();
        found.with_context(|| format!("clicks: the landmark {name:?} is missing"))
    };
    let clicks: anyhow::Result<Vec<ClickPair>> = names.iter().map(click).collect();
    Ok(StereoPair::new(&calibration.rig, [left, right], &clicks?, sigma_px)?)
}
