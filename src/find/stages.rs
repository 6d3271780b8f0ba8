//! From the image to a few hypotheses: scan, then descents on finer and finer images.

use std::time::Instant;

use rayon::prelude::*;

use super::descent::{Settings, descend};
use super::hypotheses::{Hypothesis, best_distinct};
use super::map::Map;
use super::points::{surface_points, thinned};
use super::render::Rendering;
use super::{Finder, Priors, StageReport, grid};
use crate::align::{PoseEstimate, Target};
use crate::backend::{Backend, ScanRequest};
use crate::error::{Error, Result};
use crate::imaging::{NormalisedGradient, Pyramid};

/// So many tiles of a template are looked at.
const PEAKS_PER_TEMPLATE: usize = 3;
/// Hypotheses that end nearer than this to each other are one (rms of the corners, full-size pixels).
const SAME_PX: f64 = 8.0;

/// Hypotheses are ranked by z N^-this for N pixels: neighbouring pixels are no independent witnesses, and z alone favours
/// what would be near.
const FAVOUR: f64 = 0.2;

/// One round of descents.
#[derive(Debug, Clone, Copy)]
struct Round {
    name: &'static str,
    /// Levels above the scanned one.
    finer: usize,
    points: usize,
    settings: Settings,
    kept: usize,
}

impl Finder {
    fn rounds(&self) -> [Round; 4] {
        let [_, second, third] = self.options.kept;
        let robust = |iterations| Settings { iterations, scale: 0.7 };
        let plain = Settings { iterations: 8, scale: f32::INFINITY };
        let round = |name, finer, points, settings, kept| Round { name, finer, points, settings, kept };
        [
            round("coarse", 0, 250, plain, second),
            round("middle", 1, 500, robust(12), 4 * third),
            round("fine", 1, 1500, robust(8), 2 * third),
            round("finest", 2, 2000, robust(8), third),
        ]
    }

    /// The hypotheses that are worth an alignment, best first.
    pub(super) fn hypotheses(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        priors: &Priors,
        reports: &mut Vec<StageReport>,
    ) -> Result<Vec<Hypothesis>> {
        let pyramid = Pyramid::new(target.image.clone(), self.level + 1);
        let began = Instant::now();
        let gradient = NormalisedGradient::new(pyramid.level(self.level));
        let (chosen, mut hypotheses) = self.scan(backend, &gradient, priors)?;
        reports.push(StageReport {
            stage: "scan",
            hypotheses: chosen,
            kept: hypotheses.iter().map(|h| h.pose).collect(),
            time_ms: began.elapsed().as_secs_f64() * 1e3,
        });
        for round in self.rounds() {
            let began = Instant::now();
            let count = hypotheses.len();
            let level = self.level.saturating_sub(round.finer);
            let map = Map::new(&NormalisedGradient::new(pyramid.level(level)));
            let ended = self.descend_each(&map, level, round, &hypotheses);
            hypotheses = best_distinct(ended, target.model, &self.camera, SAME_PX, round.kept);
            reports.push(StageReport {
                stage: round.name,
                hypotheses: count,
                kept: hypotheses.iter().map(|h| h.pose).collect(),
                time_ms: began.elapsed().as_secs_f64() * 1e3,
            });
        }
        Ok(hypotheses)
    }

    /// Number of templates that were scored, and the best positions of the best.
    fn scan(
        &self,
        backend: &mut dyn Backend,
        gradient: &NormalisedGradient,
        priors: &Priors,
    ) -> Result<(usize, Vec<Hypothesis>)> {
        let chosen = self.allowed(priors);
        let request = ScanRequest { image: gradient, templates: &self.templates.scan, chosen: &chosen };
        let mut peaks = Vec::new();
        backend.scan(&request, &mut peaks)?;
        let tiles: usize = request.tiles().iter().product();
        let mut best: Vec<(f32, u32, [u16; 2])> = Vec::new();
        for (template, peaks) in chosen.iter().zip(peaks.chunks_exact_mut(tiles)) {
            peaks.sort_by(|a, b| b.score.total_cmp(&a.score));
            let allowed = peaks.iter().filter(|p| {
                let [u, v] = p.position.map(f64::from);
                priors.allow_position(self.level, &self.camera, u, v)
            });
            best.extend(allowed.take(PEAKS_PER_TEMPLATE).map(|p| (p.score, *template, p.position)));
        }
        best.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        best.truncate(self.options.kept[0]);
        if best.is_empty() {
            let problem = "no pose is left by what is known beforehand";
            return Err(Error::invalid("search", problem, "give a larger box or range of distances"));
        }
        let camera = self.camera.at_level(self.level);
        let hypothesis = |(score, template, [u, v]): (f32, u32, [u16; 2])| {
            let pose = &self.templates.poses[template as usize];
            let pose = grid::moved_to(&camera, pose, &self.templates.centre, f64::from(u), f64::from(v));
            Hypothesis { pose, agreement: f64::from(score), likeness: 0.0 }
        };
        Ok((chosen.len(), best.into_iter().map(hypothesis).collect()))
    }

    /// The templates that the priors allow.
    pub(super) fn allowed(&self, priors: &Priors) -> Vec<u32> {
        let step = self.options.distance_ratio.sqrt();
        #[expect(clippy::cast_precision_loss, reason = "a small power of two")]
        let factor = (1_u64 << self.level) as f64;
        let allowed = |t: &u32| {
            let t = *t as usize;
            let pose = &self.templates.poses[t];
            let distance = pose.transform_point(&self.templates.centre).z;
            priors.allow_view(pose, distance, self.templates.radius[t] * factor, step)
        };
        (0..u32::try_from(self.templates.poses.len()).unwrap_or(u32::MAX)).filter(allowed).collect()
    }

    /// How well estimates agree with the image at the finest level of the descents, over all pixels.
    pub(super) fn looks(&self, target: &Target<'_>, estimates: &[PoseEstimate]) -> Vec<Hypothesis> {
        let level = self.level.saturating_sub(1);
        let pyramid = Pyramid::new(target.image.clone(), level + 1);
        let map = Map::new(&NormalisedGradient::new(pyramid.level(level)));
        let looks = Settings { iterations: 0, scale: f32::INFINITY };
        let round = Round { name: "judge", finer: 1, points: usize::MAX, settings: looks, kept: 0 };
        let at = |e: &PoseEstimate| Hypothesis { pose: e.camera_from_object, agreement: 0.0, likeness: 0.0 };
        let hypotheses: Vec<Hypothesis> = estimates.iter().map(at).collect();
        self.descend_each(&map, level, round, &hypotheses)
    }

    fn descend_each(
        &self,
        map: &Map,
        level: usize,
        round: Round,
        hypotheses: &[Hypothesis],
    ) -> Vec<Hypothesis> {
        let camera = self.camera.at_level(level);
        let centre = &self.templates.centre;
        let one = |picture: &mut Rendering, h: &Hypothesis| {
            picture.render(&self.atlas, &camera, &h.pose);
            let points = surface_points(picture, &camera, &h.pose);
            #[expect(clippy::cast_precision_loss, reason = "point counts are small")]
            let size = points.len().max(1) as f64;
            let (points, share) = thinned(points, round.points);
            let ended = descend(&points, map, &camera, &h.pose, centre, round.settings);
            // As if all points had been used, and less than their number would justify.
            let agreement = ended.agreement * f64::from(share).sqrt() * size.powf(-FAVOUR);
            Hypothesis { pose: ended.pose, agreement, likeness: ended.likeness }
        };
        hypotheses.par_iter().map_init(Rendering::default, one).collect()
    }
}
