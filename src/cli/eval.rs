//! `aam6d eval`: poses against a reference.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Context;

use super::details::{self, Details};
use super::frames::SceneArgs;
use super::summary::JsonArg;
use crate::dataset::{PoseSource, results, robot};
use crate::eval::consistency::normalised_error_squared;
use crate::eval::errors::{is_lost, rotation_error_deg, translation_error_mm};
use crate::eval::{Estimate, EvalObject, NormalisedError, RobotCell, evaluate, evaluate_in_cell};
use crate::geometry::Pose;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Results file (BOP CSV), of this or any other tracker
    results: PathBuf,
    #[command(flatten)]
    scene: SceneArgs,
    /// What to compare with: scene_gt.json, scene_ref.json, or a file
    #[arg(long, value_name = "gt|ref|FILE", default_value = "gt")]
    poses: PoseSource,
    /// BOP object id; needed if the results hold several
    #[arg(long)]
    object: Option<u32>,
    /// Details file of `aam6d track`, for iterations and covariances
    #[arg(long, value_name = "FILE")]
    details: Option<PathBuf>,
    /// Robot poses, as in `scene_robot.json`: also judge the motion of the end-effector against the robot
    #[arg(long, value_name = "FILE", requires = "hand_eye")]
    robot: Option<PathBuf>,
    /// Hand-eye transform (hand_eye.json), for --robot
    #[arg(long, value_name = "FILE", requires = "robot")]
    hand_eye: Option<PathBuf>,
    #[command(flatten)]
    json: JsonArg,
}

impl Args {
    fn cell(&self) -> anyhow::Result<Option<RobotCell>> {
        let Some((robot, hand_eye)) = self.robot.as_deref().zip(self.hand_eye.as_deref()) else {
            return Ok(None);
        };
        Ok(Some(RobotCell {
            base_from_effector: robot::read_robot(robot)?,
            effector_from_camera: robot::read_hand_eye(hand_eye)?.effector_from_camera,
        }))
    }
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let (dataset, scene) = args.scene.open()?;
    let mut rows = results::read(&args.results)?;
    rows.retain(|r| r.scene_id == scene.id && args.object.is_none_or(|o| o == r.obj_id));
    let file = args.results.display();
    let object_id = rows
        .first()
        .with_context(|| format!("{file}: no line for scene {}; choose another scene", scene.id))?
        .obj_id;
    anyhow::ensure!(
        rows.iter().all(|r| r.obj_id == object_id),
        "{file}: results of several objects; choose one with --object"
    );
    let truth = dataset.poses(scene.id, object_id, &args.poses)?;
    let object = EvalObject::new(&dataset.mesh(object_id)?)?;
    let details: Option<BTreeMap<u32, Details>> = args
        .details
        .as_deref()
        .map(|path| Ok::<_, anyhow::Error>(details::read(path)?.into_iter().map(|d| (d.frame, d)).collect()))
        .transpose()?;
    let estimates: Vec<Estimate> = rows
        .iter()
        .map(|r| Estimate {
            frame: r.im_id,
            pose: r.pose,
            score: r.score,
            time_s: r.time_s,
            iterations: details.as_ref().and_then(|d| Some(d.get(&r.im_id)?.iterations)),
        })
        .collect();
    let mut evaluation = match args.cell()? {
        Some(cell) => evaluate_in_cell(&estimates, &truth, &object, &scene.cameras(), &cell)?,
        None => evaluate(&estimates, &truth, &object, &scene.cameras())?,
    };
    evaluation.normalised_error_squared = details.map(|d| consistency(&estimates, &truth, &object, &d));
    args.json.write(&evaluation.to_string(), &evaluation)
}

/// Normalised error squared over the frames that are tracked by the rule of the evaluation.
fn consistency(
    estimates: &[Estimate],
    truth: &BTreeMap<u32, Pose>,
    object: &EvalObject,
    details: &BTreeMap<u32, Details>,
) -> NormalisedError {
    let normalised = |e: &Estimate| {
        let truth = truth.get(&e.frame)?;
        let t = translation_error_mm(&e.pose, truth, &object.centre()).norm();
        let tracked = !is_lost(t, rotation_error_deg(&e.pose, truth).norm(), e.score);
        let covariance = details.get(&e.frame).filter(|_| tracked)?.covariance()?;
        normalised_error_squared(&e.pose, truth, &covariance)
    };
    NormalisedError::of(&estimates.iter().filter_map(normalised).collect::<Vec<_>>())
}
