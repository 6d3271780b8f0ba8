//! `aam6d hand-eye`: robot poses and object poses to the camera's place on the end-effector.

use std::path::PathBuf;

use serde::Serialize;

use super::frames::SceneArgs;
use super::summary::JsonArg;
use crate::dataset::{PoseSource, robot};
use crate::geometry::hand_eye::{self, HandEye};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Robot poses (scene_robot.json)
    #[arg(long, value_name = "FILE")]
    robot: PathBuf,
    /// Object poses: scene_gt.json, scene_ref.json, or a file
    #[arg(long, value_name = "gt|ref|FILE")]
    poses: PoseSource,
    /// BOP object id
    #[arg(long, default_value_t = 1)]
    object: u32,
    /// Hand-eye transform to write (hand_eye.json)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    json: JsonArg,
}

#[derive(Debug, Serialize)]
struct Summary {
    out: PathBuf,
    /// Camera on the end-effector, millimetres.
    t_c2e: [f64; 3],
    frames: Vec<Row>,
    rms_t_mm: f64,
    rms_r_deg: f64,
}

#[derive(Debug, Serialize)]
struct Row {
    frame: u32,
    t_mm: f64,
    r_deg: f64,
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let (dataset, scene) = args.scene.open()?;
    let robot = robot::read_robot(&args.robot)?;
    let poses = dataset.poses(scene.id, args.object, &args.poses)?;
    let only = |a: &mut dyn Iterator<Item = &u32>, b: &dyn Fn(&u32) -> bool| {
        a.filter(|f| !b(f)).map(u32::to_string).collect::<Vec<_>>().join(", ")
    };
    let without_pose = only(&mut robot.keys(), &|f| poses.contains_key(f));
    let without_robot = only(&mut poses.keys(), &|f| robot.contains_key(f));
    anyhow::ensure!(
        without_pose.is_empty() && without_robot.is_empty(),
        "{}: {} robot poses, but {} object poses; frames without an object pose: [{without_pose}], without a robot \
         pose: [{without_robot}]; give one of each per frame",
        args.robot.display(),
        robot.len(),
        poses.len()
    );
    let frames: Vec<u32> = robot.keys().copied().collect();
    let (robot, seen): (Vec<_>, Vec<_>) = robot.into_values().zip(poses.into_values()).unzip();
    let calibration = hand_eye::calibrate(&robot, &seen)?;
    robot::write_hand_eye(&args.out, &calibration, &frames)?;
    let summary = Summary::new(args, &calibration, &frames);
    args.json.write(&summary.describe(), &summary)
}

impl Summary {
    fn new(args: &Args, calibration: &HandEye, frames: &[u32]) -> Self {
        let rows: Vec<Row> = frames
            .iter()
            .zip(&calibration.residuals)
            .map(|(&frame, r)| Row {
                frame,
                t_mm: r.translation.norm() * 1000.0,
                r_deg: r.rotation.norm().to_degrees(),
            })
            .collect();
        #[expect(clippy::cast_precision_loss, reason = "counts are small")]
        let rms = |value: fn(&Row) -> f64| {
            (rows.iter().map(|r| value(r).powi(2)).sum::<f64>() / rows.len() as f64).sqrt()
        };
        Self {
            out: args.out.clone(),
            t_c2e: (calibration.effector_from_camera.translation() * 1000.0).into(),
            rms_t_mm: rms(|r| r.t_mm),
            rms_r_deg: rms(|r| r.r_deg),
            frames: rows,
        }
    }

    fn describe(&self) -> String {
        let mut text = format!("{:>6}{:>12}{:>12}\n", "frame", "mm", "deg");
        for r in &self.frames {
            text += &format!("{:>6}{:>12.3}{:>12.4}\n", r.frame, r.t_mm, r.r_deg);
        }
        let [x, y, z] = self.t_c2e;
        text + &format!(
            "{}: camera at {x:.2}, {y:.2}, {z:.2} mm on the end-effector; {:.3} mm, {:.4} deg rms over {} frames",
            self.out.display(),
            self.rms_t_mm,
            self.rms_r_deg,
            self.frames.len()
        )
    }
}
