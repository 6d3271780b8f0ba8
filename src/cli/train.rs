//! `aam6d train`: posed or annotated frames to a model file.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;

use super::details::{self, Details};
use super::frames::{self, SceneArgs, annotated_images, training_images};
use super::summary::JsonArg;
use crate::dataset::stereo::{read_clicks, read_stereo};
use crate::dataset::{Dataset, PoseSource, Scene, landmarks};
use crate::geometry::pnp::PnpSolution;
use crate::model::Model;
use crate::track::annotated::prepare;
use crate::track::{Status, StereoPair, calibrate};
use crate::train::annotated::{AnnotationOptions, Refinement};
use crate::train::{TrainOptions, TrainingImage, extend, train};

/// A model is extended from poses at least this certain: standard deviation per axis in the camera frame.
const CERTAIN_MM: f64 = 0.5;
/// The same for rotations.
const CERTAIN_DEG: f64 = 0.2;
/// And with at least this correlation.
const CERTAIN_CORRELATION: f64 = 0.8;
/// More frames than this add memory, not knowledge.
const MAX_EXTENSION_FRAMES: usize = 40;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Frames to train on; with --annotations all annotated ones unless given
    #[arg(long, value_name = "I,J,..", value_delimiter = ',', required_unless_present_any = ["annotations", "extend"])]
    frames: Vec<u32>,
    /// Landmarks in every training frame (annotations.json): poses come from them, and the mesh from --landmarks
    #[arg(long, value_name = "FILE", requires = "landmarks", conflicts_with = "poses")]
    annotations: Option<PathBuf>,
    /// Positions of the landmarks (landmarks.json, as `aam6d landmarks` writes it)
    #[arg(long, value_name = "FILE", requires = "annotations")]
    landmarks: Option<PathBuf>,
    /// Calibration of the stereo pair that the landmarks were clicked in (stereo.json): its images say how large they are
    #[arg(long, value_name = "FILE", requires_all = ["clicks", "annotations"], conflicts_with = "no_refine")]
    stereo: Option<PathBuf>,
    /// The clicks in that pair (clicks.json)
    #[arg(long, value_name = "FILE", requires = "stereo")]
    clicks: Option<PathBuf>,
    /// Refuse annotations further than this from where their landmark should be
    #[arg(long, value_name = "PX", default_value_t = AnnotationOptions::default().max_distance_px)]
    max_annotation_error: f64,
    /// Take landmarks and poses as they come; else both are refined together, as far as the landmarks' covariance lets
    /// them, and then the poses by aligning the images with the model
    #[arg(long, requires = "annotations")]
    no_refine: bool,
    /// Add views to this model instead of training a new one, from frames tracked with it: --poses is the results file,
    /// --details says which of its poses are certain
    #[arg(long, value_name = "MODEL", requires = "details", conflicts_with_all = ["annotations", "modes"])]
    extend: Option<PathBuf>,
    /// Details file of `aam6d track`, for --extend
    #[arg(long, value_name = "FILE", requires = "extend")]
    details: Option<PathBuf>,
    /// BOP object id
    #[arg(long, default_value_t = 1)]
    object: u32,
    /// Where the poses come from: scene_gt.json, scene_ref.json, or a file
    #[arg(long, value_name = "gt|ref|FILE", default_value = "gt")]
    poses: PoseSource,
    /// Number of appearance modes
    #[arg(long, value_name = "L", default_value_t = 0)]
    modes: usize,
    /// Keep only this share (0 to 1) of the pixels at full size, those that say most about the pose: less time for less
    /// accuracy
    #[arg(long, value_name = "SHARE", default_value_t = 1.0)]
    keep: f64,
    /// Leave the triangles as they are in the mesh, for `--method paper`; else large ones are cut
    #[arg(long)]
    whole_triangles: bool,
    /// Model file to write
    #[arg(long, value_name = "MODEL")]
    out: PathBuf,
    #[command(flatten)]
    json: JsonArg,
}

/// What a model holds.
#[derive(Debug, Serialize)]
struct Summary {
    model: PathBuf,
    object: u32,
    triangles: usize,
    triangles_with_chart: usize,
    reference_views: usize,
    template_px: Vec<usize>,
    modes: usize,
    /// Fit of the landmarks per annotated frame, pixels.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    annotations: Vec<Annotated>,
    #[serde(skip_serializing_if = "Option::is_none")]
    refinement: Option<Refined>,
}

