//! Hypotheses from keypoints: each pair of an image's keypoint and one of the object says a pose by itself, and pairs that
//! agree say a better one. Local, so that what is hidden does no harm.

use nalgebra::{Point2, Point3, Rotation3, Vector3};
use rayon::prelude::*;

use super::hypotheses::Hypothesis;
use super::landmarks::{Landmark, Landmarks};
use crate::geometry::{Camera, Pose, pnp};
use crate::imaging::keypoints::Keypoint;

/// A pair counts if it is nearer than this share of the distance to the next place of the object that looks like it.
const RATIO: f64 = 0.95;
/// So many pairs at most, the clearest.
const PAIRS: usize = 200;
/// Places nearer than this share of the object's extent are one.
const SAME_PLACE: f64 = 0.05;
/// A pose of a single pair is off by this share of the distance from it in the image, and some pixels.
const FIRST_SHARE: f64 = 0.2;
const FIRST_PX: f64 = 4.0;
/// How near points must be for the next pose, pixels.
const TOLERANCES_PX: [f64; 3] = [12.0, 6.0, 4.0];
/// A pose is fitted to at least so many places.
const LEAST: usize = 4;
/// So many poses are fitted: those of single pairs with most that agree.
const FITTED: usize = 60;

/// A keypoint of the image and what it may be.
#[derive(Debug, Clone)]
struct Pair<'a> {
    keypoint: &'a Keypoint,
    landmark: &'a Landmark,
    ratio: f64,
}

impl Pair<'_> {
    fn point(&self) -> Point3<f64> {
        Point3::from(self.landmark.position)
    }

    fn pixel(&self) -> Point2<f64> {
        Point2::from(self.keypoint.position)
    }

    /// Distance of the object's point from the keypoint, pixels.
    fn off(&self, camera: &Camera, pose: &Pose) -> f64 {
        camera
            .project(&pose.transform_point(&self.point()))
            .map_or(f64::INFINITY, |p| (p - self.pixel()).norm())
    }

    /// The pose in which the object looks here as in the landmark's picture, but for size and roll.
    fn pose(&self, camera: &Camera, views: &[Pose]) -> Option<Pose> {
        let view = views.get(self.landmark.view as usize)?;
        let then = view.transform_point(&self.point()).coords;
        let ray = camera.ray(&self.pixel())?.normalize();
        let roll = Rotation3::from_axis_angle(&Vector3::z_axis(), self.keypoint.angle - self.landmark.angle);
        let from = Rotation3::rotation_between(&then, &Vector3::z())?;
        let to = Rotation3::rotation_between(&Vector3::z(), &ray)?;
        let rotation = to * roll * from * Rotation3::from_matrix_unchecked(view.rotation());
        let distance = then.norm() * self.landmark.scale / self.keypoint.scale;
        Some(Pose::new(rotation, ray * distance - rotation * self.point().coords))
    }
}

/// Poses, those with most pairs that agree first; `agreement` is their number. `extent` is the object's (rms, metres).
pub(super) fn hypotheses(
    landmarks: &Landmarks,
    keypoints: &[Keypoint],
    camera: &Camera,
    extent: f64,
) -> Vec<Hypothesis> {
    let mut pairs: Vec<Pair<'_>> =
        keypoints.par_iter().filter_map(|k| best_pair(k, landmarks, SAME_PLACE * extent)).collect();
    pairs.retain(|p| p.ratio < RATIO);
    pairs.sort_by(|a, b| a.ratio.total_cmp(&b.ratio));
    pairs.truncate(PAIRS);
    let single = |p: &Pair<'_>| {
        let pose = p.pose(camera, &landmarks.views)?;
        let agree =
            |q: &&Pair<'_>| q.off(camera, &pose) < FIRST_PX + FIRST_SHARE * (q.pixel() - p.pixel()).norm();
        let agreeing: Vec<&Pair<'_>> = pairs.iter().filter(agree).collect();
        Some((places(&agreeing), pose, agreeing))
    };
    let mut singles: Vec<_> = pairs.par_iter().filter_map(single).collect();
    singles.sort_by_key(|(count, ..)| std::cmp::Reverse(*count));
    let (first, rest) = singles.split_at(FITTED.min(singles.len()));
    let mut all: Vec<Hypothesis> = first
        .par_iter()
        .map(|(count, pose, agreeing)| fitted(&pairs, agreeing, camera, pose, *count))
        .collect();
    all.extend(rest.iter().map(|(count, pose, _)| hypothesis(*pose, *count)));
    all.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
    all
}

fn hypothesis(pose: Pose, count: usize) -> Hypothesis {
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    let agreement = count as f64;
    Hypothesis { pose, agreement }
}

/// The landmark that looks most like a keypoint, and how much more so than other places of the object.
fn best_pair<'a>(keypoint: &'a Keypoint, landmarks: &'a Landmarks, apart: f64) -> Option<Pair<'a>> {
    let distance = |d: &[i16]| {
        let terms = d.iter().zip(&keypoint.description).map(|(a, b)| i32::from(a - b) * i32::from(a - b));
        terms.sum::<i32>()
    };
    let all: Vec<(i32, &Landmark)> = landmarks.iter().map(|(l, d)| (distance(d), l)).collect();
    let (nearest, landmark) = all.iter().min_by_key(|(d, _)| *d)?;
    let at = Point3::from(landmark.position);
    let elsewhere = all.iter().filter(|(_, l)| (Point3::from(l.position) - at).norm() > apart);
    let next = elsewhere.map(|(d, _)| *d).min()?;
    let ratio = (f64::from(*nearest) / f64::from(next.max(1))).sqrt();
    Some(Pair { keypoint, landmark, ratio })
}

/// Number of different places in the image: one with two directions counts once.
fn places(pairs: &[&Pair<'_>]) -> usize {
    let mut seen: Vec<[f64; 2]> = pairs.iter().map(|p| p.keypoint.position).collect();
    seen.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    seen.dedup();
    seen.len()
}

/// Fits the pose to those who agree, and asks all again, with less tolerance each time.
fn fitted(
    pairs: &[Pair<'_>],
    agreeing: &[&Pair<'_>],
    camera: &Camera,
    start: &Pose,
    count: usize,
) -> Hypothesis {
    let mut best = hypothesis(*start, count.min(LEAST - 1));
    let mut agreeing = agreeing.to_vec();
    for tolerance in TOLERANCES_PX {
        if places(&agreeing) < LEAST {
            break;
        }
        let points: Vec<_> = agreeing.iter().map(|p| p.point()).collect();
        let pixels: Vec<_> = agreeing.iter().map(|p| p.pixel()).collect();
        let Some(pose) = pnp::refined(camera, &points, &pixels, best.pose) else { break };
        agreeing = pairs.iter().filter(|p| p.off(camera, &pose) < tolerance).collect();
        best = hypothesis(pose, places(&agreeing));
    }
    best
}
