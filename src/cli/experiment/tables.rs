//! The tables of the report: Table 1 in the paper's form, and how each method did as a tracker.

use super::published;
use super::record::{Report, Run};
use super::sheet::{Kind, Sheet, number};
use crate::eval::ErrorStatistics;

const AXES: [&str; 6] = ["x (mm)", "y (mm)", "z (mm)", "rx (°)", "ry (°)", "rz (°)"];

/// Errors of the end-effector's motion since the first frame: the paper's rows, and below each ours.
pub(super) fn table1(report: &Report) -> Sheet {
    let mut sheet = Sheet::new(&[&["method", "", "lost"], AXES.as_slice()].concat(), 2);
    for sequence in &report.sequences {
        sheet.push(Kind::Heading, vec![format!("Sequence {}", sequence.number)]);
        for method in published::ALL {
            if let Some(errors) = published::errors(sequence.number, method) {
                push(&mut sheet, Kind::Published, &format!("{}, as published", method.name()), "", &errors);
            }
            let ours =
                report.runs.iter().filter(|r| (r.sequence, r.counterpart) == (sequence.number, method));
            for run in ours {
                let lost = run.lost_frames.len().to_string();
                push(&mut sheet, Kind::Measured, &title(run), &lost, &run.motion_errors);
            }
        }
    }
    sheet
}

fn title(run: &Run) -> String {
    format!("{}, {}", run.method.name(), run.backend)
}

fn push(sheet: &mut Sheet, kind: Kind, title: &str, lost: &str, errors: &[ErrorStatistics; 6]) {
    type Pick = fn(&ErrorStatistics) -> Option<f64>;
    let rows: [(&str, Pick); 3] = [("avg", |e| e.avg), ("std", |e| e.std), ("max", |e| e.max)];
    for (what, pick) in rows {
        let first = if what == "avg" { [title, what, lost] } else { ["", what, ""] };
        let mut cells: Vec<String> = first.map(str::to_owned).into();
        cells.extend(errors.iter().enumerate().map(|(k, e)| match (kind, pick(e)) {
            // As printed: one digit for millimetres, two for degrees.
            (Kind::Published, Some(v)) => format!("{v:.*}", if k < 3 { 1 } else { 2 }),
            (_, v) => number(v),
        }));
        sheet.push(kind, cells);
    }
}

/// One row per run: errors of the object's pose, losses, cost.
pub(super) fn summary(report: &Report) -> Sheet {
    let head = [
        "method",
        "backend",
        "lost",
        "position rms (mm)",
        "rotation rms (°)",
        "corners, median (px)",
        "iterations",
        "ms per frame",
        "95 % (ms)",
        "paper ÷ ours, avg",
        "paper ÷ ours, max",
    ];
    let mut sheet = Sheet::new(&head, 2);
    for sequence in &report.sequences {
        let title = format!("Sequence {}, trained on {}", sequence.number, sequence.trained_on);
        sheet.push(Kind::Heading, vec![title]);
        for run in report.runs.iter().filter(|r| r.sequence == sequence.number) {
            let e = &run.evaluation;
            let numbers = [
                e.rms_t_mm,
                e.rms_r_deg,
                e.corner_px.median,
                e.iterations_mean,
                e.ms_per_frame.median,
                e.ms_per_frame.p95,
                run.below_published.map(|b| b.avg),
                run.below_published.map(|b| b.max),
            ];
            let lost = format!("{} of {}", e.lost, e.frames);
            let mut cells = vec![run.method.name().to_owned(), run.backend.clone(), lost];
            cells.extend(numbers.map(number));
            sheet.push(Kind::Measured, cells);
        }
    }
    sheet
}

/// `table1.md`.
pub(super) fn markdown(report: &Report) -> String {
    format!(
        "# Table 1\n\n{}\n{}\n{}\n## As a tracker\n\n{}\n{}",
        TABLE1_NOTE,
        absent(report),
        table1(report).markdown(),
        SUMMARY_NOTE,
        summary(report).markdown()
    )
}

/// Says which backend took no part.
pub(super) fn absent(report: &Report) -> String {
    let why = |e: &super::methods::Engine| {
        e.absent.as_ref().map(|w| format!("Backend {} left out: {w}.\n", e.name))
    };
    report.backends.iter().filter_map(why).collect()
}

/// What Table 1 shows.
pub(super) const TABLE1_NOTE: &str = "Error of the end-effector's motion since the first frame, per coefficient (eqs. 19 \
     and 20 of the paper), over the frames that were not lost. Rows marked \"as published\" are the paper's own, \
     measured on a real robot with another object: they are other data and stand here for comparison of form and \
     size only. All other rows were measured by this run on simulated images with exact poses.\n";

/// What the second table shows.
pub(super) const SUMMARY_NOTE: &str = "Error of the object's pose: position of its centre, rotation, and corners of \
     its bounding box in the image. The method edge does \
     its work on the host, whatever the backend. Lost: given up by the tracker, or off by more than 5 cm or 5°. The last two \
     columns say how many times larger the published error is, at least, over the six coefficients.\n";
