//! The geometric method, reference [19] of the paper: edge points of the model are searched along their normals in the
//! frame, and the pose follows by robust Gauss-Newton (`docs/maths.md`, "Edges").

mod points;
mod search;

use image::GrayImage;
use nalgebra::{Matrix6, RowVector6, Vector6};

use super::evaluator::{Evaluation, Evaluator, Sight, check, levels_for_scores, score, tracked_levels};
use super::levenberg_marquardt::State;
use super::normal_equations::{LevelProblem, Rows, cost};
use super::robust::{median, triangle_weights};
use super::visibility::visibility;
use super::workspace::Scratch;
use super::{Aligner, PoseEstimate, Start, Target};
use crate::backend::{Backend, ModelId};
use crate::error::{Error, Result};
use crate::geometry::warp::increment_jacobian;
use crate::geometry::{Camera, Pose};
use crate::imaging::Pyramid;
use crate::model::{Grouping, Model};
use points::{EdgePoint, border_points, template_edges};
use search::Line;

/// Tukey's constant for 95 % efficiency.
const TUKEY: f64 = 4.685;
/// Residuals below this are what a search can do, pixels.
const MIN_SCALE_PX: f64 = 0.1;
/// Fewer found edge points than this leave the pose as it is.
const MIN_POINTS: usize = 12;

/// Choices of the method.
#[derive(Debug, Clone, PartialEq)]
pub struct EdgeOptions {
    /// Edge points of the template per level, at most.
    pub template_points: usize,
    /// Points on the borders of the faces, about.
    pub border_points: usize,
    /// Gauss-Newton steps per level at most, each with a new search.
    pub max_iterations: usize,
    /// How far to search to each side, pixels of the level; the last entry also serves all coarser levels.
    pub reach_px: Vec<usize>,
    /// A level ends when a step moves the edge points by less (rms, pixels of the level); the last entry also serves
    /// all coarser levels.
    pub stop_px: Vec<f64>,
}

impl Default for EdgeOptions {
    fn default() -> Self {
        Self {
            template_points: 400,
            border_points: 100,
            max_iterations: 10,
            reach_px: vec![3, 3, 4],
            stop_px: vec![0.01, 0.02, 0.05],
        }
    }
}

/// Robust alignment of edges, coarse to fine.
#[derive(Debug, Clone, Default)]
pub struct Edge {
    /// Choices.
    pub options: EdgeOptions,
    /// Edge points per level, once prepared.
    levels: Vec<Vec<EdgePoint>>,
}

/// One point found in the frame: residual e = n (found - expected), and its derivative de/dd = n^T D.
struct Found {
    residual: f64,
    row: RowVector6<f64>,
    /// D^T D.
    metric: Matrix6<f64>,
}

/// The weighted system of one step.
struct Normal {
    hessian: Matrix6<f64>,
    gradient: Vector6<f64>,
    /// Weighted mean square residual, square pixels.
    variance: f64,
    metric: Matrix6<f64>,
}

/// Tukey's weight of a residual `z` times the cut-off.
fn tukey(z: f64) -> f64 {
    if z.abs() < 1.0 { (1.0 - z * z).powi(2) } else { 0.0 }
}

impl Normal {
    /// `None` if too few points were found.
    fn new(found: &[Found]) -> Option<Self> {
        if found.len() < MIN_POINTS {
            return None;
        }
        let scale = 1.4826 * median(&mut found.iter().map(|f| f.residual.abs()).collect::<Vec<_>>());
        let cut = TUKEY * scale.max(MIN_SCALE_PX);
        let zero = Matrix6::zeros();
        let mut sum = Self { hessian: zero, gradient: Vector6::zeros(), variance: 0.0, metric: zero };
        let (mut weights, mut count) = (0.0, 0.0);
        for f in found {
            let w = tukey(f.residual / cut);
            sum.hessian += w * f.row.transpose() * f.row;
            sum.gradient += w * f.residual * f.row.transpose();
            sum.variance += w * f.residual * f.residual;
            sum.metric += f.metric;
            weights += w;
            count += 1.0;
        }
        sum.variance /= f64::max(weights, f64::MIN_POSITIVE);
        sum.metric /= count;
        Some(sum)
    }

    /// Inverse of the system with columns of unit length; `None` if the points do not fix the pose.
    fn inverse(&self) -> Option<Matrix6<f64>> {
        let diagonal = self.hessian.diagonal();
        if diagonal.iter().any(|d| *d <= 0.0) {
            return None;
        }
        let scale = Matrix6::from_diagonal(&diagonal.map(|d| 1.0 / d.sqrt()));
        (scale * self.hessian * scale).cholesky().map(|c| scale * c.inverse() * scale)
    }
}

/// A pose on its way through the levels.
struct Descent {
    pose: Pose,
    iterations: usize,
    converged: bool,
    hessian: Matrix6<f64>,
    covariance: Matrix6<f64>,
}

impl Edge {
    /// The method with the given choices.
    pub fn new(options: EdgeOptions) -> Self {
        Self { options, levels: Vec::new() }
    }

