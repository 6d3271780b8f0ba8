//! The rules of `docs/architecture.md`, checked on the source text: imports go down, every stage has its twin, files
//! stay short. Each checker is shown to fail on a made-up source.

#[path = "architecture/source.rs"]
mod source;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use source::{Source, code_of, imports};

/// Modules and their floors. A module may import lower floors; on the ground floor, the entries before it as well.
const FLOORS: [(&str, u8); 13] = [
    ("error", 0),
    ("geometry", 0),
    ("imaging", 0),
    ("dataset", 1),
    ("simulate", 2),
    ("model", 2),
    ("backend", 3),
    ("train", 4),
    ("align", 4),
    ("find", 5),
    ("track", 6),
    ("eval", 7),
    ("cli", 8),
];
/// `eval` judges the poses of any tracker, so it knows none.
const EVAL_MAY_USE: [&str; 3] = ["error", "geometry", "dataset"];
/// What the crate root re-exports from the ground floor.
const ROOT_NAMES: [&str; 2] = ["Error", "Result"];
/// Names that attract things which belong elsewhere.
const BAGS: [&str; 5] = ["utils", "misc", "common", "helpers", "types"];
/// Aimed at; longer files are named whenever the test fails.
const GOAL_LINES: usize = 300;
const MAX_LINES: usize = 500;
const MAX_SHADER_LINES: usize = 150;

/// Imports that go up, sideways, or around the floors through the crate root.
fn wrong_imports(source: &Source) -> Vec<String> {
    let module = source.module();
    let Some(&own) = module.first() else { return Vec::new() };
    let Some(at) = FLOORS.iter().position(|(name, _)| *name == own) else {
        return vec![format!("{}: the module {own} has no floor in this test", source.path)];
    };
    let allowed = |target: &str| match FLOORS.iter().position(|(name, _)| *name == target) {
        _ if own == "eval" => target == own || EVAL_MAY_USE.contains(&target),
        Some(other) if FLOORS[at].1 == 0 => other <= at,
        Some(other) => other == at || FLOORS[other].1 < FLOORS[at].1,
        None => false,
    };
    let wrong = |path: &Vec<String>, unknown_is_wrong: bool| {
        let names: Vec<&str> = path.iter().map(String::as_str).collect();
        let first = names.first().copied().unwrap_or_default();
        let crosses =
            |a: &str, b: &str| module.starts_with(&["backend", a]) && names.starts_with(&["backend", b]);
        let known = FLOORS.iter().any(|(name, _)| *name == first);
        let fine = if known { allowed(first) } else { !unknown_is_wrong || ROOT_NAMES.contains(&first) };
        let fine = fine && !crosses("cpu", "gpu") && !crosses("gpu", "cpu");
        (!fine).then(|| format!("{}: must not use crate::{}", source.path, names.join("::")))
    };
    // Out of a test module inside a file, `super::` names an item of the file and not a module.
    let absolute = imports(source, "crate::");
    let relative = imports(source, "super::");
    let problems = absolute.iter().filter_map(|p| wrong(p, true));
    problems.chain(relative.iter().filter_map(|p| wrong(p, false))).collect()
}

/// Stages without a partner on the other side, or whose function has another name.
fn missing_twins(shaders: &[Source], twins: &[Source]) -> Vec<String> {
    let stem = |s: &Source| {
        let name = s.path.rsplit('/').next().unwrap_or_default();
        name.split('.').next().unwrap_or_default().to_owned()
    };
    let stages = |sources: &[Source], not: &str| -> BTreeSet<String> {
        sources.iter().map(stem).filter(|s| s != not).collect()
    };
    let (on_device, on_host) = (stages(shaders, "common"), stages(twins, "mod"));
    let mut problems = Vec::new();
    for stage in on_device.symmetric_difference(&on_host) {
        let side = if on_host.contains(stage) { "shader" } else { "twin on the CPU" };
        problems.push(format!("stage {stage} has no {side}"));
    }
    if on_device.is_empty() {
        problems.push("there are no stages in shaders/".into());
    }
    for source in shaders.iter().chain(twins) {
        let (stage, code) = (stem(source), code_of(&source.text));
        let named = [format!("fn {stage}("), format!("fn {stage}<"), format!("::{stage};")];
        if !["common", "mod"].contains(&stage.as_str()) && !named.iter().any(|n| code.contains(n)) {
            problems.push(format!("{}: no function {stage}", source.path));
        }
    }
    problems
}

