//! Smoothed poses beside the tracked ones: a Kalman filter with constant velocity, and, where a pose may come a few frames
//! late, what those frames say about it.

mod filter;

use std::collections::VecDeque;

use nalgebra::{Matrix6, Point3, Vector6};

use super::Tracked;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::model::Model;
use filter::{Belief, Matrix12, Measurement};

/// What is known of the speed before the first motion, metres per second.
const SPEED: f64 = 1.0;
/// Density of the acceleration (m^2/s^3) at first, that of an object at rest: what moves is a surprise; and its limits.
const DENSITY: f64 = 1e-8;
const DENSITY_LIMITS: (f64, f64) = (1e-12, 1e6);
/// How fast the density follows what the frames say.
const ADAPTION: f64 = 0.3;
/// A squared innovation (6 expected) that one frame in a thousand exceeds if the motion is as assumed: then it is not.
const SURPRISE: f64 = 22.5;
/// The density is raised by this until a frame is no surprise any more.
const RAISE: f64 = 10.0;
/// Where the covariance of a pose is not known: standard deviation of the centre over the object's radius; it is never taken
/// to be less than a hundredth of this.
const UNKNOWN: f64 = 1e-3;

/// A pose after smoothing.
#[derive(Debug, Clone, PartialEq)]
pub struct Smoothed {
    /// Time of its frame, seconds.
    pub time_s: f64,
    /// `camera_from_object`, metres.
    pub camera_from_object: Pose,
    /// `[v, omega]` of the object's centre and rotation in the camera frame, metres and radians per second.
    pub velocity: Vector6<f64>,
    /// As that of [`crate::align::PoseEstimate`]: object axes about the centre, `[tx ty tz rx ry rz]`, metres and radians.
    pub covariance: Matrix6<f64>,
}

/// Smooths the poses of one object; equations are in `docs/maths.md`, "Smoothing". How much it smooths follows from the
/// covariance of the poses and from how surprising they are: there is nothing to tune.
#[derive(Debug, Clone)]
pub struct Smoother {
    centre: Point3<f64>,
    radius: f64,
    lag: usize,
    density: f64,
    /// The last frames, the oldest first.
    steps: VecDeque<Step>,
}

/// A frame: what was expected and what came of it.
#[derive(Debug, Clone)]
struct Step {
    time_s: f64,
    belief: Belief,
    /// The prediction and how the error came into it; `None` in the first frame after a gap.
    from: Option<(Belief, Matrix12)>,
}

impl Smoother {
    /// Poses of the object of a model come out `lag_frames` frames late: 0 is the filter alone.
    pub fn new(model: &Model, lag_frames: usize) -> Self {
        let centre = model.shape.centre;
        let squares: f64 = model.shape.corners.iter().map(|x| (x - centre).norm_squared()).sum();
        Self::about(centre, (squares / 8.0).sqrt(), lag_frames)
    }

    fn about(centre: Point3<f64>, radius: f64, lag: usize) -> Self {
        Self { centre, radius, lag, density: DENSITY, steps: VecDeque::with_capacity(lag + 1) }
    }

    /// Takes the next frame and returns the poses that are ready, in the order of their frames. A frame without a pose ends
    /// what waits: nothing is made up for it, and the next pose begins anew.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a time that is not later than the last one, or is not a number.
    pub fn push(&mut self, time_s: f64, tracked: &Tracked) -> Result<Vec<Smoothed>> {
        if !tracked.status.has_pose() {
            return Ok(self.finish());
        }
        let e = &tracked.estimate;
        let seen = Measurement::new(&e.camera_from_object, &self.covariance(&e.covariance), &self.centre);
        let step = match self.steps.back() {
            Some(last) => {
                let dt = time_s - last.time_s;
                // Written so that NaN is refused.
                if !(dt > 0.0 && dt.is_finite()) {
                    let problem = format!("{time_s} s after {} s", last.time_s);
                    return Err(Error::invalid("time of a frame", problem, "give frames in their order"));
                }
                let last = last.belief.clone();
                self.follow(&last, dt, time_s, &seen)
            }
            None => Step { time_s, belief: Belief::first(&seen, SPEED, self.radius), from: None },
        };
        if self.is_first_given() {
            self.steps.pop_front();
        }
        self.steps.push_back(step);
        Ok(self.is_first_given().then(|| self.hindsight(0)).into_iter().collect())
    }

    /// Enough later frames have come for the oldest one to be given out; it is kept until the next comes.
    fn is_first_given(&self) -> bool {
        self.steps.len() > self.lag
    }

    /// The poses that still wait, at the end of a sequence; what comes next begins anew.
    pub fn finish(&mut self) -> Vec<Smoothed> {
        let given = usize::from(self.is_first_given());
        let out = (given..self.steps.len()).map(|k| self.hindsight(k)).collect();
        self.steps.clear();
        out
    }

    fn covariance(&self, covariance: &Matrix6<f64>) -> Matrix6<f64> {
        let known = covariance.diagonal().min() > 0.0;
        let sigma = UNKNOWN * if known { 0.01 } else { 1.0 };
        let mut floor = Matrix6::zeros();
        for k in 0..3 {
            floor[(k, k)] = (sigma * self.radius).powi(2);
            floor[(k + 3, k + 3)] = sigma * sigma;
        }
        if known { covariance + floor } else { floor }
    }

    /// The next frame. Where it is a surprise, the object moves less steadily than was assumed: the density is raised until it
    /// is not; so a sudden motion is not smoothed away.
    fn follow(&mut self, last: &Belief, dt: f64, time_s: f64, seen: &Measurement) -> Step {
        loop {
            let (predicted, transition) = last.predicted(dt, self.density, self.radius);
            let Some((belief, surprise)) = predicted.updated(seen) else {
                return Step { time_s, belief: Belief::first(seen, SPEED, self.radius), from: None };
            };
            if surprise > SURPRISE && self.density < DENSITY_LIMITS.1 {
                self.density *= RAISE;
                continue;
            }
            let change = (ADAPTION * (surprise / 6.0 - 1.0)).exp();
            self.density = (self.density * change).clamp(DENSITY_LIMITS.0, DENSITY_LIMITS.1);
            return Step { time_s, belief, from: Some((predicted, transition)) };
        }
    }

    /// A waiting frame with what all later ones say about it.
    fn hindsight(&self, index: usize) -> Smoothed {
        let mut better = self.steps[self.steps.len() - 1].belief.clone();
        for k in (index..self.steps.len() - 1).rev() {
            let (step, next) = (&self.steps[k], &self.steps[k + 1]);
            let back = next.from.as_ref().and_then(|(p, f)| step.belief.hindsight(f, p, &better));
            better = back.unwrap_or_else(|| step.belief.clone());
        }
        let (v, w) = (better.velocity, better.turning);
        Smoothed {
            time_s: self.steps[index].time_s,
            camera_from_object: better.pose(&self.centre),
            velocity: Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z),
            covariance: better.pose_covariance(),
        }
    }
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
