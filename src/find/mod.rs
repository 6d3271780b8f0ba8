//! The first pose: the object is looked for in one image, without a pose to start from.
//!
//! Sparse templates of the model, rendered from its charts at a grid of poses, are scored at every position of the
//! image at an eighth of its size (stage `scan`); the best are refined and ranked on finer and finer images, the few
//! that are left aligned in full and judged by their score. All comparisons before the alignment are of the
//! soft-normalised gradient, which light hardly changes and which bounds the influence of every pixel.
//! `docs/maths.md`, "First pose".

mod atlas;
mod cache;
mod descent;
mod grid;
mod hypotheses;
mod map;
mod points;
mod priors;
mod render;
mod stages;
mod templates;

use std::path::Path;
use std::time::Instant;

use crate::align::{Aligner, PoseEstimate, Start, Target};
use crate::backend::Backend;
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose, Symmetries};
use crate::model::Model;
use atlas::Atlas;
use hypotheses::Hypothesis;
use templates::Templates;

pub use priors::Priors;

/// Sides of the image that is scanned are at most this long, pixels.
const SCAN_SIDE: u32 = 120;
/// A found pose has at least this median correlation.
const FOUND_CORRELATION: f64 = 0.8;
/// A pose of which a part is hidden is found if this share of its triangles is recognised,
const FOUND_SHARE: f64 = 0.48;
/// has this median correlation,
const HIDDEN_CORRELATION: f64 = 0.6;
/// and its edges are this much like those of the image (1: the same, 0: unrelated).
const FOUND_LIKENESS: f64 = 0.4;
/// Another pose is an ambiguity from this share of the best one's agreement on.
const AMBIGUOUS_SHARE: f64 = 0.75;
/// Poses whose corners are this far apart (rms, pixels) are different ones.
const DIFFERENT_PX: f64 = 20.0;

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

/// Finds one object in images of one camera.
#[derive(Debug)]
pub struct Finder {
    atlas: Atlas,
    camera: Camera,
    options: FindOptions,
    templates: Templates,
    level: usize,
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
                Ok(Some(templates)) => return Ok(templates),
                Ok(None) => {}
                Err(error) => tracing::warn!("{error}; templates are rendered anew"),
            }
            let templates = render();
            if let Err(error) = cache::save(path, &key, &templates) {
                tracing::warn!("{error}; templates will be rendered again");
            }
            Ok(templates)
        })
    }

    /// `get` has the camera of the scanned image and renders if it must.
    fn of(
        model: &Model,
        camera: &Camera,
        options: &FindOptions,
        get: impl FnOnce(&Camera, &dyn Fn() -> Templates) -> Result<Templates>,
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
        let templates = get(&scanned, &|| Templates::render(model, &atlas, &scanned, options))?;
        if templates.poses.is_empty() {
            let problem = "no pose in which the model knows most of what is seen";
            return Err(Error::invalid("model", problem, "train it with views of the sides to be found"));
        }
        Ok(Self { atlas, camera: *camera, options: options.clone(), templates, level })
    }

    /// Number of templates.
    pub fn templates(&self) -> usize {
        self.templates.poses.len()
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
        let hypotheses = self.hypotheses(backend, target, priors, &mut found.stages)?;
        let began = Instant::now();
        let starts: Vec<Start> = hypotheses
            .iter()
            .map(|h| Start { camera_from_object: h.pose, appearance: vec![0.0; target.model.modes()] })
            .collect();
        let mut estimates = Vec::new();
        aligner.refine(backend, target, &starts, &mut estimates)?;
        // What is not hidden reaches farther from coarser levels.
        if !estimates.iter().any(is_whole) {
            let mut aligned = Vec::new();
            aligner.align(backend, target, &starts, &mut aligned)?;
            estimates.extend(aligned);
        }
        self.judge(target, estimates, &mut found);
        let believed = found.best.iter().chain(&found.others);
        let kept = believed.map(|e| e.camera_from_object).collect();
        found.stages.push(StageReport {
            stage: "align",
            hypotheses: hypotheses.len(),
            kept,
            time_ms: began.elapsed().as_secs_f64() * 1e3,
        });
        Ok(found)
    }

    /// Who is believed, and who is the best of them: the one with most agreement over the whole object. The correlation
    /// is a median, which a pose reaches as well that shows one face of a box where it is and the others elsewhere.
    fn judge(&self, target: &Target<'_>, estimates: Vec<PoseEstimate>, found: &mut Found) {
        let looks = self.looks(target, &estimates);
        let mut ranked: Vec<(Hypothesis, PoseEstimate)> = looks.into_iter().zip(estimates).collect();
        ranked.sort_by(|a, b| b.0.agreement.total_cmp(&a.0.agreement));
        let (believed, rejected): (Vec<_>, Vec<_>) =
            ranked.into_iter().partition(|(look, e)| is_found(e, look.likeness));
        let most = believed.first().map_or(0.0, |(look, _)| look.agreement);
        let mut believed = believed.into_iter();
        found.best = believed.next().map(|(_, e)| e);
        for (_, estimate) in believed.filter(|(look, _)| look.agreement >= AMBIGUOUS_SHARE * most) {
            let known = found.best.iter().chain(&found.others);
            if known.into_iter().all(|e| self.differ(target.model, e, &estimate)) {
                found.others.push(estimate);
            }
        }
        if found.best.is_none() {
            found.rejected = rejected.into_iter().map(|(_, e)| e).next();
        }
    }

    fn differ(&self, model: &Model, a: &PoseEstimate, b: &PoseEstimate) -> bool {
        let project = |pose: &Pose| hypotheses::corners(model, &self.camera, pose);
        let seen = project(&a.camera_from_object);
        let same = |motion: &Pose| {
            hypotheses::distance_px(&seen, &project(&b.camera_from_object.compose(motion))) <= DIFFERENT_PX
        };
        !self.options.symmetries.motions().iter().any(same)
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

/// Is the object where the estimate says? Where a part of it is hidden the median correlation is low, but the rest must
/// be recognised, and edges of the whole must be where they should be.
fn is_found(estimate: &PoseEstimate, likeness: f64) -> bool {
    let score = &estimate.score;
    let hidden = score.correlation >= HIDDEN_CORRELATION && score.recognised >= FOUND_SHARE;
    is_whole(estimate) || (hidden && likeness >= FOUND_LIKENESS)
}

/// Is it found with nothing of importance hidden?
fn is_whole(estimate: &PoseEstimate) -> bool {
    !estimate.score.is_lost() && estimate.score.correlation >= FOUND_CORRELATION
}
