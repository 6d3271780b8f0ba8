//! Plots of an experiment: the six coefficients over time, and the errors over time.

use svg::Document;

use super::plot::{Axis, Line, Panel, figure};
use super::record::{Coefficients, Report, Run, SequenceRecord};
use super::theme::{Look, TRUTH, look};

/// Markers per line.
const MARKERS: usize = 9;
const TITLES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

/// The six coefficients of the end-effector's motion: truth and every method.
pub(super) fn coefficients(report: &Report, sequence: &SequenceRecord) -> Document {
    let runs: Vec<&Run> = report.shown(sequence.number).collect();
    let frames = || frame_axis(sequence);
    let panels: Vec<Panel> = [0, 3, 1, 4, 2, 5]
        .map(|k| {
            let pick = |c: &Coefficients| [f64::from(c.frame), c.values[k]];
            let truth = sequence.truth.iter().map(pick).collect();
            let mut lines = vec![Line { look: TRUTH, pieces: vec![truth], markers: (1, 0) }];
            lines.extend(runs.iter().enumerate().map(|(i, run)| {
                line(run, i, run.coefficients.iter().map(|c| Some(pick(c))), sequence.frames)
            }));
            let unit = if k < 3 { "mm" } else { "degrees" };
            let values = sequence.truth.iter().map(|c| c.values[k]);
            Panel { title: TITLES[k].into(), x: frames(), y: Axis::around(unit, values), lines }
        })
        .into();
    let mut legend: Vec<(Look, String)> = vec![(TRUTH, "truth".into())];
    legend.extend(names(&runs));
    figure(&panels, 2, &legend, "The six coefficients of the end-effector's motion over the frames")
}

/// Errors of the object's pose on a logarithmic scale.
pub(super) fn errors(report: &Report, sequence: &SequenceRecord) -> Document {
    let runs: Vec<&Run> = report.shown(sequence.number).collect();
    type Pick = fn(&super::record::FrameError) -> Option<f64>;
    let kinds: [(&str, &str, Pick); 2] =
        [("position of the object's centre", "mm", |f| f.t_mm), ("rotation", "degrees", |f| f.r_deg)];
    let panels: Vec<Panel> = kinds
        .map(|(title, unit, pick)| {
            let values = runs.iter().flat_map(|r| &r.frames).filter(|f| !f.lost).filter_map(pick);
            let lines = runs.iter().enumerate().map(|(i, run)| {
                let points = run
                    .frames
                    .iter()
                    .map(|f| Some([f64::from(f.frame), pick(f).filter(|_| !f.lost)?.max(1e-9)]));
                line(run, i, points, sequence.frames)
            });
            let y = Axis::decades(unit, values);
            Panel { title: title.into(), x: frame_axis(sequence), lines: lines.collect(), y }
        })
        .into();
    figure(&panels, 2, &names(&runs), "Errors of the object's pose over the frames")
}

fn frame_axis(sequence: &SequenceRecord) -> Axis {
    let last = sequence.truth.last().map_or(1, |c| c.frame.max(1));
    Axis::linear("frame", 0.0, f64::from(last))
}

fn names(runs: &[&Run]) -> Vec<(Look, String)> {
    runs.iter().map(|r| (look(r.method), r.method.name().to_owned())).collect()
}

/// The line of run number `index`, broken where points are missing; the markers of different lines keep apart.
fn line(run: &Run, index: usize, points: impl Iterator<Item = Option<[f64; 2]>>, frames: usize) -> Line {
    let mut pieces: Vec<Vec<[f64; 2]>> = vec![Vec::new()];
    let mut before: Option<f64> = None;
    for point in points {
        let Some(point) = point else {
            before = None;
            continue;
        };
        // A frame that was left out is a gap as well.
        let joined = before.is_some_and(|b| point[0] - b < 1.5);
        match pieces.last_mut() {
            Some(piece) if joined || piece.is_empty() => piece.push(point),
            _ => pieces.push(vec![point]),
        }
        before = Some(point[0]);
    }
    let every = (frames / MARKERS).max(1);
    Line { look: look(run.method), pieces, markers: (every, index * every / 4) }
}
