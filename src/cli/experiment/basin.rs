//! `--study basin`: which share of the starts converges, by distance, tilt, method, with and without the pyramid.

use std::path::Path;

use anyhow::Context;
use indicatif::ProgressBar;
use serde::{Deserialize, Serialize};
use svg::Document;

use super::methods::{Engine, PATIENT_STEPS, has_pyramid, patient};
use super::plot::{Axis, Line, Panel, figure};
use super::record::{write_json, write_text};
use super::sheet::{Kind, Sheet, number};
use super::starts::{Scene, View, rms_px};
use super::theme::look;
use crate::align::{Method, Order, Start};
use crate::cli::progress;
use crate::model::Model;
use crate::track::Tracker;

/// Distances of the starts, rms displacement of the landmarks in pixels.
const DISTANCES_PX: [f64; 4] = [5.0, 10.0, 20.0, 30.0];
/// Tilts of the object against the frontal view, degrees.
const TILTS_DEG: [f64; 3] = [0.0, 20.0, 35.0];
/// A start converged if its end is closer than this to the truth, rms displacement of the landmarks in pixels.
const CONVERGED_PX: f64 = 1.0;

/// Everything about the study (`basin.json`).
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Basin {
    pub(super) version: String,
    /// False while cells are missing.
    pub(super) complete: bool,
    pub(super) seconds: f64,
    pub(super) seed: u64,
    pub(super) backend: String,
    pub(super) converged_px: f64,
    pub(super) cells: Vec<Cell>,
}

/// One method at one tilt and distance.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Cell {
    pub(super) method: Method,
    /// With all levels of the pyramid; false: at full size only.
    pub(super) pyramid: bool,
    pub(super) tilt_deg: f64,
    pub(super) start_px: f64,
    pub(super) trials: usize,
    pub(super) converged: usize,
    /// `converged` / `trials`.
    pub(super) share: f64,
    /// Over the converged trials, all levels.
    pub(super) iterations_mean: Option<f64>,
    /// Over the converged trials.
    pub(super) final_px_median: Option<f64>,
}

/// What to study.
pub(super) struct Options<'a> {
    pub(super) out: &'a Path,
    pub(super) seed: u64,
    pub(super) trials: usize,
    pub(super) methods: Vec<Method>,
    pub(super) order: Order,
    pub(super) engine: &'a Engine,
    pub(super) adapter: Option<&'a str>,
}

/// Runs the study; every finished method is on disk.
pub(super) fn run(options: &Options<'_>) -> anyhow::Result<Basin> {
    let began = std::time::Instant::now();
    let scene = Scene::new(options.seed)?;
    let views: Vec<(f64, Vec<View>)> = TILTS_DEG.into_iter().map(|tilt| (tilt, scene.views(tilt))).collect();
    let mut basin = Basin {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        complete: false,
        seconds: 0.0,
        seed: options.seed,
        backend: options.engine.device.clone().unwrap_or_default(),
        converged_px: CONVERGED_PX,
        cells: Vec::new(),
    };
    let variants: Vec<(Method, bool)> = options
        .methods
        .iter()
        .flat_map(|&m| [true, false].map(|pyramid| (m, pyramid)))
        .filter(|&(m, pyramid)| !pyramid || has_pyramid(m))
        .collect();
    let all_views = views.iter().map(|(_, v)| v.len()).sum::<usize>();
    let bar = progress::frames(variants.len() * all_views * DISTANCES_PX.len(), "basin");
    for &(method, pyramid) in &variants {
        let mut model = scene.models.of(method).clone();
        if !pyramid {
            model.levels.truncate(1);
        }
        bar.set_message(format!("basin: {}{}", method.name(), if pyramid { "" } else { ", full size only" }));
        basin.cells.extend(study(options, &scene, &views, (method, pyramid), model, &bar)?);
        basin.complete = variants.last() == Some(&(method, pyramid));
        basin.seconds = began.elapsed().as_secs_f64();
        publish(options.out, &basin)?;
    }
    bar.finish_and_clear();
    Ok(basin)
}

/// All cells of one method.
fn study(
    options: &Options<'_>,
    scene: &Scene,
    views: &[(f64, Vec<View>)],
    (method, pyramid): (Method, bool),
    model: Model,
    bar: &ProgressBar,
) -> anyhow::Result<Vec<Cell>> {
    let modes = model.modes();
    let backend = options.engine.open(options.adapter)?;
    let mut tracker = Tracker::new(model, scene.camera, backend, patient(method, options.order, pyramid))?;
    let mut cells = Vec::new();
    for (tilt, views) in views {
        for distance in DISTANCES_PX {
            let per_view = options.trials.div_ceil(views.len());
            let mut ends = Vec::new();
            for view in views {
                let starts: Vec<Start> = scene
                    .starts(view, distance, per_view)
                    .into_iter()
                    .map(|pose| Start { camera_from_object: pose, appearance: vec![0.0; modes] })
                    .collect();
                let estimates = tracker.align(&view.image, &starts).context("the backend failed")?;
                ends.extend(estimates.into_iter().map(|e| {
                    let away = rms_px(&scene.camera, &scene.landmarks, &e.camera_from_object, &view.pose);
                    (away.unwrap_or(f64::INFINITY), e.iterations)
                }));
                bar.inc(1);
            }
            cells.push(cell((method, pyramid), *tilt, distance, &ends));
        }
    }
    Ok(cells)
}