/// What the annotations changed in the landmarks, rms over landmarks and axes.
#[derive(Debug, Serialize)]
struct Refined {
    moved_mm: f64,
    sigma_before_mm: f64,
    sigma_after_mm: f64,
    /// Triangles with another diagonal than Delaunay's, and those left out.
    triangles_changed: usize,
}

impl Refined {
    fn new(r: Refinement, triangles_changed: usize) -> Self {
        Self {
            moved_mm: r.moved * 1000.0,
            sigma_before_mm: r.sigma_before * 1000.0,
            sigma_after_mm: r.sigma_after * 1000.0,
            triangles_changed,
        }
    }
}

/// What annotated training tells beside the model.
type Fit = (Vec<Annotated>, Option<Refined>);

/// A model and what it was trained on.
struct Trained {
    model: Model,
    images: Vec<TrainingImage>,
    fit: Fit,
}

/// How well the landmarks of a frame fit.
#[derive(Debug, Serialize)]
struct Annotated {
    frame: u32,
    rms_px: f64,
    /// How far the vertices moved when the image was aligned with the model of all.
    moved_px: f64,
}

impl Summary {
    fn new(path: &Path, model: &Model, (annotations, refinement): Fit) -> Self {
        let charts = || model.levels[0].charts.iter().filter(|c| !c.is_empty());
        let views: std::collections::BTreeSet<u32> = charts().map(|c| c.view).collect();
        Self {
            model: path.to_owned(),
            object: model.object_id,
            triangles: model.shape.triangles(),
            triangles_with_chart: charts().count(),
            reference_views: views.len(),
            template_px: model.levels.iter().map(|l| l.pixels.len()).collect(),
            modes: model.modes(),
            annotations,
            refinement,
        }
    }
}

impl Args {
    fn options(&self) -> TrainOptions {
        let default = TrainOptions::default();
        let max_edge_px = if self.whole_triangles { f64::INFINITY } else { default.max_edge_px };
        TrainOptions { object_id: self.object, modes: self.modes, max_edge_px, ..default }
    }

    fn chosen_frames(&self) -> Vec<u32> {
        let mut frames = self.frames.clone();
        frames.sort_unstable();
        frames.dedup();
        frames
    }

    /// More views for a model, from frames whose pose is certain.
    fn extend_model(&self, dataset: &Dataset, scene: &Scene) -> anyhow::Result<Trained> {
        let (Some(model), Some(details)) = (&self.extend, &self.details) else {
            anyhow::bail!("--extend needs --details, to tell which poses are certain");
        };
        let model = Model::load(model)?;
        let poses = dataset.poses(scene.id, model.object_id, &self.poses)?;
        let frames = certain_frames(details, scene.id, &self.chosen_frames())?;
        let images = training_images(scene, &poses, &self.poses, &frames)?;
        let model = extend(&model, &images, &self.options())?;
        Ok(Trained { model, images, fit: Fit::default() })
    }

    /// The pair that was clicked in, if it is given.
    fn stereo_pair(&self, names: &[String], sigma_px: f64) -> anyhow::Result<Option<StereoPair>> {
        let Some((stereo, clicks)) = self.stereo.as_ref().zip(self.clicks.as_ref()) else { return Ok(None) };
        let (calibration, clicks) = (read_stereo(stereo)?, read_clicks(clicks)?);
        let sigma_px = clicks.sigma_px.unwrap_or(sigma_px);
        frames::stereo_pair(&self.scene.dataset, &calibration, &clicks, sigma_px, names).map(Some)
    }

