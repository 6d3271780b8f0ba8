//! The default method: template gradient, pose-dependent geometry, right composition, coarse to fine.

use super::covariance::covariance;
use super::levenberg_marquardt::{Descent, Settings, State, Stop};
use super::normal_equations::{LevelProblem, Rows};
use super::photometric::{Grouping, Groups};
use super::robust::Redescent;
use super::score::Score;
use super::{Aligner, PoseEstimate, Start, Target};
use crate::backend::{Backend, Request, Sums, TriangleWarp};
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::geometry::raster::{facing, visible_shares};
use crate::geometry::warp::homography;
use crate::model::Model;

/// Triangles seen more obliquely than this cosine are left out.
const MIN_COSINE: f64 = 0.06;
/// Visibility is judged on an image of this pyramid level.
const VISIBILITY_LEVEL: usize = 2;
/// Triangles with less than this share free of occlusion by the object itself are left out.
const MIN_VISIBLE: f64 = 0.5;

/// Choices of the method.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Levenberg-Marquardt steps per level at most.
    pub max_iterations: usize,
    /// A level ends when a step moves the corners by less (rms, pixels of the level); the last entry also serves all
    /// coarser levels.
    pub stop_px: Vec<f64>,
    /// First damping of every level.
    pub damping: f64,
    /// Leave out triangles that do not look like the object.
    pub robust: bool,
    /// Who shares gain and bias at full size; coarser levels always use [`Grouping::FaceAndView`].
    pub full_size_grouping: Grouping,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_iterations: 20,
            stop_px: vec![0.01, 0.02, 0.05],
            damping: 1e-3,
            robust: true,
            full_size_grouping: Grouping::Triangle,
        }
    }
}

/// Inverse compositional alignment with pose-dependent geometry (`docs/maths.md`).
#[derive(Debug, Clone, Default)]
pub struct InverseCompositional {
    /// Choices.
    pub options: Options,
}

impl InverseCompositional {
    /// The method with the given choices.
    pub fn new(options: Options) -> Self {
        Self { options }
    }

    fn settings(&self, level: usize) -> Settings {
        let stop_px =
            self.options.stop_px.get(level).or(self.options.stop_px.last()).copied().unwrap_or(0.01);
        Settings {
            damping: self.options.damping,
            max_iterations: self.options.max_iterations,
            stop_px,
            redescent: self.options.robust.then_some(Redescent { full: 1.0, zero: 3.0 }),
        }
    }

    fn problem<'a>(&self, target: &Target<'a>, level: usize) -> LevelProblem<'a> {
        let template = &target.model.levels[level];
        let grouping = if level == 0 { self.options.full_size_grouping } else { Grouping::FaceAndView };
        LevelProblem {
            level: template,
            camera: target.camera.at_level(level),
            groups: Groups::new(grouping, &target.model.shape, template),
            centre: target.model.shape.centre,
        }
    }

    fn level(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        level: usize,
        states: Vec<State>,
    ) -> Result<Vec<Descent>> {
        let problem = self.problem(target, level);
        let settings = self.settings(level);
        let visibility: Vec<Vec<f64>> = states.iter().map(|s| visibility(target, &s.pose)).collect();
        let mut evaluator = Evaluator { backend, target, level, problem: &problem, sums: Sums::default() };
        evaluator.evaluate(states.iter().zip(&visibility))?;
        let mut descents = Vec::with_capacity(states.len());
        for (i, (state, visibility)) in states.into_iter().zip(visibility).enumerate() {
            descents.push(Descent::new(&problem, &settings, state, visibility, evaluator.rows(i)));
        }
        loop {
            let mut proposals = Vec::new();
            for (i, descent) in descents.iter_mut().enumerate() {
                if let Some(state) = descent.propose(&problem, &settings) {
                    proposals.push((i, state.clone()));
                }
            }
            if proposals.is_empty() {
                return Ok(descents);
            }
            evaluator.evaluate(proposals.iter().map(|(i, state)| (state, &descents[*i].visibility)))?;
            for (k, (i, _)) in proposals.iter().enumerate() {
                descents[*i].judge(&problem, &settings, evaluator.rows(k));
            }
        }
    }
}

impl Aligner for InverseCompositional {
    fn levels(&self, model: &Model) -> usize {
        model.levels.len()
    }