/// Counts the ends of the trials (distance in pixels, iterations).
fn cell((method, pyramid): (Method, bool), tilt_deg: f64, start_px: f64, ends: &[(f64, usize)]) -> Cell {
    let good: Vec<&(f64, usize)> = ends.iter().filter(|(px, _)| *px < CONVERGED_PX).collect();
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    let iterations: Vec<f64> = good.iter().map(|(_, n)| *n as f64).collect();
    let away: Vec<f64> = good.iter().map(|(px, _)| *px).collect();
    #[expect(clippy::cast_precision_loss, reason = "counts are small")]
    let share = good.len() as f64 / ends.len().max(1) as f64;
    Cell {
        method,
        pyramid,
        tilt_deg,
        start_px,
        trials: ends.len(),
        converged: good.len(),
        share,
        iterations_mean: crate::eval::statistics::mean(&iterations),
        final_px_median: crate::eval::statistics::median(&away),
    }
}

/// Writes what is known so far.
fn publish(out: &Path, basin: &Basin) -> anyhow::Result<()> {
    write_json(&out.join("basin.json"), basin)?;
    write_text(&out.join("basin.md"), &markdown(basin))?;
    write_text(&out.join("figures/basin.svg"), &plot(basin).to_string())
}

/// The variants in the order they were run.
fn variants(basin: &Basin) -> Vec<(Method, bool)> {
    let mut all: Vec<(Method, bool)> = basin.cells.iter().map(|c| (c.method, c.pyramid)).collect();
    all.dedup();
    all
}

/// Shares by tilt and distance, one column per variant; mean iterations of the converged trials in brackets.
pub(super) fn sheet(basin: &Basin) -> Sheet {
    let variants = variants(basin);
    let title = |(method, pyramid): &(Method, bool)| {
        format!("{}{}", method.name(), if *pyramid { "" } else { ", full size only" })
    };
    let titles: Vec<String> = variants.iter().map(title).collect();
    let head: Vec<&str> =
        ["tilt (°), start (px)"].into_iter().chain(titles.iter().map(String::as_str)).collect();
    let mut sheet = Sheet::new(&head, 1);
    for tilt in TILTS_DEG {
        for start in DISTANCES_PX {
            let mut cells = vec![format!("{tilt}, {start}")];
            for &(method, pyramid) in &variants {
                let cell = basin.cells.iter().find(|c| {
                    (c.method, c.pyramid, c.tilt_deg, c.start_px) == (method, pyramid, tilt, start)
                });
                cells.push(
                    cell.map_or_else(String::new, |c| {
                        format!("{:.2} ({})", c.share, number(c.iterations_mean))
                    }),
                );
            }
            sheet.push(Kind::Measured, cells);
        }
    }
    sheet
}

/// What the table shows.
pub(super) fn note(basin: &Basin) -> String {
    let trials = basin.cells.first().map_or(0, |c| c.trials);
    format!(
        "Share of {trials} random starts that end within {} px of the truth, by the distance of the start (rms \
         displacement of the landmarks) and the tilt of the object against the frontal view; in brackets the mean number \
         of iterations of those that converged, of at most {PATIENT_STEPS} per \
         level. The same seeded starts for every method; backend {}.",
        basin.converged_px, basin.backend
    )
}

fn markdown(basin: &Basin) -> String {
    format!("# How far away a start may be\n\n{}\n\n{}", note(basin), sheet(basin).markdown())
}

/// Share over distance: a column per tilt, a row with and one without the pyramid.
fn plot(basin: &Basin) -> Document {
    let studied = |m: &Method| basin.cells.iter().any(|c| c.method == *m);
    let methods: Vec<Method> = Method::ALL.into_iter().filter(studied).collect();
    let mut panels = Vec::new();
    for (pyramid, words) in [(true, "with pyramid"), (false, "full size only")] {
        for tilt in TILTS_DEG {
            let lines = methods.iter().zip(0_u32..).map(|(&method, k)| {
                let aside = 0.45 * (f64::from(k) - (methods.len() as f64 - 1.0) / 2.0);
                let here = basin
                    .cells
                    .iter()
                    .filter(|c| (c.method, c.pyramid, c.tilt_deg) == (method, pyramid, tilt));
                let points = here.map(|c| [c.start_px + aside, c.share]).collect();
                Line { look: look(method), pieces: vec![points], markers: (1, 0) }
            });
            panels.push(Panel {
                title: format!("tilt {tilt}°, {words}"),
                x: Axis::linear("start (px rms)", 0.0, 35.0),
                y: Axis::linear("share converged", -0.03, 1.03),
                lines: lines.collect(),
            });
        }
    }
    let legend: Vec<_> = methods.iter().map(|&m| (look(m), m.name().to_owned())).collect();
    figure(&panels, 3, &legend, "Share of converged starts over their distance")
}