/// Files beyond the limits, `unsafe`, ignored tests, and modules with the name of a bag.
fn wrong_shape(source: &Source) -> Vec<String> {
    let code = code_of(&source.text);
    let has_word = |word: &str| {
        let mut words = code.split(|c: char| !(c == '_' || c.is_alphanumeric()));
        words.any(|w| w == word)
    };
    let lines = source.text.lines().count();
    let limit = if source.path.ends_with(".wgsl") { MAX_SHADER_LINES } else { MAX_LINES };
    let mut problems = Vec::new();
    if lines > limit {
        problems.push(format!("{}: {lines} lines, at most {limit}", source.path));
    }
    if has_word("unsafe") {
        problems.push(format!("{}: unsafe code", source.path));
    }
    if code.contains("#[ignore") {
        problems.push(format!("{}: an ignored test; run it or remove it", source.path));
    }
    if source.module().iter().any(|m| BAGS.contains(m)) {
        problems.push(format!("{}: give the module the name of what it holds", source.path));
    }
    problems
}

/// All files with this ending below a folder of the repository; none if there is no such folder.
fn sources(folder: &str, ending: &str) -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    let mut folders = vec![root.join(folder)];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = fs::read_dir(folder) else { continue };
        for path in entries.map(|e| e.expect("a readable folder").path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == ending) {
                let text = fs::read_to_string(&path).expect("UTF-8 text");
                let path =
                    path.strip_prefix(root).expect("below the root").to_string_lossy().replace('\\', "/");
                found.push(Source { path, text });
            }
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    found
}

fn made_up(path: &str, text: &str) -> Source {
    Source { path: path.into(), text: text.into() }
}

