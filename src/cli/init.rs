//! Where the first pose of a track comes from: a search, poses of the data set, a file, or clicked points.

use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::frames::pose_of;
use crate::dataset::models_info::read_symmetries;
use crate::dataset::points::read_points;
use crate::dataset::{Dataset, FrameInfo, PoseSource};
use crate::error::Error;
use crate::find::{FindOptions, Priors};
use crate::geometry::few_points;
use crate::geometry::symmetry::Symmetries;
use crate::model::Model;
use crate::track::{SearchOptions, Tracker};

#[derive(Debug, Clone, clap::Args)]
pub(super) struct InitArgs {
    /// Where the pose of the first frame comes from: a search, scene_gt.json, scene_ref.json, or a file
    #[arg(long, value_name = "auto|gt|ref|FILE", default_value = "auto", conflicts_with = "init_points")]
    init: Init,
    /// Pose of the first frame from points of the object clicked in it (JSON)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["distance", "bounds", "models_info"])]
    init_points: Option<PathBuf>,
    /// Search only at these distances from the camera, millimetres
    #[arg(long, value_name = "MIN..MAX")]
    distance: Option<Distances>,
    /// Search only in this box of the first image, pixels
    #[arg(long = "box", value_name = "X,Y,W,H", value_delimiter = ',', num_args = 1)]
    bounds: Option<Vec<f64>>,
    /// Do not search the whole image for an object that was lost
    #[arg(long)]
    no_recover: bool,
    /// Symmetries of the object (`models_info.json`; default: that of the data set, if there is one)
    #[arg(long, value_name = "FILE")]
    models_info: Option<PathBuf>,
}

/// `--init`.
#[derive(Debug, Clone)]
enum Init {
    Auto,
    Poses(PoseSource),
}

impl FromStr for Init {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        if text == "auto" { Ok(Self::Auto) } else { text.parse().map(Self::Poses) }
    }
}

/// `MIN..MAX`, millimetres; kept as text so that the error is the program's own.
#[derive(Debug, Clone)]
struct Distances(String);

impl FromStr for Distances {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(Self(text.to_owned()))
    }
}

impl Distances {
    /// Metres.
    fn range(&self) -> anyhow::Result<(f64, f64)> {
        let parse = || {
            let (near, far) = self.0.split_once("..")?;
            let (near, far): (f64, f64) = (near.trim().parse().ok()?, far.trim().parse().ok()?);
            (near > 0.0 && far >= near && far.is_finite()).then_some((near / 1000.0, far / 1000.0))
        };
        parse().ok_or_else(|| {
            anyhow::anyhow!("--distance {} is no range; give millimetres as MIN..MAX, e.g. 400..900", self.0)
        })
    }
}

impl InitArgs {
    /// Tells the tracker where to look first; templates are kept beside the file `model`.
    pub(super) fn start(
        &self,
        tracker: &mut Tracker,
        model: &Path,
        dataset: &Dataset,
        scene: u32,
        first: &FrameInfo,
    ) -> anyhow::Result<()> {
        if !self.no_recover {
            tracker.search_by(self.search(dataset, model, tracker.model())?)?;
        }
        if let Some(path) = &self.init_points {
            let points = read_points(path)?;
            let (positions, pixels): (Vec<_>, Vec<_>) = points.iter().map(|p| (p.position, p.pixel)).unzip();
            let solution = few_points::solve(&first.camera, &positions, &pixels)
                .map_err(|e| e.in_field(path, "points"))?;
            tracing::info!("clicked points fit within {:.2} px rms", solution.rms_px);
            tracker.start_at(solution.camera_from_object);
            return Ok(());
        }
        match &self.init {
            Init::Poses(source) => {
                let narrowed = self.distance.is_some() || self.bounds.is_some() || self.models_info.is_some();
                anyhow::ensure!(
                    !narrowed,
                    "--distance, --box and --models-info narrow a search; leave them out or use --init auto"
                );
                let poses = dataset.poses(scene, tracker.model().object_id, source)?;
                tracker.start_at(pose_of(&poses, first.id, source)?);
            }
            Init::Auto => {
                let first = Priors { image_box: self.image_box()?, ..Priors::default() };
                tracker
                    .search_by(SearchOptions { first, ..self.search(dataset, model, tracker.model())? })?;
            }
        }
        Ok(())
    }

    fn search(&self, dataset: &Dataset, path: &Path, model: &Model) -> anyhow::Result<SearchOptions> {
        let distance = self.distance.as_ref().map(Distances::range).transpose()?;
        let symmetries = self.symmetries(dataset, model)?;
        let find = FindOptions { distance, symmetries, ..FindOptions::default() };
        let mut templates = path.as_os_str().to_owned();
        templates.push(".templates");
        let templates = Some(PathBuf::from(templates));
        Ok(SearchOptions { find, first: Priors::default(), recover: !self.no_recover, templates })
    }

    fn image_box(&self) -> anyhow::Result<Option<[f64; 4]>> {
        let Some(numbers) = &self.bounds else { return Ok(None) };
        let bounds = <[f64; 4]>::try_from(numbers.as_slice())
            .ok()
            .filter(|b| b.iter().all(|x| x.is_finite()) && b[2] > 0.0 && b[3] > 0.0);
        let message = "--box is no box; give left, top, width and height in pixels, e.g. 100,80,320,240";
        Ok(Some(bounds.ok_or_else(|| anyhow::anyhow!(message))?))
    }

    fn symmetries(&self, dataset: &Dataset, model: &Model) -> anyhow::Result<Symmetries> {
        let path = self.models_info.clone().or_else(|| dataset.models_info());
        Ok(path.map_or(Ok(Symmetries::default()), |path| read_symmetries(&path, model.object_id))?)
    }
}
