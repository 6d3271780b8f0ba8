//! Tracked sequences and what may be said about them: errors, honesty of the covariance, distance from the bound.

use aam6d::align::{Options, to_ros_order};
use aam6d::eval::consistency::{NormalisedError, normalised_error_squared};
use aam6d::eval::{EvalObject, Evaluation};
use aam6d::geometry::Pose;
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{Sequence, SequenceOptions, View};
use aam6d::track::{Status, Tracked};
use nalgebra::{Matrix6, Point3, Vector6};
use rayon::prelude::*;

use super::tracking::{Disturbance, cpu, distance_px, judge, track, tracker_with};

/// Starts are this far off, pixels.
const START_PX: f64 = 1.0;

/// A sequence that was tracked.
pub(crate) struct Day {
    pub(crate) frames: Vec<usize>,
    pub(crate) tracked: Vec<Tracked>,
    pub(crate) evaluation: Evaluation,
    /// Normalised error squared of every believed frame.
    pub(crate) normalised: Vec<f64>,
}

/// Tracks some frames of a sequence in their order from a start 1 px off.
pub(crate) fn follow(sequence: &Sequence, model: &Model, frames: impl IntoIterator<Item = usize>) -> Day {
    follow_with(sequence, model, frames, Options::default())
}

/// As [`follow`], with chosen options of the method.
pub(crate) fn follow_with(
    sequence: &Sequence,
    model: &Model,
    frames: impl IntoIterator<Item = usize>,
    options: Options,
) -> Day {
    let frames: Vec<usize> = frames.into_iter().collect();
    let images: Vec<GrayImage> = frames.par_iter().map(|&k| sequence.image(k)).collect();
    let truth: Vec<Pose> = frames.iter().map(|&k| sequence.pose(k)).collect();
    let vertices = &sequence.object().mesh.vertices;
    let mut disturbance = Disturbance::new(5, *sequence.camera(), vertices, model.shape.centre);
    let begin = disturbance.apply(&truth[0], START_PX);
    let mut tracker = tracker_with(model, *sequence.camera(), cpu(), options);
    let tracked = track(&mut tracker, begin, &images);
    let evaluation = judge(sequence, &tracked, &truth);
    let believed = tracked.iter().zip(&truth).filter(|(t, _)| t.status == Status::Tracking);
    let normalised = believed.filter_map(|(t, truth)| normalised(model, t, truth)).collect();
    Day { frames, tracked, evaluation, normalised }
}

fn normalised(model: &Model, tracked: &Tracked, truth: &Pose) -> Option<f64> {
    let e = &tracked.estimate;
    let covariance = to_ros_order(&e.covariance, &e.camera_from_object, &model.shape.centre);
    normalised_error_squared(&e.camera_from_object, truth, &covariance)
}

impl Day {
    pub(crate) fn lost(&self) -> usize {
        self.evaluation.lost
    }

    /// Root mean square of the error: millimetres and degrees.
    pub(crate) fn rms(&self) -> [f64; 2] {
        [self.evaluation.rms_t_mm, self.evaluation.rms_r_deg].map(|v| v.unwrap_or(f64::INFINITY))
    }

    /// Median length of the translation error, millimetres.
    pub(crate) fn median_mm(&self, sequence: &Sequence) -> f64 {
        let centre = EvalObject::new(&sequence.object().mesh).expect("a mesh").centre();
        let error = |(t, k): (&Tracked, &usize)| {
            let at = |pose: &Pose| pose.transform_point(&centre);
            (at(&t.estimate.camera_from_object) - at(&sequence.pose(*k))).norm() * 1e3
        };
        let mut errors: Vec<f64> = self.tracked.iter().zip(&self.frames).map(error).collect();
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    }

    /// 95th percentile of the error of the box's corners, pixels.
    pub(crate) fn p95_px(&self) -> f64 {
        self.evaluation.corner_px.p95.unwrap_or(f64::INFINITY)
    }