    fn level(&self, target: &Target<'_>, image: &GrayImage, level: usize, at: &mut Descent) {
        let (options, centre) = (&self.options, target.model.shape.centre);
        let camera = target.camera.at_level(level);
        let reach = options.reach_px.get(level).or(options.reach_px.last()).copied().unwrap_or(3);
        let stop = options.stop_px.get(level).or(options.stop_px.last()).copied().unwrap_or(0.01);
        let visibility = visibility(target, &at.pose);
        let visible: Vec<&EdgePoint> =
            self.levels[level].iter().filter(|p| visibility[p.triangle] > 0.0).collect();
        for _ in 0..options.max_iterations {
            let look = |p: &&EdgePoint| look(p, &camera, &at.pose, image, reach, target);
            let found: Vec<Found> = visible.iter().filter_map(look).collect();
            let solved = Normal::new(&found).and_then(|n| n.inverse().map(|inverse| (n, inverse)));
            let Some((normal, inverse)) = solved else {
                (at.converged, at.hessian, at.covariance) = (false, Matrix6::zeros(), Matrix6::zeros());
                return;
            };
            let step = inverse * normal.gradient;
            at.pose = at.pose.compose(&Pose::increment(&step, &centre));
            at.iterations += 1;
            (at.hessian, at.covariance) = (normal.hessian, inverse * normal.variance);
            if step.dot(&(normal.metric * step)).max(0.0).sqrt() < stop {
                return;
            }
        }
        at.converged = false;
    }

    /// The estimate: the pose from the edges, score and residual from the template, as for the other methods.
    fn finish(
        backend: &mut dyn Backend,
        target: &Target<'_>,
        start: &Start,
        end: &Descent,
    ) -> Result<PoseEstimate> {
        let problem = LevelProblem::new(target, 0, Grouping::Triangle);
        let state = State { pose: end.pose, appearance: start.appearance.clone() };
        let visibility = visibility(target, &end.pose);
        let (mut evaluation, mut scratch, mut weights) =
            (Evaluation::default(), Scratch::default(), Vec::new());
        let mut evaluator = Evaluator::new(backend, std::slice::from_ref(target), &problem, &mut evaluation);
        evaluator.evaluate(std::iter::once(Sight::new(&state, &visibility)))?;
        let rows: Rows<'_> = evaluator.rows(0);
        triangle_weights(&problem, &rows, &visibility, None, &mut scratch, &mut weights);
        let (mean, _) = cost(&problem, &state.appearance, &rows, &weights, &mut scratch.solutions);
        Ok(PoseEstimate {
            score: score(backend, target, &state, &visibility)?,
            hessian: end.hessian,
            covariance: end.covariance,
            rms: if mean.is_finite() { mean.max(0.0).sqrt() } else { 0.0 },
            camera_from_object: end.pose,
            appearance: state.appearance,
            iterations: end.iterations,
            converged: end.converged,
        })
    }
}

/// Searches one point.
fn look(
    point: &EdgePoint,
    camera: &Camera,
    pose: &Pose,
    image: &GrayImage,
    reach: usize,
    target: &Target<'_>,
) -> Option<Found> {
    let line = Line::new(point, camera, pose)?;
    let residual = line.search(image, reach)?;
    let d = increment_jacobian(camera, pose, &point.point, &target.model.shape.centre);
    Some(Found { residual, row: line.normal.transpose() * d, metric: d.transpose() * d })
}

impl Aligner for Edge {
    fn levels(&self, model: &Model) -> usize {
        levels_for_scores(model)
    }

    fn prepare(&mut self, _backend: &mut dyn Backend, model: &Model, _id: ModelId) -> Result<()> {
        let borders = border_points(model, self.options.border_points);
        let of_level = |level| {
            let mut points = template_edges(level, self.options.template_points);
            points.extend(borders.iter().cloned());
            points
        };
        self.levels = model.levels.iter().map(of_level).collect();
        if self.levels.iter().any(|points| points.len() < MIN_POINTS) {
            let remedy = "use a method that needs no edges, or train with frames in focus";
            return Err(Error::invalid("model", "it has next to no edges", remedy));
        }
        Ok(())
    }

    fn another(&self) -> Box<dyn Aligner> {
        Box::new(self.clone())
    }

    fn align(
        &mut self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        check(target, starts)?;
        if self.levels.len() != target.model.levels.len() {
            return Err(Error::invalid("aligner", "it is not prepared for this model", "call prepare first"));
        }
        let pyramid = Pyramid::new(target.image.clone(), self.levels.len());
        estimates.clear();
        for start in starts {
            let zero = Matrix6::zeros();
            let pose = start.camera_from_object.renormalised();
            let mut at = Descent { pose, iterations: 0, converged: true, hessian: zero, covariance: zero };
            for level in tracked_levels(target.model) {
                self.level(target, pyramid.level(level), level, &mut at);
            }
            estimates.push(Self::finish(backend, target, start, &at)?);
        }
        Ok(())
    }
}
