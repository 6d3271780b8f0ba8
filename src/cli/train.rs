//! `aam6d train`: posed frames to a model file.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::frames::{SceneArgs, training_images};
use super::summary::JsonArg;
use crate::dataset::PoseSource;
use crate::model::Model;
use crate::train::{TrainOptions, train};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Frames to train on
    #[arg(long, value_name = "I,J,..", value_delimiter = ',', required = true)]
    frames: Vec<u32>,
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
}

impl Summary {
    fn new(path: &Path, model: &Model) -> Self {
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
        }
    }
}

pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    let (dataset, scene) = args.scene.open()?;
    let poses = dataset.poses(scene.id, args.object, &args.poses)?;
    let mesh = dataset.mesh(args.object)?;
    let mut frames = args.frames.clone();
    frames.sort_unstable();
    frames.dedup();
    let images = training_images(&scene, &poses, &args.poses, &frames)?;
    let mut options = TrainOptions { object_id: args.object, modes: args.modes, ..TrainOptions::default() };
    if args.whole_triangles {
        options.max_edge_px = f64::INFINITY;
    }
    let model = train(&mesh, &images, &options)?;
    model.save(&args.out)?;
    let s = Summary::new(&args.out, &model);
    let text = format!(
        "{}: object {}, {} of {} triangles with a chart from {} reference view(s), template {:?} px, {} modes",
        s.model.display(),
        s.object,
        s.triangles_with_chart,
        s.triangles,
        s.reference_views,
        s.template_px,
        s.modes
    );
    args.json.write(&text, &s)
}