#[test]
fn imports_go_down() {
    let all = sources("src", "rs");
    assert!(all.len() > 20, "only {} files found in src/", all.len());
    let problems: Vec<String> = all.iter().flat_map(wrong_imports).collect();
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn every_stage_has_its_twin() {
    // Folders below src/backend/cpu are faster second implementations of a twin.
    let mut twins = sources("src/backend/cpu", "rs");
    twins.retain(|s| s.module().len() <= 3);
    // Folders below shaders hold what several stages share.
    let mut stages = sources("shaders", "wgsl");
    stages.retain(|s| s.path.matches('/').count() == 1);
    let problems = missing_twins(&stages, &twins);
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn files_are_short_and_safe() {
    let folders =
        [("src", "rs"), ("tests", "rs"), ("benches", "rs"), ("examples", "rs"), ("shaders", "wgsl")];
    let all: Vec<Source> = folders.iter().flat_map(|(folder, ending)| sources(folder, ending)).collect();
    let problems: Vec<String> = all.iter().flat_map(wrong_shape).collect();
    let long: Vec<String> = all
        .iter()
        .map(|s| (s.text.lines().count(), &s.path))
        .filter(|(n, _)| *n > GOAL_LINES)
        .map(|(n, p)| format!("{p}: {n}"))
        .collect();
    assert!(
        problems.is_empty(),
        "{}\nbeyond the goal of {GOAL_LINES}: {}",
        problems.join("\n"),
        long.join(", ")
    );
}

/// A wrong import in every form Rust has for it must be found, and nothing else.
#[test]
fn the_checker_finds_wrong_imports() {
    let wrong = [
        ("src/geometry/a.rs", "use crate::model::Model;"),
        ("src/geometry/a.rs", "use crate::imaging::Pyramid;"),
        ("src/model/a.rs", "use crate::simulate::Texture;"),
        ("src/dataset/a.rs", "fn f() -> crate::track::Status { todo!() }"),
        ("src/train/a.rs", "use crate::{\n    error::Result,\n    align::{self, Options},\n};"),
        ("src/align/mod.rs", "use super::train::train;"),
        ("src/align/a.rs", "use super::super::train;"),
        ("src/eval/a.rs", "pub use crate::imaging::gray as grey;"),
        ("src/backend/cpu/a.rs", "use crate::backend::gpu::Context;"),
        ("src/backend/gpu/mod.rs", "use super::cpu::CpuBackend;"),
        ("src/model/a.rs", "let quote = '\"'; use crate::track::Tracker; // \""),
        ("src/align/a.rs", "use crate::Tracker;"),
        ("src/align/a.rs", "use crate::*;"),
        ("src/newcomer/a.rs", ""),
    ];
    for (path, text) in wrong {
        assert!(!wrong_imports(&made_up(path, text)).is_empty(), "{path}: {text}");
    }
    let right = [
        (
            "src/track/a.rs",
            "use crate::align::{Aligner, PoseEstimate as Estimate};\nuse crate::error::Result;",
        ),
        (
            "src/geometry/a.rs",
            "//! [`crate::track::Tracker`]\nuse crate::error::{Error, Result}; /* crate::cli */",
        ),
        (
            "src/model/a.rs",
            "const TEXT: &str = \"crate::track \\\" crate::cli\"; const RAW: &str = r#\"crate::cli\"#;",
        ),
        (
            "src/align/a.rs",
            "mod tests { use super::*; use super::cost; } fn f() -> crate::Result<()> { Ok(()) }",
        ),
        ("src/eval/a.rs", "use crate::dataset::Dataset; use super::errors::add_mm;"),
        ("src/backend/cpu/mod.rs", "use super::{Backend, Sums}; use crate::model::Model;"),
        ("src/lib.rs", "pub use crate::track::Tracker;"),
    ];
    for (path, text) in right {
        assert_eq!(wrong_imports(&made_up(path, text)), Vec::<String>::new(), "{path}: {text}");
    }
}

#[test]
fn the_checker_finds_missing_twins() {
    let shader = |stage: &str| made_up(&format!("shaders/{stage}.wgsl"), &format!("fn {stage}() {{}}"));
    let twin =
        |stage: &str| made_up(&format!("src/backend/cpu/{stage}.rs"), &format!("pub fn {stage}() {{}}"));
    let good = missing_twins(&[shader("common"), shader("warp")], &[twin("mod"), twin("warp")]);
    assert_eq!(good, Vec::<String>::new(), "a stage with its twin");
    assert_eq!(missing_twins(&[shader("warp"), shader("blur")], &[twin("warp")]).len(), 1, "no twin");
    assert_eq!(missing_twins(&[shader("warp")], &[twin("warp"), twin("blur")]).len(), 1, "no shader");
    assert_eq!(missing_twins(&[], &[]).len(), 1, "nothing at all");
    let misnamed = made_up("src/backend/cpu/warp.rs", "pub fn bend() {} // fn warp()");
    assert_eq!(missing_twins(&[shader("warp")], &[misnamed]).len(), 1, "another name");
}

#[test]
fn the_checker_finds_wrong_shapes() {
    let wrong = [
        ("src/a.rs", "x\n".repeat(MAX_LINES + 1)),
        ("shaders/a.wgsl", "x\n".repeat(MAX_SHADER_LINES + 1)),
        ("src/a.rs", "fn f() { unsafe { g() } }".into()),
        ("tests/a.rs", "#[test]\n#[ignore = \"slow\"]\nfn f() {}".into()),
        ("src/model/utils.rs", String::new()),
    ];
    for (path, text) in &wrong {
        assert_eq!(wrong_shape(&made_up(path, text)).len(), 1, "{path}");
    }
    let right = "// unsafe, #[ignore]\n#![forbid(unsafe_code)]\nconst A: &str = \"unsafe\";\n";
    assert_eq!(
        wrong_shape(&made_up("src/a.rs", right)),
        Vec::<String>::new(),
        "words in comments and strings"
    );
}
