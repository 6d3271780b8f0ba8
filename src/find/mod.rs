//! The first pose: the object is looked for in one image, without a pose to start from.
//!
//! Sparse templates of the model, rendered from its charts at a grid of poses, are scored at every position of the
//! image at an eighth of its size (stage `scan`); the best are refined and ranked on finer and finer images, the few
//! that are left aligned in full and judged by what they explain of the image. All comparisons before the alignment are of
//! the soft-normalised gradient, which light hardly changes and which bounds the influence of every pixel. If that does
//! not find the whole object, or only a vague pose, keypoints of the image and of the object say further hypotheses, which go the same way.
//! `docs/maths.md`, "First pose".

mod atlas;
mod cache;
mod descent;
mod evidence;
mod grid;
mod hypotheses;
mod judge;
mod landmarks;
mod map;
mod matching;
mod points;
mod priors;
mod render;
mod stages;
mod templates;

use std::path::Path;
use std::time::Instant;

use crate::align::{Aligner, PoseEstimate, Target};
use crate::backend::Backend;
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose, Symmetries};
use crate::model::Model;
use atlas::Atlas;
use evidence::Evidence;
use landmarks::Landmarks;
use templates::Templates;

pub use priors::Priors;

/// Sides of the image that is scanned are at most this long, pixels.
const SCAN_SIDE: u32 = 120;

/// Choices of the search.
#[derive(Debug, Clone, PartialEq)]
pub struct FindOptions {
    /// Distances (nearest, farthest; metres) of the object's centre from the camera; `None`: around those of the model's
    /// reference views.
    pub distance: Option<(f64, f64)>,
    /// Ratio of neighbouring distances of the grid.
    pub distance_ratio: f64,
    /// Density of directions and rolls, 1 is the default.
    pub density: f64,
    /// Points of a template at most.
    pub points: usize,
    /// Turns after which the object looks the same: such poses are one.
    pub symmetries: Symmetries,
    /// Hypotheses kept after the scan, after the descents on the scanned image, and on that of twice its size.
    pub kept: [usize; 3],
}

impl Default for FindOptions {
    fn default() -> Self {
        Self {
            distance: None,
            distance_ratio: 1.14,
            density: 1.0,
            points: 100,
            symmetries: Symmetries::default(),
            kept: [1200, 160, 8],
        }
    }
}

/// What became of a search.
#[derive(Debug, Clone, Default)]
pub struct Found {
    /// The pose that fits best, if any is believed.
    pub best: Option<PoseEstimate>,
    /// Other poses that are believed and look nearly as good: ambiguities.
    pub others: Vec<PoseEstimate>,
    /// Where none is believed, the one that comes nearest to it.
    pub rejected: Option<PoseEstimate>,
    /// What was done, stage by stage.
    pub stages: Vec<StageReport>,
}

/// Time and numbers of one stage.
#[derive(Debug, Clone, PartialEq)]
pub struct StageReport {
    /// Name.
    pub stage: &'static str,
    /// Hypotheses that came in.
    pub hypotheses: usize,
    /// Those that were kept (`camera_from_object`), best first.
    pub kept: Vec<Pose>,
    /// Wall time, milliseconds.
    pub time_ms: f64,
}

impl StageReport {
    fn new(stage: &'static str, hypotheses: usize, kept: Vec<Pose>, began: Instant) -> Self {
        Self { stage, hypotheses, kept, time_ms: began.elapsed().as_secs_f64() * 1e3 }
    }
}

/// Finds one object in images of one camera.
#[derive(Debug)]
pub struct Finder {
    atlas: Atlas,
    camera: Camera,
    options: FindOptions,
    known: Known,
    level: usize,
    /// Root mean square distance of the object's points from its centre, metres.
    extent: f64,
}

/// An aligned hypothesis and what it explains.
type Candidate = (Evidence, PoseEstimate);

/// How the object looks.
#[derive(Debug)]
struct Known {
    templates: Templates,
    landmarks: Landmarks,
}

impl Finder {
    /// Renders the templates: some thousand poses that the model's charts know.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a camera that is none or has lens distortion, for options out of range, and if the model
    /// has no charts to render.
    pub fn new(model: &Model, camera: &Camera, options: &FindOptions) -> Result<Self> {
        Self::of(model, camera, options, |_, render| Ok(render()))
    }

