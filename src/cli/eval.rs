//! `aam6d eval`: poses against a reference.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Deserialize;

use super::frames::SceneArgs;
use super::summary::JsonArg;
use crate::dataset::{PoseSource, results, robot};
use crate::eval::{Estimate, EvalObject, RobotCell, evaluate, evaluate_in_cell};

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
    /// Details file of `aam6d track`, for the iterations
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
    let iterations = args.details.as_deref().map(read_iterations).transpose()?.unwrap_or_default();
    let estimates: Vec<Estimate> = rows
        .iter()
        .map(|r| Estimate {
            frame: r.im_id,
            pose: r.pose,
            score: r.score,
            time_s: r.time_s,
            iterations: iterations.get(&r.im_id).copied(),
        })
        .collect();
    let evaluation = match args.cell()? {
        Some(cell) => evaluate_in_cell(&estimates, &truth, &object, &scene.cameras(), &cell)?,
        None => evaluate(&estimates, &truth, &object, &scene.cameras())?,
    };
    args.json.write(&evaluation.to_string(), &evaluation)
}

/// Iterations by frame from a details file.
fn read_iterations(path: &Path) -> anyhow::Result<BTreeMap<u32, f64>> {
    #[derive(Deserialize)]
    struct Line {
        frame: u32,
        iterations: f64,
    }
    let text = crate::dataset::file::read_text(path)?;
    let lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty());
    lines
        .map(|(k, line)| {
            let line: Line = serde_json::from_str(line).with_context(|| {
                format!("{}:{}: not a line of `aam6d track --details`", path.display(), k + 1)
            })?;
            Ok((line.frame, line.iterations))
        })
        .collect()
}
