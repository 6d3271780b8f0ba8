//! The paper's proposed method as printed, with only the sign of eqs. (16) and (18) put right (`docs/maths.md`, "The
//! paper's own method").

mod system;

use nalgebra::{DVector, Matrix3, Point3, Vector6};

use super::covariance::{from_reference_axes, hessian_of};
use super::evaluator::{check, levels_for_scores, narrow, score};
use super::levenberg_marquardt::State;
use super::normal_equations::Rows;
use super::visibility::visibility;
use super::{Aligner, PoseEstimate, Start, Target};
use crate::backend::{Backend, ModelId, Request, Sums, TriangleWarp};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::geometry::warp::affine;
use crate::model::{LevelTemplate, Model};
use system::{Reference, System};

/// On which side of H the inverse increment goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// H <- H(dp)^-1 H, eq. (13) as printed
    #[default]
    Left,
    /// H <- H H(dp)^-1, the one that follows from eq. (11)
    Right,
}

/// Choices of the method.
#[derive(Debug, Clone, PartialEq)]
pub struct PaperOptions {
    /// Eq. (13) or its correction.
    pub order: Order,
    /// A phase ends when |dp| is below this, translations in millimetres, angles in radians.
    pub epsilon: f64,
    /// First damping of every phase.
    pub damping: f64,
    /// Steps per phase at most; the paper names no limit.
    pub max_iterations: usize,
}

impl Default for PaperOptions {
    fn default() -> Self {
        Self { order: Order::Left, epsilon: 1e-2, damping: 1e-3, max_iterations: 50 }
    }
}

/// Constant J, affine warp per triangle, Levenberg-Marquardt in two phases at full size.
#[derive(Debug, Clone, Default)]
pub struct Paper {
    /// Choices.
    pub options: PaperOptions,
    prepared: Option<Prepared>,
}

/// What is computed once per model.
#[derive(Debug, Clone)]
struct Prepared {
    reference: Reference,
    /// The template with q = 1 in the backend.
    uniform: ModelId,
    /// JtQJ and Sigma of the two phases: q = 1, then eq. (10).
    phases: [System; 2],
}

/// H and lambda with the sums there.
#[derive(Debug, Clone)]
struct Step {
    /// H: `camera_from_object = H camera_from_object(reference view)`.
    motion: Pose,
    appearance: Vec<f64>,
    /// Mean r^2 over the pixels inside the image, q = 1.
    error: f64,
    /// The sums that make JtQr in this phase.
    rows: Vec<f64>,
}

impl Paper {
    /// The method with the given choices.
    pub fn new(options: PaperOptions) -> Self {
        Self { options, prepared: None }
    }

    /// Steps 1 to 6 of the iteration stage, until |dp| < epsilon. Returns iterations and whether it got there.
    fn phase(
        &self,
        prepared: &Prepared,
        pass: &mut Pass<'_>,
        phase: usize,
        at: &mut Step,
    ) -> Result<(usize, bool)> {
        let system = &prepared.phases[phase];
        let mut damping = self.options.damping;
        pass.first(phase, at)?;
        for iteration in 1..=self.options.max_iterations {
            let gradient = prepared.reference.gradient(pass.level, &pass.rows(&at.rows));
            let Some(step) = system.solve(&gradient, damping) else { return Ok((iteration - 1, false)) };
            let dp: Vector6<f64> = step.fixed_rows::<6>(0).into_owned();
            let inverse = Pose::increment(&dp, &Point3::origin()).inverse();
            let mut next = at.clone();
            next.motion = match self.options.order {
                Order::Left => inverse.compose(&at.motion),
                Order::Right => at.motion.compose(&inverse),
            };
            next.appearance.iter_mut().zip(step.iter().skip(6)).for_each(|(a, d)| *a += d);
            if pass.accept(phase, at.error, &mut next)? {
                *at = next;
                damping /= 10.0;
            } else {
                damping *= 10.0;
            }
            if length(&step) < self.options.epsilon {
                return Ok((iteration, true));
            }
        }
        Ok((self.options.max_iterations, false))
    }

    fn align_one(
        &self,
        prepared: &Prepared,
        pass: &mut Pass<'_>,
        target: &Target<'_>,
        start: &Start,
    ) -> Result<PoseEstimate> {
        let from_object = prepared.reference.view.camera_from_object;
        let mut at = Step {
            motion: start.camera_from_object.renormalised().compose(&from_object.inverse()),
            appearance: start.appearance.clone(),
            error: f64::INFINITY,
            rows: Vec::new(),
        };
        let (mut iterations, mut converged) = (0, true);
        for phase in 0..prepared.phases.len() {
            let (steps, ended) = self.phase(prepared, pass, phase, &mut at)?;
            iterations += steps;
            converged &= ended;
        }
        let pose = at.motion.compose(&from_object);
        let rows = pass.rows(&at.rows);
        let triangles = 0..pass.level.charts.len();
        let (squares, weight) = triangles
            .map(|t| (rows.row(t).cost(), rows.row(t).weight()))
            .fold((0.0, 0.0), |(a, b), (c, w)| (a + c, b + w));
        let variance = if weight > 0.0 { squares / weight } else { 0.0 };
        // The increment stands in the axes of the camera as it sees the object now, or as the reference view does.
        let axes = if self.options.order == Order::Left { &pose } else { &from_object };
        let covariance = prepared.phases[1].inverse() * variance;
        let covariance = from_reference_axes(&covariance, axes, &target.model.shape.centre);
        let state = State { pose, appearance: at.appearance.clone() };
        let visible = visibility(target, &pose);
        Ok(PoseEstimate {
            hessian: hessian_of(&covariance, variance),
            covariance,
            score: score(pass.backend, target, &state, &visible)?,
            rms: variance.sqrt(),
            camera_from_object: pose,
            appearance: at.appearance,
            iterations,
            converged,
        })
    }
}

