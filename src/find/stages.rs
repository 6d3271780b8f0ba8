//! From the image to a few hypotheses: scan, then descents on finer and finer images.

use std::time::Instant;

use rayon::prelude::*;

use super::descent::{Settings, descend};
use super::hypotheses::{Hypothesis, best_distinct};
use super::map::Map;
use super::points::{surface_points, thinned};
use super::render::Rendering;
use super::{Finder, Priors, StageReport, grid, matching};
use crate::align::Target;
use crate::backend::{Backend, ScanRequest};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::imaging::keypoints::keypoints;
use crate::imaging::{NormalisedGradient, Pyramid};

/// So many tiles of a template are looked at.
const PEAKS_PER_TEMPLATE: usize = 3;
/// Hypotheses that end nearer than this to each other are one (rms of the corners, full-size pixels).
const SAME_PX: f64 = 8.0;

/// So many hypotheses of keypoints are looked at.
const MATCHED: usize = 48;

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

fn poses(hypotheses: &[Hypothesis]) -> Vec<Pose> {
    hypotheses.iter().map(|h| h.pose).collect()
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

    /// The hypotheses of the templates that are worth an alignment, best first.
    pub(super) fn scanned(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        priors: &Priors,
        reports: &mut Vec<StageReport>,
    ) -> Result<Vec<Hypothesis>> {
        let pyramid = Pyramid::new(target.image.clone(), self.level + 1);
        let began = Instant::now();
        let gradient = NormalisedGradient::new(pyramid.level(self.level));
        let (chosen, hypotheses) = self.scan(backend, &gradient, priors)?;
        reports.push(StageReport::new("scan", chosen, poses(&hypotheses), began));
        Ok(self.descended(target, &pyramid, &self.rounds(), hypotheses, reports))
    }

    /// The same of the keypoints, which what is hidden does not disturb.
    pub(super) fn matched(
        &self,
        target: &Target<'_>,
        priors: &Priors,
        reports: &mut Vec<StageReport>,
    ) -> Vec<Hypothesis> {
        let began = Instant::now();
        let grey: Vec<f32> = target.image.as_raw().iter().map(|g| f32::from(*g)).collect();
        let seen = keypoints(&grey, target.image.width() as usize);
        let mut hypotheses = matching::hypotheses(&self.known.landmarks, &seen, &self.camera, self.extent);
        hypotheses.retain(|h| self.allows_pose(priors, &h.pose));
        let hypotheses = best_distinct(hypotheses, target.model, &self.camera, SAME_PX, MATCHED);
        reports.push(StageReport::new("match", seen.len(), poses(&hypotheses), began));
        let pyramid = Pyramid::new(target.image.clone(), self.level + 1);
        self.descended(target, &pyramid, &self.rounds()[1..], hypotheses, reports)
    }

    fn descended(
        &self,
        target: &Target<'_>,
        pyramid: &Pyramid,
        rounds: &[Round],
        mut hypotheses: Vec<Hypothesis>,
        reports: &mut Vec<StageReport>,
    ) -> Vec<Hypothesis> {
        for round in rounds {
            let began = Instant::now();
            let count = hypotheses.len();
            let level = self.level.saturating_sub(round.finer);
            let map = Map::new(&NormalisedGradient::new(pyramid.level(level)));
            let ended = self.descend_each(&map, level, *round, &hypotheses);
            hypotheses = best_distinct(ended, target.model, &self.camera, SAME_PX, round.kept);
            reports.push(StageReport::new(round.name, count, poses(&hypotheses), began));
        }
        hypotheses
    }

    /// Number of templates that were scored, and the best positions of the best.
    fn scan(
        &self,
        backend: &mut dyn Backend,
        gradient: &NormalisedGradient,
        priors: &Priors,
    ) -> Result<(usize, Vec<Hypothesis>)> {
        let chosen = self.allowed(priors);
        let request = ScanRequest { image: gradient, templates: &self.known.templates.scan, chosen: &chosen };
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
            let pose = &self.known.templates.poses[template as usize];
            let pose =
                grid::moved_to(&camera, pose, &self.known.templates.centre, f64::from(u), f64::from(v));
            Hypothesis { pose, agreement: f64::from(score) }
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
            let pose = &self.known.templates.poses[t];
            let distance = pose.transform_point(&self.known.templates.centre).z;
            priors.allow_view(pose, distance, self.known.templates.radius[t] * factor, step)
        };
        (0..u32::try_from(self.known.templates.poses.len()).unwrap_or(u32::MAX)).filter(allowed).collect()
    }

    /// May the object be there? As the priors and the range of distances have it.
    fn allows_pose(&self, priors: &Priors, pose: &Pose) -> bool {
        let centre = pose.transform_point(&self.known.templates.centre);
        let Some(at) = self.camera.project(&centre) else { return false };
        let distance = centre.coords.norm();
        let radius = self.extent * self.camera.fx / distance;
        let step = self.options.distance_ratio.sqrt();
        let range = Priors { distance: self.options.distance, ..Priors::default() };
        [priors, &range].into_iter().all(|p| {
            p.allow_view(pose, distance, radius, step) && p.allow_position(0, &self.camera, at.x, at.y)
        })
    }

    fn descend_each(
        &self,
        map: &Map,
        level: usize,
        round: Round,
        hypotheses: &[Hypothesis],
    ) -> Vec<Hypothesis> {
        let camera = self.camera.at_level(level);
        let centre = &self.known.templates.centre;
        let one = |picture: &mut Rendering, h: &Hypothesis| {
            picture.render(&self.atlas, &camera, &h.pose);
            let points = surface_points(picture, &camera, &h.pose);
            #[expect(clippy::cast_precision_loss, reason = "point counts are small")]
            let size = points.len().max(1) as f64;
            let (points, share) = thinned(points, round.points);
            let ended = descend(&points, map, &camera, &h.pose, centre, round.settings);
            // As if all points had been used, and less than their number would justify.
            let agreement = ended.agreement * f64::from(share).sqrt() * size.powf(-FAVOUR);
            Hypothesis { pose: ended.pose, agreement }
        };
        hypotheses.par_iter().map_init(Rendering::default, one).collect()
    }
}
