//! Comparing the sums of two backends.

use aam6d::backend::cpu::accumulate::accumulate;
use aam6d::backend::{Backend, CpuBackend, Sums, SumsRow};
use aam6d::model::Chart;

use super::Scene;

/// Vectors of sums may differ by this part of their own length. f32 coordinates of the size of a chart give a few
/// 1e-6 near the optimum, where the sums cancel.
pub(crate) const RELATIVE: f64 = 2e-5;

/// ... and by this part of the length they would have if nothing cancelled: the fair scale for rounding, seen 3e-6.
pub(crate) const OF_TERMS: f64 = 1e-5;

/// Sums of positive terms (cost, weight) do not cancel; seen 3e-6.
pub(crate) const POSITIVE: f64 = 1e-5;

/// A residual cannot be better than this, grey levels: twice the spacing of f32 numbers near 255. It decides only
/// where single pixels happen to fit nearly perfectly.
pub(crate) const RESIDUAL: f64 = 3e-5;

/// Part of the pixels that may fall on the other side of the image border, where f32 and f64 round differently.
pub(crate) const COUNT: f64 = 1e-4;

/// The reference: the twin in f64, and what its rows are made of.
pub(crate) struct Reference {
    sums: Sums,
    scales: Vec<Scale>,
}

/// How large the numbers are that a row adds up.
struct Scale {
    /// Sums of the terms' magnitudes.
    terms: Vec<f64>,
    /// The same with one grey level for every residual.
    factors: Vec<f64>,
}

impl Reference {
    pub(crate) fn new(scene: &Scene) -> Self {
        let mut cpu = CpuBackend::twin();
        let model = cpu.load(&scene.model).expect("the CPU takes every model");
        cpu.set_frame(&scene.image, 1).expect("the CPU takes every frame");
        let mut sums = Sums::default();
        cpu.accumulate(&scene.request(model), &mut sums).expect("the scene fits itself");
        let triangles = scene.level().charts.len();
        let scales = (0..scene.warps.len()).map(|i| Scale::new(scene, i / triangles, i % triangles));
        Self { sums, scales: scales.collect() }
    }

    /// Compares; the error lists every row that differs.
    pub(crate) fn compare(&self, scene: &Scene, other: &Sums) -> Result<(), String> {
        let triangles = scene.level().charts.len();
        let mut failures = Vec::new();
        for (i, scale) in self.scales.iter().enumerate() {
            let (item, t) = (i / triangles, i % triangles);
            let (a, b) = (self.sums.row(item, t).0, other.row(item, t).0);
            if let Err(problem) = scale.compare(a, b) {
                failures.push(format!("pose {item} triangle {t}: {problem}\n  cpu {a:?}\n  gpu {b:?}"));
            }
        }
        if failures.is_empty() { Ok(()) } else { Err(failures.join("\n")) }
    }
}

impl Scale {
    /// The twin pixel by pixel, without letting terms cancel.
    fn new(scene: &Scene, item: usize, triangle: usize) -> Self {
        let level = scene.level();
        let modes = level.pixels.modes.len();
        let (chart, warp) = (&level.charts[triangle], &scene.warps[item * level.charts.len() + triangle]);
        let appearance = &scene.appearance[item * modes..][..modes];
        let zero = vec![0.0; Sums::row_len(modes)];
        let mut scale = Self { terms: zero.clone(), factors: zero.clone() };
        for start in (chart.start..chart.end).filter(|_| warp.active) {
            let mut row = zero.clone();
            let pixel = Chart { start, end: start + 1, ..*chart };
            accumulate(level, &pixel, warp, appearance, &scene.image, &mut row);
            let residual = (SumsRow(&row).cost() / SumsRow(&row).weight()).sqrt();
            for (k, term) in row.iter().map(|x| x.abs()).enumerate() {
                scale.terms[k] += term;
                scale.factors[k] += if term > 0.0 { term / residual } else { 0.0 };
            }
        }
        scale
    }

    fn compare(&self, a: &[f64], b: &[f64]) -> Result<(), String> {
        if a.len() != b.len() || a.iter().chain(b).any(|x| !x.is_finite()) {
            return Err("lengths differ, or numbers are not finite".into());
        }
        let (rows, names) = ([SumsRow(a), SumsRow(b)], ["weight", "cost", "count"]);
        let positive = rows.map(|r| [r.weight(), r.cost(), r.count()]);
        // The factors of q r^2 are q r, which a changed residual changes twice.
        let rounding = [0.0, 2.0 * RESIDUAL * self.factors[6], 0.0];
        for (k, relative) in [POSITIVE, POSITIVE, COUNT].into_iter().enumerate() {
            let difference = (positive[0][k] - positive[1][k]).abs();
            if difference > relative * positive[0][k].abs() + rounding[k] {
                return Err(format!("{} differs by {difference:e}", names[k]));
            }
        }
        for (name, range) in [("gradient", 0..6), ("appearance", 9..a.len())] {
            let difference = norm(a[range.clone()].iter().zip(&b[range.clone()]).map(|(a, b)| a - b));
            let [length, terms, factors] =
                [a, &self.terms, &self.factors].map(|x| norm(x[range.clone()].iter().copied()));
            if difference > RELATIVE * length + OF_TERMS * terms + RESIDUAL * factors {
                return Err(format!("{name} differs by {difference:e}, terms {terms:e}"));
            }
        }
        Ok(())
    }
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|x| x * x).sum::<f64>().sqrt()
}