/// |dp| in millimetres and radians.
fn length(step: &DVector<f64>) -> f64 {
    let mm = 1e3 * step.fixed_rows::<3>(0);
    mm.norm().hypot(step.fixed_rows::<3>(3).norm())
}

impl Aligner for Paper {
    fn levels(&self, model: &Model) -> usize {
        levels_for_scores(model)
    }

    fn prepare(&mut self, backend: &mut dyn Backend, model: &Model, _id: ModelId) -> Result<()> {
        let level = &model.levels[0];
        let reference = Reference::new(model)?;
        let mut pixels = level.pixels.clone();
        pixels.weight.fill(1.0);
        let uniform = LevelTemplate::new(&model.shape, &model.views, 0, pixels, level.charts.clone())?;
        let squares = System::new(&reference, &uniform, None);
        let phases = [
            System::new(&reference, &uniform, Some(&squares)),
            System::new(&reference, level, Some(&squares)),
        ];
        let variant = Model { levels: vec![uniform], ..model.clone() };
        self.prepared = Some(Prepared { reference, uniform: backend.load(&variant)?, phases });
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
        let prepared = self
            .prepared
            .as_ref()
            .ok_or_else(|| Error::invalid("aligner", "it is not prepared", "call prepare first"))?;
        let level = &target.model.levels[0];
        if prepared.reference.motions.len() != level.charts.len() {
            return Err(Error::invalid("aligner", "it is prepared for another model", "call prepare first"));
        }
        let mut pass = Pass { backend, target, level, prepared, sums: Sums::default() };
        estimates.clear();
        for start in starts {
            estimates.push(self.align_one(prepared, &mut pass, target, start)?);
        }
        Ok(())
    }
}

/// Runs `accumulate` with the affine warp of eq. (3).
struct Pass<'a> {
    backend: &'a mut dyn Backend,
    target: &'a Target<'a>,
    level: &'a LevelTemplate,
    prepared: &'a Prepared,
    sums: Sums,
}

impl Pass<'_> {
    fn rows<'r>(&self, data: &'r [f64]) -> Rows<'r> {
        Rows { data, row_len: Sums::row_len(self.target.model.modes()) }
    }

    /// Error and sums at the first step of a phase.
    fn first(&mut self, phase: usize, at: &mut Step) -> Result<()> {
        self.accept(phase, f64::INFINITY, at).map(|_| ())
    }

    /// Computes the error, unweighted as printed in both phases; if it is below `limit`, also the sums of the phase.
    fn accept(&mut self, phase: usize, limit: f64, step: &mut Step) -> Result<bool> {
        self.accumulate(self.prepared.uniform, step)?;
        let rows = self.rows(self.sums.item(0));
        let triangles = 0..self.level.charts.len();
        let (squares, count) = triangles
            .map(|t| (rows.row(t).cost(), rows.row(t).count()))
            .fold((0.0, 0.0), |(a, b), (c, n)| (a + c, b + n));
        step.error = if count > 0.0 { squares / count } else { f64::INFINITY };
        let better = step.error < limit;
        if phase > 0 && (better || limit.is_infinite()) {
            self.accumulate(self.target.id, step)?;
        }
        if better || limit.is_infinite() {
            step.rows.clear();
            step.rows.extend(self.sums.item(0));
        }
        Ok(better)
    }

    fn accumulate(&mut self, model: ModelId, step: &Step) -> Result<()> {
        let pose = step.motion.compose(&self.prepared.reference.view.camera_from_object);
        let warps: Vec<TriangleWarp> = (0..self.level.charts.len())
            .map(|t| self.warp(&pose, t).unwrap_or_else(TriangleWarp::idle))
            .collect();
        let appearance: Vec<f32> = step.appearance.iter().copied().map(narrow).collect();
        let request = Request {
            model,
            level: 0,
            image_level: 0,
            items: 1,
            frames: &[],
            warps: &warps,
            appearance: &appearance,
        };
        self.backend.accumulate(&request, &mut self.sums)
    }

    /// Eq. (3); `None` for a triangle without a part in J, or with a corner behind the camera.
    fn warp(&self, pose: &Pose, triangle: usize) -> Option<TriangleWarp> {
        self.prepared.reference.motions[triangle]?;
        let geometry = self.level.geometry[triangle].as_ref()?;
        let mut corners = geometry.corners;
        for (corner, x) in corners.iter_mut().zip(&geometry.points) {
            *corner = self.target.camera.project(&pose.transform_point(x))?;
        }
        let a = affine(&geometry.corners, &corners)?;
        let mut image_from_chart = Matrix3::identity();
        image_from_chart.fixed_view_mut::<2, 3>(0, 0).copy_from(&a);
        Some(TriangleWarp::plain(image_from_chart))
    }
}
