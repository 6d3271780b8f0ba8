//! The built program, a small simulated data set, and folders of their own for every test.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

/// How a run of the program ended.
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Runs the program with the given words, separated by spaces; paths must not contain any.
pub(crate) fn run(words: &str) -> Outcome {
    run_with(words, &[])
}

/// Runs the program with variables of its environment set.
pub(crate) fn run_with(words: &str, variables: &[(&str, &str)]) -> Outcome {
    let output = Command::new(env!("CARGO_BIN_EXE_aam6d"))
        .args(words.split_whitespace())
        .envs(variables.iter().copied())
        .output()
        .expect("the program starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Outcome { code: output.status.code(), stdout: text(&output.stdout), stderr: text(&output.stderr) }
}

/// Runs the program, which must succeed; what it printed.
pub(crate) fn done(words: &str) -> String {
    let outcome = run(words);
    assert_eq!(outcome.code, Some(0), "{words}: {outcome:?}");
    outcome.stdout
}

/// Runs the program, which must succeed and print JSON.
pub(crate) fn json(words: &str) -> serde_json::Value {
    let text = done(&format!("{words} --json -"));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{words}: {e} in {text}"))
}

/// Runs the program, which must fail with one line on what is wrong that holds all the parts.
pub(crate) fn refused(words: &str, parts: &[&str]) {
    check_refused(words, &run(words), parts);
}

pub(crate) fn check_refused(words: &str, outcome: &Outcome, parts: &[&str]) {
    let shown = format!("{words}: {outcome:?}");
    assert_eq!(outcome.code, Some(1), "{shown}");
    assert!(!outcome.stderr.contains("panicked"), "{shown}");
    let line = outcome.stderr.lines().find(|l| l.starts_with("aam6d: ")).unwrap_or_default();
    // What to do stands behind a semicolon, or in what the operating system says.
    assert!(line.contains("; ") || line.contains("os error"), "no remedy in {shown}");
    for part in parts {
        assert!(line.contains(part), "no {part:?} in {shown}");
    }
}

/// An empty folder for one test.
pub(crate) fn folder(test: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cli").join(test);
    if folder.exists() {
        fs::remove_dir_all(&folder).expect("left over from an earlier run");
    }
    fs::create_dir_all(&folder).expect("a folder for tests");
    folder
}

/// Made once by the program itself: the data set, a model of scene 2, and the track of scene 1.
pub(crate) struct Made {
    pub(crate) data: PathBuf,
    pub(crate) model: PathBuf,
    pub(crate) results: PathBuf,
}

/// Frames of each of the two scenes.
pub(crate) const FRAMES: usize = 4;

pub(crate) fn made() -> &'static Made {
    static MADE: LazyLock<Made> = LazyLock::new(|| {
        let folder = folder("made");
        let made = Made {
            data: folder.join("data"),
            model: folder.join("model.aam6d"),
            results: folder.join("results.csv"),
        };
        let Made { data, model, results } = &made;
        done(&format!("simulate --frames {FRAMES} --out {}", data.display()));
        done(&format!("train {} --scene 2 --frames 0,2 --out {}", data.display(), model.display()));
        let track = format!("track {} {} --scene 1 --init gt", model.display(), data.display());
        done(&format!("{track} --backend cpu --out {}", results.display()));
        made
    });
    &MADE
}

/// A copy of the data set to damage.
pub(crate) fn copied(test: &str) -> PathBuf {
    let to = folder(test).join("data");
    copy(&made().data, &to);
    to
}

fn copy(from: &Path, to: &Path) {
    if from.is_dir() {
        fs::create_dir_all(to).expect("a new folder");
        for entry in fs::read_dir(from).expect("a folder") {
            let name = entry.expect("an entry").file_name();
            copy(&from.join(&name), &to.join(&name));
        }
    } else {
        fs::copy(from, to).expect("a copy");
    }
}

/// Replaces the first occurrence of a text in a file.
pub(crate) fn replace(path: &Path, old: &str, new: &str) {
    let text = fs::read_to_string(path).expect("a text");
    assert!(text.contains(old), "no {old:?} in {}", path.display());
    fs::write(path, text.replacen(old, new, 1)).expect("written");
}

/// Cuts a file in half.
pub(crate) fn truncate(path: &Path) {
    let bytes = fs::read(path).expect("a file");
    fs::write(path, &bytes[..bytes.len() / 2]).expect("written");
}

/// Names of what is in a folder.
pub(crate) fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}