    /// As [`Self::new`], with the templates of a file if it has those that are needed; else it is written for the next time. What is
    /// wrong with the file is logged as a warning and costs no more than the time it would have saved.
    ///
    /// # Errors
    /// Those of [`Self::new`].
    pub fn cached(model: &Model, camera: &Camera, options: &FindOptions, path: &Path) -> Result<Self> {
        Self::of(model, camera, options, |scanned, render| {
            let key = cache::Key::new(model, scanned, options)?;
            match cache::load(path, &key, model) {
                Ok(Some(known)) => return Ok(known),
                Ok(None) => {}
                Err(error) => tracing::warn!("{error}; templates are rendered anew"),
            }
            let known = render();
            if let Err(error) = cache::save(path, &key, &known) {
                tracing::warn!("{error}; templates will be rendered again");
            }
            Ok(known)
        })
    }

    /// `get` has the camera of the scanned image and renders if it must.
    fn of(
        model: &Model,
        camera: &Camera,
        options: &FindOptions,
        get: impl FnOnce(&Camera, &dyn Fn() -> Known) -> Result<Known>,
    ) -> Result<Self> {
        camera.validate()?;
        if !camera.distortion.is_none() {
            return Err(Error::invalid("camera", "it has lens distortion", "search in rectified images"));
        }
        options.check()?;
        let longest = camera.width.max(camera.height);
        let level = (0..).find(|level| longest >> level <= SCAN_SIDE).unwrap_or(0);
        let atlas = Atlas::new(model);
        let scanned = camera.at_level(level);
        let known = get(&scanned, &|| Known {
            templates: Templates::render(model, &atlas, &scanned, options),
            landmarks: Landmarks::render(model, &atlas, camera, options),
        })?;
        if known.templates.poses.is_empty() {
            let problem = "no pose in which the model knows most of what is seen";
            return Err(Error::invalid("model", problem, "train it with views of the sides to be found"));
        }
        let extent = grid::extent(model);
        Ok(Self { atlas, camera: *camera, options: options.clone(), known, level, extent })
    }

    /// Number of templates.
    pub fn templates(&self) -> usize {
        self.known.templates.poses.len()
    }

    /// Is there any template that may look like this?
    pub fn allows(&self, priors: &Priors) -> bool {
        !self.allowed(priors).is_empty()
    }

    /// Looks for the object in the current frame of a backend. An object that is not found is no error.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an image of another size than the camera's, and those of backend and aligner.
    pub fn find(
        &self,
        backend: &mut dyn Backend,
        aligner: &mut dyn Aligner,
        target: &Target<'_>,
        priors: &Priors,
    ) -> Result<Found> {
        if target.image.dimensions() != (self.camera.width, self.camera.height) {
            let (w, h) = target.image.dimensions();
            let problem =
                format!("{w}x{h}, the templates are for {}x{}", self.camera.width, self.camera.height);
            return Err(Error::invalid("frame", problem, "make a finder for this camera"));
        }
        let mut found = Found::default();
        let mut candidates = Vec::new();
        let scanned = self.scanned(backend, target, priors, &mut found.stages)?;
        self.align(backend, aligner, target, &scanned, &mut candidates, &mut found.stages)?;
        self.judge(target, &mut candidates, &mut found);
        let is_clear = candidates.first().is_some_and(|(evidence, _)| evidence.is_clear());
        if !is_clear || found.best.as_ref().is_none_or(|best| self.is_vague(target.model, best)) {
            let matched = self.matched(target, priors, &mut found.stages);
            self.align(backend, aligner, target, &matched, &mut candidates, &mut found.stages)?;
            self.judge(target, &mut candidates, &mut found);
        }
        Ok(found)
    }
}

impl FindOptions {
    /// Refuses values out of range.
    pub(crate) fn check(&self) -> Result<()> {
        let refuse = |what: &str, problem: String, remedy: &str| Err(Error::invalid(what, problem, remedy));
        if let Some((near, far)) = self.distance
            && !(near > 0.0 && far >= near && far.is_finite())
        {
            return refuse("distance", format!("{near} to {far} m"), "give the nearest first, both positive");
        }
        if !(self.distance_ratio > 1.01 && self.distance_ratio < 2.0) {
            return refuse("ratio of distances", self.distance_ratio.to_string(), "use 1.01 to 2");
        }
        if !(self.density >= 0.1 && self.density <= 10.0) {
            return refuse("density of the grid", self.density.to_string(), "use 0.1 to 10");
        }
        if self.points < 8 || self.kept.contains(&0) {
            return refuse(
                "search",
                "too few points or hypotheses".into(),
                "use at least 8 points and 1 of each",
            );
        }
        Ok(())
    }
}
