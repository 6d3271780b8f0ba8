//! Comparing the linearizations of two backends.

use aam6d::backend::cpu::linearize::linearize;
use aam6d::backend::{Backend, CpuBackend, Linearization, SumsRow, TriangleWarp};
use aam6d::model::Chart;
use nalgebra::Vector3;

use super::Scene;
use super::sums::RESIDUAL;

/// Sums may differ by this part of what their terms' magnitudes add up to: the gradient of a frame with 30 grey levels
/// from pixel to pixel changes by some 1e-4 with a position that f32 holds to 1e-5 px.
const OF_TERMS: f64 = 1e-4;

/// Closer than this to a row or column of pixels, pixels, f32 and f64 may take the gradient on different sides.
const BORDER: f64 = 1e-4;

/// The two sides of a border are looked at this far from it, pixels.
const BESIDE: f64 = 1e-7;

/// Part of the pixels that may fall on the other side of the image border.
const COUNT: f64 = 1e-4;

/// First- and second-order row as one vector.
type Row = Vec<f64>;

fn row_of(out: &Linearization, item: usize, triangle: usize) -> Row {
    [out.sums.row(item, triangle).0, out.row(item, triangle).0].concat()
}

/// Names and ranges of the vectors in a row; entries within one are of one kind.
fn parts(modes: usize) -> Vec<(&'static str, std::ops::Range<usize>)> {
    let second = 11 + modes;
    vec![
        ("gradient", 0..6),
        ("cost", 6..7),
        ("weight", 7..8),
        ("appearance", 9..second),
        ("hessian", second..second + 18),
        ("cross", second + 18..second + 30 + 6 * modes),
    ]
}

/// The reference: the twin in f64, and what its rows are made of.
pub(crate) struct LinearReference {
    out: Linearization,
    tolerances: Vec<Row>,
}

impl LinearReference {
    pub(crate) fn new(scene: &Scene) -> Self {
        let mut cpu = CpuBackend::twin();
        let model = cpu.load(&scene.model).expect("the CPU takes every model");
        cpu.set_frame(&scene.image, 1).expect("the CPU takes every frame");
        let mut out = Linearization::default();
        cpu.linearize(&scene.request(model), &mut out).expect("the scene fits itself");
        let triangles = scene.level().charts.len();
        let tolerances = (0..scene.warps.len()).map(|i| tolerance(scene, i / triangles, i % triangles));
        Self { out, tolerances: tolerances.collect() }
    }

    /// Compares; the error lists every row that differs.
    pub(crate) fn compare(&self, scene: &Scene, other: &Linearization) -> Result<(), String> {
        let (triangles, modes) = (scene.level().charts.len(), scene.level().pixels.modes.len());
        let mut failures = Vec::new();
        for (i, tolerance) in self.tolerances.iter().enumerate() {
            let (item, t) = (i / triangles, i % triangles);
            let (a, b) = (row_of(&self.out, item, t), row_of(other, item, t));
            if let Err(problem) = compare(&a, &b, tolerance, modes) {
                failures.push(format!("pose {item} triangle {t}: {problem}"));
            }
        }
        if failures.is_empty() { Ok(()) } else { Err(failures.join("\n")) }
    }
}

fn compare(a: &Row, b: &Row, tolerance: &Row, modes: usize) -> Result<(), String> {
    if a.len() != b.len() || a.iter().chain(b).any(|x| !x.is_finite()) {
        return Err("lengths differ, or numbers are not finite".into());
    }
    if (a[8] - b[8]).abs() > COUNT * a[8] {
        return Err(format!("count {} and {}", a[8], b[8]));
    }
    for (name, range) in parts(modes) {
        let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
        let difference = norm(&mut a[range.clone()].iter().zip(&b[range.clone()]).map(|(a, b)| a - b));
        let allowed = norm(&mut tolerance[range].iter().copied());
        if difference > allowed {
            return Err(format!("{name} differs by {difference:e}, allowed {allowed:e}"));
        }
    }
    Ok(())
}

/// By how much every number of a row may differ: the twin pixel by pixel, without letting terms cancel.
fn tolerance(scene: &Scene, item: usize, triangle: usize) -> Row {
    let level = scene.level();
    let first = 11 + level.pixels.modes.len();
    let (chart, warp) = (&level.charts[triangle], &scene.warps[item * level.charts.len() + triangle]);
    let mut sum = vec![0.0; first + Linearization::row_len(level.pixels.modes.len())];
    for pixel in (chart.start..chart.end).filter(|_| warp.active) {
        let row = pixel_row(scene, item, pixel, warp);
        let residual = (SumsRow(&row).cost() / SumsRow(&row).weight()).sqrt();
        for (k, term) in row.iter().map(|x| x.abs()).enumerate() {
            // Numbers with one residual as a factor, the cost with two, the others with none.
            let of_residual = match k {
                6 => 2.0,
                k if k < first && !(7..9).contains(&k) => 1.0,
                _ => 0.0,
            };
            let rounding = if term > 0.0 { of_residual * RESIDUAL * term / residual } else { 0.0 };
            sum[k] += OF_TERMS * term + rounding;
        }
        let [u, v] = level.pixels.position[pixel as usize].map(f64::from);
        let w = warp.image_from_chart * Vector3::new(u, v, 1.0);
        for (axis, x) in [w.x / w.z, w.y / w.z].into_iter().enumerate() {
            if (x - x.round()).abs() < BORDER {
                // The gradient jumps there: both sides are right.
                for shift in [-BESIDE, BESIDE].map(|beside| x.round() - x + beside) {
                    let mut other = *warp;
                    let moved = other.image_from_chart.row(axis) + shift * other.image_from_chart.row(2);
                    other.image_from_chart.set_row(axis, &moved);
                    let across = pixel_row(scene, item, pixel, &other);
                    let inside = SumsRow(&across).count() > 0.0;
                    let jumps = row.iter().zip(&across).map(|(a, b)| (a - b).abs());
                    sum.iter_mut().zip(jumps).filter(|_| inside).for_each(|(sum, jump)| *sum += jump);
                }
            }
        }
    }
    sum
}

/// The row of one pixel.
fn pixel_row(scene: &Scene, item: usize, start: u32, warp: &TriangleWarp) -> Row {
    let pixels = &scene.level().pixels;
    let modes = pixels.modes.len();
    let (mut first, mut second) = (vec![0.0; 11 + modes], vec![0.0; Linearization::row_len(modes)]);
    let pixel = Chart { start, end: start + 1, ..Chart::default() };
    let appearance = &scene.appearance[item * modes..][..modes];
    linearize(pixels, &pixel, warp, appearance, &scene.image, (&mut first, &mut second));
    [first, second].concat()
}
