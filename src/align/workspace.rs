//! Memory that is kept from frame to frame: after the first frames of a track nothing is allocated any more.

use std::time::Instant;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::evaluator::{Evaluation, finish, ms_since};
use super::levenberg_marquardt::Descent;
use super::photometric::Solution;
use super::vertices::Vertices;
use super::{AlignTimes, PoseEstimate, Start, Target};
use crate::backend::Backend;
use crate::error::Result;
use crate::geometry::raster::ZBuffer;

/// What an aligner keeps between frames. It holds no result: every number is written before it is read.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    pub(super) descents: Vec<Descent>,
    pub(super) evaluation: Evaluation,
    /// Memory of every thread that works on the descents; at least one while the workspace is lent.
    pub(super) workers: Vec<Worker>,
    pub(super) times: AlignTimes,
}

/// What one thread needs.
#[derive(Debug, Default)]
pub(super) struct Worker {
    pub(super) zbuffer: ZBuffer,
    pub(super) scratch: Scratch,
}

impl Workspace {
    /// The memory of `kept`, ready to be used.
    pub(super) fn lent(kept: &mut Self) -> Self {
        let mut work = std::mem::take(kept);
        work.workers.resize_with(work.workers.len().max(1), Worker::default);
        work
    }

    /// One descent per start, all in the same frame, on this thread.
    pub(super) fn begin(&mut self, starts: &[Start]) {
        self.start_at(starts, |_| 0);
        self.workers.truncate(1);
    }

    /// One descent per start, each in the frame with its number, on all threads.
    pub(super) fn begin_streams(&mut self, starts: &[Start]) {
        self.start_at(starts, |k| k);
        let threads = starts.len().clamp(1, rayon::current_num_threads());
        self.workers.resize_with(threads, Worker::default);
    }

    fn start_at(&mut self, starts: &[Start], frame: impl Fn(usize) -> usize) {
        (self.times, self.evaluation.spent_ms) = (AlignTimes::default(), 0.0);
        self.descents.resize_with(starts.len(), Descent::default);
        for (k, (descent, start)) in self.descents.iter_mut().zip(starts).enumerate() {
            descent.steps.start_at(start.camera_from_object.renormalised(), &start.appearance);
            descent.look.begin();
            descent.frame = frame(k);
        }
    }

    /// Divides the time since the descents began.
    pub(super) fn end_times(&mut self, began: Instant) {
        self.times.accumulate_ms = self.evaluation.spent_ms;
        self.times.solve_ms = ms_since(began) - self.times.visibility_ms - self.times.accumulate_ms;
    }

    /// The estimates of the descents.
    pub(super) fn finish(
        &mut self,
        backend: &mut dyn Backend,
        targets: &[Target<'_>],
        estimates: &mut Vec<PoseEstimate>,
    ) -> Result<()> {
        let began = Instant::now();
        let Self { descents, evaluation, workers, times } = self;
        let ends = descents.iter().map(Descent::ended);
        finish(backend, targets, ends, evaluation, workers, estimates)?;
        times.score_ms = ms_since(began);
        Ok(())
    }
}

/// Does a task for every item, which comes with its number: on this thread if there is one worker, which allocates
/// nothing, else with all of them.
pub(super) fn for_each<T: Send>(
    items: impl Iterator<Item = T>,
    workers: &mut [Worker],
    task: impl Fn(usize, T, &mut Worker) + Sync,
) {
    if let [worker] = workers {
        items.enumerate().for_each(|(k, item)| task(k, item, worker));
        return;
    }
    let all: Vec<_> = items.enumerate().collect();
    let share = all.len().div_ceil(workers.len()).max(1);
    all.into_par_iter().chunks(share).zip(workers).for_each(|(part, worker)| {
        part.into_iter().for_each(|(k, item)| task(k, item, worker));
    });
}

/// What is needed while equations are assembled and solved.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Gain and bias per group.
    pub(super) solutions: Vec<Solution>,
    /// Root mean square residual per triangle.
    pub(super) rms: Vec<f64>,
    /// Values to take a median of.
    pub(super) values: Vec<f64>,
    pub(super) couplings: Couplings,
    pub(super) vertices: Vertices,
    /// Cross moments of a triangle, where they are not the template's.
    pub(super) cross: DMatrix<f64>,
    /// Couplings of a triangle's pose with its appearance columns.
    pub(super) coupled: Vec<[f64; 6]>,
    /// One number per parameter: a triangle's part in the gradient.
    pub(super) column: Vec<f64>,
    pub(super) solver: Solver,
}

