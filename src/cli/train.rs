//! `aam6d train`: posed or annotated frames to a model file.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;

use super::frames::{SceneArgs, annotated_images, training_images};
use super::summary::JsonArg;
use crate::dataset::{PoseSource, Scene, landmarks};
use crate::model::Model;
use crate::train::{TrainOptions, annotated, train};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Frames to train on; with --annotations all annotated ones unless given
    #[arg(long, value_name = "I,J,..", value_delimiter = ',', required_unless_present = "annotations")]
    frames: Vec<u32>,
    /// Landmarks in every training frame (annotations.json): poses come from them, and the mesh from --landmarks
    #[arg(long, value_name = "FILE", requires = "landmarks", conflicts_with = "poses")]
    annotations: Option<PathBuf>,
    /// Positions of the landmarks (landmarks.json, as `aam6d landmarks` writes it)
    #[arg(long, value_name = "FILE", requires = "annotations")]
    landmarks: Option<PathBuf>,
    /// Refuse annotations further than this from where their landmark should be
    #[arg(long, value_name = "PX", default_value_t = 10.0)]
    max_annotation_error: f64,
    /// BOP object id
    #[arg(long, default_value_t = 1)]
    object: u32,
    /// Where the poses come from: scene_gt.json, scene_ref.json, or a file
    #[arg(long, value_name = "gt|ref|FILE", default_value = "gt")]
    poses: PoseSource,
    /// Number of appearance modes
    #[arg(long, value_name = "L", default_value_t = 0)]
    modes: usize,
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
}

/// How well the landmarks of a frame fit.
#[derive(Debug, Serialize)]
struct Annotated {
    frame: u32,
    rms_px: f64,
}

impl Summary {
    fn new(path: &Path, model: &Model, annotations: Vec<Annotated>) -> Self {
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
        }
    }
}

impl Args {
    fn options(&self) -> TrainOptions {
        let mut options =
            TrainOptions { object_id: self.object, modes: self.modes, ..TrainOptions::default() };
        if self.whole_triangles {
            options.max_edge_px = f64::INFINITY;
        }
        options
    }

    fn chosen_frames(&self) -> Vec<u32> {
        let mut frames = self.frames.clone();
        frames.sort_unstable();
        frames.dedup();
        frames
    }

    /// Poses and mesh from the landmarks.
    fn train_annotated(
        &self,
        scene: &Scene,
        annotations: &Path,
        shape: &Path,
    ) -> anyhow::Result<(Model, Vec<Annotated>)> {
        let annotations_file = landmarks::read_annotations(annotations)?;
        let shape = annotations_file.shape(&landmarks::read_landmarks(shape)?)?;
        let mut frames = self.chosen_frames();
        if frames.is_empty() {
            frames = annotations_file.frames.keys().copied().collect();
        }
        let images = annotated_images(scene, &annotations_file, &frames)
            .with_context(|| annotations.display().to_string())?;
        let posed = annotated::pose(&shape, images, self.max_annotation_error)
            .with_context(|| annotations.display().to_string())?;
        let fits = frames.iter().zip(&posed.fits);
        let fits = fits.map(|(&frame, fit)| Annotated { frame, rms_px: fit.rms_px }).collect();
        Ok((train(&posed.mesh, &posed.images, &self.options())?, fits))
    }
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let (dataset, scene) = args.scene.open()?;
    let (model, annotated) = match args.annotations.as_deref().zip(args.landmarks.as_deref()) {
        Some((annotations, shape)) => args.train_annotated(&scene, annotations, shape)?,
        None => {
            let poses = dataset.poses(scene.id, args.object, &args.poses)?;
            let mesh = dataset.mesh(args.object)?;
            let images = training_images(&scene, &poses, &args.poses, &args.chosen_frames())?;
            (train(&mesh, &images, &args.options())?, Vec::new())
        }
    };
    model.save(&args.out)?;
    let s = Summary::new(&args.out, &model, annotated);
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
            s.annotations.iter().map(|a| format!("{} {:.2}", a.frame, a.rms_px)).collect();
        text += &format!("\nannotations, frame and rms px: {}", fits.join(", "));
    }
    args.json.write(&text, &s)
}