    /// Mean normalised error squared; 6 for an honest covariance.
    pub(crate) fn consistency(&self) -> f64 {
        NormalisedError::of(&self.normalised).mean.unwrap_or(f64::INFINITY)
    }

    /// Root mean square errors in units of the bound: translation and rotation. The bound is taken at every `every`th
    /// frame.
    pub(crate) fn efficiency(&self, sequence: &Sequence, every: usize) -> [f64; 2] {
        let bounds: Vec<Matrix6<f64>> =
            self.frames.iter().step_by(every).map(|&k| bound(sequence, k)).collect();
        #[expect(clippy::cast_precision_loss, reason = "frame counts are small")]
        let mean = bounds.iter().sum::<Matrix6<f64>>() / bounds.len() as f64;
        let trace = |k: usize| mean.fixed_view::<3, 3>(k, k).trace().sqrt();
        let [mm, degrees] = self.rms();
        [mm / (trace(0) * 1e3), degrees / trace(3).to_degrees()]
    }
}

/// Half the distance of the two images of a difference quotient, pixels: large against their rounding, small against the
/// texture.
const STEP_PX: f64 = 0.5;

/// The Cramer-Rao bound of a frame: covariance of the best unbiased estimate of the pose increment `[t r]` (metres and
/// radians, object axes about the centre) by someone who knows the object's texture and the light exactly. From
/// differences of noise-free images over all pixels in which the object alone is seen.
pub(crate) fn bound(sequence: &Sequence, frame: usize) -> Matrix6<f64> {
    let view = View { noise: None, ..sequence.view(frame) };
    let renderer = sequence.renderer();
    let centre = EvalObject::new(&sequence.object().mesh).expect("a mesh").centre();
    let alone = View { occluder: None, ..view };
    let (seen, whole) = (renderer.render_view(&view), renderer.render_view(&alone));
    let slopes: Vec<Vec<f64>> = (0..6).map(|axis| slopes(sequence, &alone, &centre, axis)).collect();
    let inner = inner(&renderer.coverage(&view.pose), whole.width() as usize);
    let clear = |k: &usize| inner[*k] && seen.as_raw()[*k] == whole.as_raw()[*k];
    let mut information = Matrix6::zeros();
    for k in (0..inner.len()).filter(clear) {
        let row = Vector6::from_fn(|axis, _| slopes[axis][k]);
        information += row * row.transpose();
    }
    // Rounding to whole grey levels is noise, too.
    let variance = sequence.options().noise.powi(2) + 1.0 / 12.0;
    information.try_inverse().expect("the object is textured") * variance
}

/// Change of every pixel with the increment along one axis.
fn slopes(sequence: &Sequence, view: &View, centre: &Point3<f64>, axis: usize) -> Vec<f64> {
    let pose = |size: f64| {
        let mut d = Vector6::zeros();
        d[axis] = size;
        view.pose.compose(&Pose::increment(&d, centre))
    };
    let corners = EvalObject::new(&sequence.object().mesh).expect("a mesh").corners();
    let step = STEP_PX * 1e-4 / distance_px(sequence.camera(), &corners, &view.pose, &pose(1e-4));
    let [up, down] =
        [step, -step].map(|size| sequence.renderer().render_view(&View { pose: pose(size), ..*view }));
    let slope = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)) / (2.0 * step);
    up.iter().zip(down.iter()).map(slope).collect()
}

/// Pixels that the object covers with all their neighbours up to two pixels away.
fn inner(coverage: &[f64], width: usize) -> Vec<bool> {
    let full = |k: Option<usize>| k.and_then(|k| coverage.get(k)).is_some_and(|c| *c > 0.999);
    let near = |k: usize, along: usize| (0..5).all(|i| full((k + i * along).checked_sub(2 * along)));
    (0..coverage.len()).map(|k| near(k, 1) && near(k, width)).collect()
}