/// Coupling of every group's gain and bias with the pose and the appearance parameters.
#[derive(Debug, Default)]
pub(super) struct Couplings {
    parameters: usize,
    /// Group by group the column of the gain, then that of the bias.
    columns: Vec<f64>,
    /// False until a triangle of the group takes part.
    taking_part: Vec<bool>,
}

impl Couplings {
    /// No couplings of `groups` groups with `parameters` parameters.
    pub(super) fn reset(&mut self, groups: usize, parameters: usize) {
        self.parameters = parameters;
        self.columns.clear();
        self.columns.resize(2 * groups * parameters, 0.0);
        self.taking_part.clear();
        self.taking_part.resize(groups, false);
    }

    /// Columns of gain and bias of a group that takes part from now on.
    pub(super) fn of(&mut self, group: usize) -> [&mut [f64]; 2] {
        self.taking_part[group] = true;
        let n = self.parameters;
        let (gain, bias) = self.columns[2 * group * n..][..2 * n].split_at_mut(n);
        [gain, bias]
    }

    /// Groups that take part, with their columns of gain and bias.
    pub(super) fn iter(&self) -> impl Iterator<Item = (usize, [&[f64]; 2])> {
        let n = self.parameters;
        let groups = (0..).zip(&self.taking_part).filter(|(_, taking_part)| **taking_part);
        groups.map(move |(group, _)| {
            let (gain, bias) = self.columns[2 * group * n..][..2 * n].split_at(n);
            (group, [gain, bias])
        })
    }
}

/// Memory of linear systems.
#[derive(Debug)]
pub(super) struct Solver {
    /// 1 / sqrt of the diagonal of the last system.
    pub(super) scale: DVector<f64>,
    /// Right hand side, then solution.
    pub(super) vector: DVector<f64>,
    /// Scatter of all parameters, 6+l squared.
    pub(super) scatter: DMatrix<f64>,
    /// Block of the appearance parameters, l squared.
    pub(super) appearance: DMatrix<f64>,
    /// Block that couples appearance with the pose, l x 6.
    pub(super) coupling: DMatrix<f64>,
    /// The system, 6+l squared; empty while its factor is in use.
    pub(super) system: DMatrix<f64>,
}

impl Default for Solver {
    fn default() -> Self {
        let (vector, matrix) = (DVector::zeros(0), DMatrix::zeros(0, 0));
        Self {
            scale: vector.clone(),
            vector,
            scatter: matrix.clone(),
            appearance: matrix.clone(),
            coupling: matrix.clone(),
            system: matrix,
        }
    }
}

impl Solver {
    /// The factor of `S (H + damping diag(H)) S` with S = diag(H)^-1/2, which makes metres and radians alike; `None` if
    /// it is not positive definite. Its memory is to be given back to `system`.
    pub(super) fn factor(&mut self, hessian: &DMatrix<f64>, damping: f64) -> Option<Cholesky<f64, Dyn>> {
        let n = hessian.nrows();
        if (0..n).map(|i| hessian[(i, i)]).any(|d| d <= 0.0 || !d.is_finite()) {
            return None;
        }
        reset_vector(&mut self.scale, n);
        for (i, scale) in self.scale.iter_mut().enumerate() {
            *scale = 1.0 / hessian[(i, i)].sqrt();
        }
        copy_matrix(&mut self.system, hessian);
        scale_both_sides(&mut self.system, &self.scale);
        for i in 0..n {
            self.system[(i, i)] += damping;
        }
        factor(&mut self.system)
    }
}

/// The factor of a matrix in the matrix's own memory, which is to be given back by [`Cholesky::unpack_dirty`].
pub(super) fn factor(matrix: &mut DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    Cholesky::new(std::mem::replace(matrix, DMatrix::zeros(0, 0)))
}

/// diag(scale) M diag(scale).
pub(super) fn scale_both_sides(m: &mut DMatrix<f64>, scale: &DVector<f64>) {
    for (mut column, by_column) in m.column_iter_mut().zip(scale) {
        for (value, by_row) in column.iter_mut().zip(scale) {
            *value = by_row * *value * by_column;
        }
    }
}

/// Makes a vector zero and of length `n`.
pub(super) fn reset_vector(v: &mut DVector<f64>, n: usize) {
    if v.len() == n { v.fill(0.0) } else { *v = DVector::zeros(n) }
}

/// Makes a matrix zero and of a size.
pub(super) fn reset_matrix(m: &mut DMatrix<f64>, rows: usize, columns: usize) {
    if m.shape() == (rows, columns) { m.fill(0.0) } else { *m = DMatrix::zeros(rows, columns) }
}

/// Copies a matrix into the memory of another.
pub(super) fn copy_matrix(to: &mut DMatrix<f64>, from: &DMatrix<f64>) {
    if to.shape() == from.shape() { to.copy_from(from) } else { to.clone_from(from) }
}
