//! `aam6d landmarks`: clicks in a stereo pair to landmarks with covariance.

use std::path::PathBuf;

use anyhow::Context;
use nalgebra::Point3;
use serde::Serialize;

use super::summary::{JsonArg, print};
use crate::dataset::landmarks::{landmarks_json, read_landmarks};
use crate::dataset::stereo::{Clicks, read_clicks, read_stereo};
use crate::dataset::{Landmark, write_atomically};
use crate::geometry::rigid_fit::rigid_fit;
use crate::geometry::stereo::{ClickOptions, ClickPair, StereoPoint, StereoRig};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Stereo calibration (stereo.json)
    #[arg(long, value_name = "FILE")]
    stereo: PathBuf,
    /// The same points in the left and the right image (clicks.json)
    #[arg(long, value_name = "FILE")]
    clicks: PathBuf,
    /// Landmarks to write (landmarks.json), in the frame of the left camera unless --frame-of is given
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Bring the landmarks into the frame of these ones, by the names they share
    #[arg(long, value_name = "FILE")]
    frame_of: Option<PathBuf>,
    /// Refuse pairs further than this from their epipolar lines
    #[arg(long, value_name = "PX", default_value_t = 2.0)]
    max_epipolar: f64,
    /// Standard deviation of a click per coordinate, for the covariance; the clicks may state their own
    #[arg(long, value_name = "PX")]
    sigma: Option<f64>,
    #[command(flatten)]
    json: JsonArg,
}

#[derive(Debug, Serialize)]
struct Summary {
    out: PathBuf,
    landmarks: Vec<Row>,
    epipolar_px_rms: f64,
    /// Distance to the landmarks of `--frame-of` after the fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    fit_rms_mm: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Row {
    name: String,
    epipolar_px: f64,
    position_mm: [f64; 3],
    sigma_mm: [f64; 3],
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let rig = read_stereo(&args.stereo)?.rig;
    let clicks = read_clicks(&args.clicks)?;
    let file = args.clicks.display();
    anyhow::ensure!(clicks.pairs.len() >= 6, "{file}: {} landmarks; click at least 6", clicks.pairs.len());
    let points = triangulate(args, &rig, &clicks)?;
    let mut landmarks: Vec<Landmark> = clicks.pairs.iter().zip(&points).map(landmark).collect();
    let fit_rms_mm = args.frame_of.is_some().then(|| bring_into_frame(args, &mut landmarks)).transpose()?;
    let frame = match &args.frame_of {
        Some(path) => format!("that of {}", path.file_name().unwrap_or_default().to_string_lossy()),
        None => "left camera".to_owned(),
    };
    let text = landmarks_json(&landmarks, &frame);
    write_atomically(&args.out, |out| out.write_all(text.as_bytes()))?;
    let rows: Vec<Row> = clicks.pairs.iter().zip(&landmarks).map(|(p, l)| row(&rig, p, l)).collect();
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    let mean = rows.iter().map(|r| r.epipolar_px * r.epipolar_px).sum::<f64>() / rows.len() as f64;
    let summary =
        Summary { out: args.out.clone(), landmarks: rows, epipolar_px_rms: mean.sqrt(), fit_rms_mm };
    args.json.write(&describe(&summary), &summary)
}

/// Triangulates; where a pair is refused, all distances are shown first.
fn triangulate(args: &Args, rig: &StereoRig, clicks: &Clicks) -> anyhow::Result<Vec<StereoPoint>> {
    let sigma_px = args.sigma.or(clicks.sigma_px).unwrap_or(ClickOptions::default().sigma_px);
    anyhow::ensure!(
        sigma_px > 0.0,
        "--sigma: {sigma_px} is not positive; give the noise of a click in pixels"
    );
    let options = ClickOptions { sigma_px, max_epipolar_px: args.max_epipolar };
    let points = rig.triangulate_all(&clicks.pairs, &options);
    if points.is_err() {
        let distance =
            |p: &ClickPair| rig.epipolar_px(p).map_or_else(|| "-".to_owned(), |d| format!("{d:.2}"));
        let lines: Vec<String> =
            clicks.pairs.iter().map(|p| format!("{:<12}{:>10} px", p.name, distance(p))).collect();
        print(&format!("distance from the epipolar line\n{}", lines.join("\n")))?;
    }
    points.with_context(|| args.clicks.display().to_string())
}

fn landmark((pair, point): (&ClickPair, &StereoPoint)) -> Landmark {
    Landmark { name: pair.name.clone(), position: point.position, covariance: point.covariance }
}

/// Moves the landmarks to the frame of others; returns what is left between them, millimetres rms.
fn bring_into_frame(args: &Args, landmarks: &mut [Landmark]) -> anyhow::Result<f64> {
    let path = args.frame_of.as_deref().context("no --frame-of")?;
    let target = read_landmarks(path)?;
    let shared: Vec<(Point3<f64>, Point3<f64>)> = landmarks
        .iter()
        .filter_map(|l| Some((l.position, target.iter().find(|t| t.name == l.name)?.position)))
        .collect();
    let (from, to): (Vec<_>, Vec<_>) = shared.into_iter().unzip();
    let (pose, rms) = rigid_fit(&from, &to)
        .with_context(|| format!("{}: {} landmarks with the same names", path.display(), from.len()))?;
    let rotation = pose.rotation();
    for landmark in landmarks {
        landmark.position = pose.transform_point(&landmark.position);
        landmark.covariance = rotation * landmark.covariance * rotation.transpose();
    }
    Ok(rms * 1000.0)
}

fn row(rig: &StereoRig, pair: &ClickPair, landmark: &Landmark) -> Row {
    Row {
        name: landmark.name.clone(),
        epipolar_px: rig.epipolar_px(pair).unwrap_or(f64::NAN),
        position_mm: (landmark.position * 1000.0).coords.into(),
        sigma_mm: [0, 1, 2].map(|k| landmark.covariance[(k, k)].sqrt() * 1000.0),
    }
}

fn describe(summary: &Summary) -> String {
    let mut text =
        format!("{:<12}{:>12}{:>30}{:>24}\n", "landmark", "epipolar px", "position mm", "sigma mm");
    for r in &summary.landmarks {
        let ([x, y, z], [sx, sy, sz]) = (r.position_mm, r.sigma_mm);
        text += &format!(
            "{:<12}{:>12.2}{x:>10.2}{y:>10.2}{z:>10.2}{sx:>8.2}{sy:>8.2}{sz:>8.2}\n",
            r.name, r.epipolar_px
        );
    }
    text += &format!(
        "{}: {} landmarks, epipolar distance {:.2} px rms",
        summary.out.display(),
        summary.landmarks.len(),
        summary.epipolar_px_rms
    );
    match summary.fit_rms_mm {
        Some(rms) => text + &format!(", {rms:.2} mm rms from those of the frame"),
        None => text,
    }
}
