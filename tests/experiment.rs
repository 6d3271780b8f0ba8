//! A tiny experiment from end to end: every file is there, and every number that it promises.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn experiment(out: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_aam6d"));
    command.arg("experiment").arg("--out").arg(out).args(["--backend", "cpu"]).args(more);
    command.output().expect("the program starts")
}

fn succeed(out: &Path, more: &[&str]) {
    let output = experiment(out, more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&text(path)).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// What a page must not have if it is to need nothing but itself.
fn external_references(page: &str) -> Vec<&'static str> {
    let marks = ["<script", "<link", "@import", "url(", "src=\"http", "href=\"http", "src=\"//", "href=\"//"];
    let local = ["src=\"figures", "src=\"overlays", "href=\"figures", "src=\"/", "src=\"file:"];
    marks.into_iter().chain(local).filter(|mark| page.contains(mark)).collect()
}

#[test]
fn a_tiny_experiment_writes_everything() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("new");
    succeed(&out, &["--frames", "4", "--scene", "relief", "--methods", "inverse-compositional,edge"]);

    let results = json(&out.join("results.json"));
    assert_eq!(results["complete"], true, "complete");
    let runs = results["runs"].as_array().expect("runs");
    assert_eq!(runs.len(), 4, "two methods in two sequences");
    for run in runs {
        assert_eq!(run["motion_errors"].as_array().map(Vec::len), Some(6), "{run}");
        assert_eq!(run["frames"].as_array().map(Vec::len), Some(4), "{run}");
        assert!(run["evaluation"]["rms_t_mm"].as_f64().is_some_and(|mm| mm < 5.0), "{run}");
        assert!(run["evaluation"]["iterations_mean"].is_number(), "{run}");
    }
    assert_eq!(results["published"]["rows"].as_array().map(Vec::len), Some(6), "the paper's rows");
    assert_eq!(results["published"]["rows"][0]["motion_errors"][0]["avg"], 6.3, "as printed");

    for name in ["coefficients", "errors", "template", "weights"] {
        for sequence in [1, 2] {
            let svg = text(&out.join(format!("figures/{name}-{sequence}.svg")));
            assert!(svg.starts_with("<svg") && svg.contains("prefers-color-scheme"), "{name}-{sequence}");
        }
    }
    assert!(out.join("figures/weights-2.png").is_file(), "the weights as a picture");
    assert!(out.join("runs/2-edge-cpu.csv").is_file(), "the poses of a run");
    check_table(&text(&out.join("table1.md")));
    let page = text(&out.join("report.html"));
    assert_eq!(external_references(&page), Vec::<&str>::new(), "the page needs nothing else");
    assert_eq!(page.matches("data:image/jpeg").count(), 4, "overlays of both sequences");
    assert_eq!(external_references("<img src=\"http://x\">"), ["src=\"http"], "the check can fail");
}

/// Per sequence the paper's three methods and ours, each with average, deviation and maximum.
fn check_table(table: &str) {
    let count = |mark: &str| table.lines().filter(|l| l.starts_with('|') && l.contains(mark)).count();
    for method in ["proposed method", "previous method [15]", "geometric method [19]"] {
        assert_eq!(count(&format!("| {method}, as published | avg |")), 2, "{method}:\n{table}");
    }
    for method in ["inverse-compositional, cpu", "edge, cpu"] {
        assert_eq!(count(&format!("| {method} | avg |")), 2, "{method}:\n{table}");
    }
    for statistic in ["| avg |", "| std |", "| max |"] {
        assert_eq!(count(statistic), 10, "{statistic} of five rows in two sequences:\n{table}");
    }
}

#[test]
fn the_cell_is_trained_from_clicks_and_the_basin_joins_the_page() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path();
    let method = ["--methods", "inverse-compositional"];
    succeed(out, &[&["--frames", "3", "--click-noise", "0"], method.as_slice()].concat());
    let results = json(&out.join("results.json"));
    assert_eq!(results["options"]["scene"], "cell", "the default scene");
    assert_eq!(results["sequences"][0]["landmarks"], 76, "as in the paper");

    succeed(out, &[&["--study", "basin", "--trials", "6"], method.as_slice()].concat());
    let basin = json(&out.join("basin.json"));
    let cells = basin["cells"].as_array().expect("cells");
    assert_eq!(cells.len(), 24, "three tilts, four distances, with and without the pyramid");
    let easy = cells.iter().find(|c| c["pyramid"] == true && c["start_px"] == 5.0).expect("5 px");
    assert_eq!((&easy["trials"], &easy["share"]), (&6.into(), &1.0.into()), "{easy}");
    assert!(text(&out.join("basin.md")).contains("| 35, 30 |"), "the table");
    let page = text(&out.join("report.html"));
    assert!(page.contains("Table 1") && page.contains("tilt 35°"), "both studies are on the page");
}

#[test]
fn wrong_use_is_named() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    fs::write(folder.path().join("mine.txt"), "keep").expect("written");
    let message = |more: &[&str]| {
        let output = experiment(folder.path(), more);
        assert!(!output.status.success(), "refused");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    assert!(message(&[]).contains("not from an earlier experiment"), "a folder with other files");
    assert!(message(&["--methods", "magic"]).contains("inverse-compositional"), "the methods are listed");
    assert!(message(&["--trials", "0"]).contains("from 1 on"), "no trials");
    assert!(folder.path().join("mine.txt").is_file(), "nothing was removed");
}