    /// Poses and mesh from the landmarks.
    fn train_annotated(&self, scene: &Scene, annotations: &Path, shape: &Path) -> anyhow::Result<Trained> {
        let annotations_file = landmarks::read_annotations(annotations)?;
        let shape = annotations_file.shape(&landmarks::read_landmarks(shape)?)?;
        let mut frames = self.chosen_frames();
        if frames.is_empty() {
            frames = annotations_file.frames.keys().copied().collect();
        }
        let images = annotated_images(scene, &annotations_file, &frames)
            .with_context(|| annotations.display().to_string())?;
        let default = AnnotationOptions::default();
        let options = AnnotationOptions {
            max_distance_px: self.max_annotation_error,
            sigma_px: annotations_file.sigma_px.unwrap_or(default.sigma_px),
            refine: !self.no_refine,
        };
        let pair = self.stereo_pair(&annotations_file.names, options.sigma_px)?;
        let ready = prepare(&shape, pair.as_ref(), images, &options)
            .with_context(|| annotations.display().to_string())?;
        let model = train(&ready.mesh, &ready.images, &self.options())?;
        let fit = |((&frame, fit), &moved_px): ((&u32, &PnpSolution), &f64)| Annotated {
            frame,
            rms_px: fit.rms_px,
            moved_px,
        };
        let annotations = frames.iter().zip(&ready.fits).zip(&ready.moved_px).map(fit).collect();
        let fit = (annotations, ready.refinement.map(|r| Refined::new(r, ready.triangles_changed)));
        Ok(Trained { model, images: ready.images, fit })
    }
}

/// Frames of the scene whose pose is certain, thinned to at most [`MAX_EXTENSION_FRAMES`].
fn certain_frames(details: &Path, scene: u32, wanted: &[u32]) -> anyhow::Result<Vec<u32>> {
    let mut frames: Vec<u32> = details::read(details)?
        .iter()
        .filter(|d| d.scene_id == scene && is_certain(d))
        .map(|d| d.frame)
        .filter(|f| wanted.is_empty() || wanted.contains(f))
        .collect();
    let file = details.display();
    anyhow::ensure!(
        !frames.is_empty(),
        "{file}: no frame of scene {scene} has a certain pose; track more frames"
    );
    let step = frames.len().div_ceil(MAX_EXTENSION_FRAMES);
    frames = frames.into_iter().step_by(step).collect();
    Ok(frames)
}

/// Tracked, well recognised, and with a small covariance.
fn is_certain(d: &Details) -> bool {
    let deviation = |c: &nalgebra::Matrix6<f64>, axes: std::ops::Range<usize>| {
        axes.map(|k| c[(k, k)]).fold(0.0, f64::max).sqrt()
    };
    let small = d.covariance().is_some_and(|c| {
        deviation(&c, 0..3) * 1e3 <= CERTAIN_MM && deviation(&c, 3..6).to_degrees() <= CERTAIN_DEG
    });
    d.status == Status::Tracking && d.correlation >= CERTAIN_CORRELATION && small
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let (dataset, scene) = args.scene.open()?;
    let Trained { mut model, images, fit } = match args.annotations.as_deref().zip(args.landmarks.as_deref())
    {
        Some((annotations, shape)) => args.train_annotated(&scene, annotations, shape)?,
        None if args.extend.is_some() => args.extend_model(&dataset, &scene)?,
        None => {
            let poses = dataset.poses(scene.id, args.object, &args.poses)?;
            let mesh = dataset.mesh(args.object)?;
            let images = training_images(&scene, &poses, &args.poses, &args.chosen_frames())?;
            let model = train(&mesh, &images, &args.options())?;
            Trained { model, images, fit: Fit::default() }
        }
    };
    model = model.thinned(args.keep)?;
    calibrate(&mut model, &images)?;
    model.save(&args.out)?;
    let s = Summary::new(&args.out, &model, fit);
    let mut text = format!(
        "{}: object {}, {} of {} triangles with a chart from {} reference view(s), template {:?} px, {} modes",
        s.model.display(),
        s.object,
        s.triangles_with_chart,
        s.triangles,
        s.reference_views,
        s.template_px,
        s.modes
    );
    if !s.annotations.is_empty() {
        let fits: Vec<String> =
            s.annotations.iter().map(|a| format!("{} {:.2} {:.2}", a.frame, a.rms_px, a.moved_px)).collect();
        text += &format!("\nannotations, frame, rms px, moved by px: {}", fits.join(", "));
    }
    if let Some(r) = &s.refinement {
        text += &format!(
            "\nlandmarks moved by {:.3} mm rms per axis; standard deviation {:.3} mm before, {:.3} mm after; {} \
             triangles changed",
            r.moved_mm, r.sigma_before_mm, r.sigma_after_mm, r.triangles_changed
        );
    }
    args.json.write(&text, &s)
}