    fn align(
        &self,
        backend: &mut dyn Backend,
        target: &Target<'_>,
        starts: &[Start],
    ) -> Result<Vec<PoseEstimate>> {
        check(target, starts)?;
        let mut states: Vec<State> = starts
            .iter()
            .map(|s| State { pose: s.camera_from_object.renormalised(), appearance: s.appearance.clone() })
            .collect();
        let mut iterations = vec![0; starts.len()];
        let mut converged = vec![true; starts.len()];
        let mut last = Vec::new();
        for level in (0..target.model.levels.len()).rev() {
            last = self.level(backend, target, level, states)?;
            for (i, descent) in last.iter().enumerate() {
                iterations[i] += descent.iterations;
                converged[i] &= descent.stop == Some(Stop::Converged);
            }
            states = last.iter().map(|d| d.state.clone()).collect();
        }
        let problem = self.problem(target, 0);
        let estimate = |(i, d): (usize, Descent)| finish(&problem, d, iterations[i], converged[i]);
        Ok(last.into_iter().enumerate().map(estimate).collect())
    }
}

fn check(target: &Target<'_>, starts: &[Start]) -> Result<()> {
    let modes = target.model.modes();
    for (i, start) in starts.iter().enumerate() {
        if !start.camera_from_object.is_finite() {
            return Err(Error::invalid(format!("start pose {i}"), "it is not finite", "give a valid pose"));
        }
        if start.appearance.len() != modes {
            let problem = format!("{} appearance parameters, the model has {modes}", start.appearance.len());
            return Err(Error::invalid(format!("start {i}"), problem, "give one per mode, 0 for the mean"));
        }
    }
    Ok(())
}

fn finish(problem: &LevelProblem<'_>, descent: Descent, iterations: usize, converged: bool) -> PoseEstimate {
    let Descent { state, rows, visibility, weights, equations, .. } = descent;
    let rows = Rows { data: &rows, row_len: Sums::row_len(state.appearance.len()) };
    PoseEstimate {
        score: Score::new(problem.level, &rows, &visibility, &state.appearance),
        covariance: covariance(problem, &state, &rows, &weights, &equations),
        rms: if equations.cost.is_finite() { equations.cost.max(0.0).sqrt() } else { 0.0 },
        camera_from_object: state.pose,
        appearance: state.appearance,
        iterations,
        converged,
    }
}

/// Share of every triangle that can be seen: 0 for backs, grazing triangles and those mostly hidden.
fn visibility(target: &Target<'_>, pose: &Pose) -> Vec<f64> {
    let mesh = &target.model.shape.mesh;
    let shares = visible_shares(mesh, &target.camera.at_level(VISIBILITY_LEVEL), pose);
    let keep = |(t, share): (usize, f64)| {
        let seen = share >= MIN_VISIBLE && facing(&mesh.corners(t), pose) >= MIN_COSINE;
        if seen { share } else { 0.0 }
    };
    shares.into_iter().enumerate().map(keep).collect()
}

/// Runs the `accumulate` stage for many states of one level.
struct Evaluator<'a> {
    backend: &'a mut dyn Backend,
    target: &'a Target<'a>,
    level: usize,
    problem: &'a LevelProblem<'a>,
    sums: Sums,
}

impl Evaluator<'_> {
    fn evaluate<'s>(&mut self, states: impl Iterator<Item = (&'s State, &'s Vec<f64>)>) -> Result<()> {
        let (mut warps, mut appearance, mut items) = (Vec::new(), Vec::new(), 0);
        for (state, visibility) in states {
            items += 1;
            #[expect(clippy::cast_possible_truncation, reason = "the device works in f32")]
            appearance.extend(state.appearance.iter().map(|a| *a as f32));
            for (geometry, visible) in self.problem.level.geometry.iter().zip(visibility) {
                let geometry = geometry.as_ref().filter(|_| *visible > 0.0);
                warps.push(geometry.map_or(
                    TriangleWarp { image_from_chart: nalgebra::Matrix3::zeros(), active: false },
                    |g| TriangleWarp {
                        image_from_chart: homography(&self.problem.camera, &state.pose, &g.object_from_chart),
                        active: true,
                    },
                ));
            }
        }
        let request = Request {
            model: self.target.id,
            level: self.level,
            items,
            warps: &warps,
            appearance: &appearance,
        };
        self.backend.accumulate(&request, &mut self.sums)
    }

    fn rows(&self, item: usize) -> Rows<'_> {
        let row_len = Sums::row_len(self.target.model.modes());
        Rows { data: self.sums.item(item), row_len }
    }
}
