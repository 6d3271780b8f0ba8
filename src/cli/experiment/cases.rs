//! The two sequences and their models: each is tracked with a model trained on the other.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context;
use nalgebra::{Point3, Vector3};

use super::data;
use super::methods::PerShape;
use super::motion;
use super::record::{Options, SequenceRecord};
use crate::cli::frames;
use crate::cli::progress;
use crate::cli::simulate::Choice;
use crate::dataset::{PoseSource, Scene, robot};
use crate::eval::{EvalObject, RobotCell};
use crate::geometry::{Pose, TriangleMesh};
use crate::model::Model;
use crate::train::{TrainOptions, train};

/// A sequence to track.
pub(super) struct Case {
    pub(super) record: SequenceRecord,
    pub(super) scene: Scene,
    pub(super) truth: BTreeMap<u32, Pose>,
    pub(super) object: EvalObject,
    /// The motion that estimates are compared with; without a robot, that of the camera itself.
    pub(super) robot: RobotCell,
    /// The mesh of the landmarks.
    pub(super) mesh: TriangleMesh,
    pub(super) models: PerShape<Model>,
    /// Where tracking starts: near the true pose of the first frame.
    pub(super) start: Pose,
}

/// Renders the sequences, unless the folder holds them already, and trains the models.
pub(super) fn prepare(out: &Path, options: &Options) -> anyhow::Result<Vec<Case>> {
    data::render(out, options)?;
    [(1, 2), (2, 1)].into_iter().map(|(tracked, other)| case(out, options, tracked, other)).collect()
}

fn case(out: &Path, options: &Options, tracked: u32, trained_on: u32) -> anyhow::Result<Case> {
    let folder = out.join("data");
    let spinner = progress::frames(0, &format!("training for sequence {tracked}"));
    let (mesh, images) = data::training(&folder, options, trained_on)?;
    let training = TrainOptions { modes: options.modes, ..TrainOptions::default() };
    let models = PerShape::train(&training, |training| Ok(train(&mesh, &images, training)?))?;
    models.cut.save(&out.join(format!("model-{tracked}.aam6d")))?;
    spinner.finish_and_clear();

    let (dataset, scene) = frames::open(&folder, tracked)?;
    let source = PoseSource::GroundTruth;
    let truth = dataset.poses(tracked, 1, &source)?;
    let first = scene.frames.first().context("the sequence has no frame")?.id;
    let start = disturbed(&frames::pose_of(&truth, first, &source)?, &models.cut.shape.centre);
    let robot = robot_cell(&scene.folder, options, &truth)?;
    let record = SequenceRecord {
        number: tracked,
        trained_on,
        frames: scene.frames.len(),
        training_images: images.len(),
        landmarks: mesh.vertices.len(),
        triangles: mesh.triangles.len(),
        template_px: models.cut.levels[0].pixels.len(),
        truth: motion::of_robot(&robot, first),
    };
    Ok(Case { record, scene, truth, object: EvalObject::new(&dataset.mesh(1)?)?, robot, mesh, models, start })
}

/// The robot of the cell; elsewhere the camera is its own end-effector, seen from the object.
fn robot_cell(scene: &Path, options: &Options, truth: &BTreeMap<u32, Pose>) -> anyhow::Result<RobotCell> {
    if options.scene != Choice::Cell {
        let base_from_effector = truth.iter().map(|(&frame, pose)| (frame, pose.inverse())).collect();
        return Ok(RobotCell { base_from_effector, effector_from_camera: Pose::identity() });
    }
    Ok(RobotCell {
        base_from_effector: robot::read_robot(&scene.join("scene_robot.json"))?,
        effector_from_camera: robot::read_hand_eye(&scene.join("hand_eye.json"))?.effector_from_camera,
    })
}

/// The pose moved by 2 mm and 1 degree about the object's centre: a start at the true pose would hide a method that
/// does not converge.
fn disturbed(pose: &Pose, centre: &Point3<f64>) -> Pose {
    let turn = Vector3::new(1.0, -1.0, 1.0).normalize() * 1.0_f64.to_radians();
    let shift = Vector3::new(1.0, 1.0, -1.0).normalize() * 0.002;
    pose.compose(&Pose::about(turn, shift, centre))
}
