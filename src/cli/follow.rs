//! What follows an object through a scene: one camera, or both of a stereo pair.

use std::path::{Path, PathBuf};

use anyhow::Context;
use image::GrayImage;

use super::frames;
use crate::align::{Method, Options};
use crate::dataset::stereo::read_stereo;
use crate::dataset::{Dataset, FrameInfo, Scene};
use crate::model::Model;
use crate::track::{RigCamera, RigTracker, Tracked, Tracker};

/// Tracks frame by frame.
pub(super) trait Follow {
    fn model(&self) -> &Model;
    fn backend_name(&self) -> String;
    fn track(&mut self, frame: &FrameInfo, image: &GrayImage) -> anyhow::Result<Tracked>;
}

impl Follow for Tracker {
    fn model(&self) -> &Model {
        self.model()
    }

    fn backend_name(&self) -> String {
        self.backend_name()
    }

    fn track(&mut self, frame: &FrameInfo, image: &GrayImage) -> anyhow::Result<Tracked> {
        self.set_camera(frame.camera)?;
        Ok(self.track(image)?)
    }
}

#[derive(Debug, clap::Args)]
pub(super) struct StereoArgs {
    /// Track with both cameras of this stereo pair (`stereo.json`); poses are those in the camera of --scene
    #[arg(long, value_name = "FILE")]
    stereo: Option<PathBuf>,
    /// Model for the other camera, trained on its own images; it takes up what is wrong in the calibration of the pair
    #[arg(long, value_name = "MODEL", requires = "stereo")]
    other_model: Option<PathBuf>,
}

impl StereoArgs {
    /// The tracker, with a second camera if there is one.
    pub(super) fn follow(
        &self,
        tracker: Tracker,
        dataset: &Dataset,
        scene: &Scene,
        method: Method,
    ) -> anyhow::Result<Box<dyn Follow>> {
        let Some(path) = &self.stereo else { return Ok(Box::new(tracker)) };
        anyhow::ensure!(
            method == Method::InverseCompositional,
            "--stereo works with the method {}, not with {method}; leave one of the two out",
            Method::InverseCompositional
        );
        let (other, camera) = self.other(path, dataset, scene)?;
        let rig = RigTracker::new(tracker, vec![camera], Options::default())?;
        Ok(Box::new(Stereo { rig, other }))
    }

    fn other(&self, path: &Path, dataset: &Dataset, scene: &Scene) -> anyhow::Result<(Scene, RigCamera)> {
        let stereo = read_stereo(path)?;
        let right_from_left = stereo.rig.right_from_left;
        let (number, camera_from_reference) = if scene.id == stereo.left_scene {
            (stereo.right_scene, right_from_left)
        } else if scene.id == stereo.right_scene {
            (stereo.left_scene, right_from_left.inverse())
        } else {
            anyhow::bail!(
                "{}: its scenes are {} and {}, --scene is {}; choose one of the pair",
                path.display(),
                stereo.left_scene,
                stereo.right_scene,
                scene.id
            );
        };
        let other = dataset.scene(number)?;
        let camera = other.frames.first().map(|f| f.camera);
        let camera = camera.with_context(|| format!("scene {number} has no frames"))?;
        let model = self.other_model.as_deref().map(Model::load).transpose()?;
        Ok((other, RigCamera { camera, camera_from_reference, model }))
    }
}

/// Both cameras; frames of the same number are of the same time.
struct Stereo {
    rig: RigTracker,
    other: Scene,
}

impl Follow for Stereo {
    fn model(&self) -> &Model {
        self.rig.model()
    }

    fn backend_name(&self) -> String {
        self.rig.backend_name()
    }

    fn track(&mut self, frame: &FrameInfo, image: &GrayImage) -> anyhow::Result<Tracked> {
        let partner = self.other.frames.iter().find(|f| f.id == frame.id).with_context(|| {
            let scene = self.other.folder.display();
            format!(
                "{scene}: no frame {} beside that of the first camera; both need the same frames",
                frame.id
            )
        })?;
        let other = frames::read(partner)?;
        self.rig.set_camera(0, frame.camera)?;
        self.rig.set_camera(1, partner.camera)?;
        Ok(self.rig.track(&[image, &other])?)
    }
}
