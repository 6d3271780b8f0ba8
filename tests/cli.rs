//! Does every command run on simulated data, write what `docs/formats.md` says, and fail well?

#[path = "cli/bad_input.rs"]
mod bad_input;
#[path = "cli/bad_output.rs"]
mod bad_output;
#[path = "cli/cell.rs"]
mod cell;
#[path = "cli/first_pose.rs"]
mod first_pose;
#[path = "cli/method.rs"]
mod method;
#[path = "cli/program.rs"]
mod program;
#[path = "cli/repeat.rs"]
mod repeat;
#[path = "cli/smooth.rs"]
mod smooth;
#[path = "cli/stereo.rs"]
mod stereo;

use std::fs;
use std::path::Path;

use program::{FRAMES, done, folder, json, made, names, run};
use serde_json::Value;

/// Checks that a JSON object has exactly these members, in this order.
fn check_members(what: &str, object: &Value, expected: &[&str]) {
    let found: Vec<&str> = object.as_object().expect(what).keys().map(String::as_str).collect();
    assert_eq!(found, expected, "members of {what}");
}

/// Checks the members of an evaluation, and that the figures that must be known are numbers.
fn check_evaluation(what: &str, e: &Value) {
    for axis in ["x", "y", "z"] {
        check_members(what, &e["translation_mm"][axis], &["avg", "std", "max"]);
        check_members(what, &e["rotation_deg"][axis], &["avg", "std", "max"]);
    }
    check_members(what, &e["add_mm"], &["median", "p95"]);
    check_members(what, &e["corner_px"], &["median", "p95", "max"]);
    check_members(what, &e["relative"], &["t_mm_median", "r_deg_median"]);
    check_members(what, &e["jitter"], &["t_mm", "r_deg"]);
    check_members(what, &e["ms_per_frame"], &["median", "p95"]);
    for name in ["frames", "lost", "missing", "without_truth", "rms_t_mm", "rms_r_deg"] {
        assert!(e[name].is_number(), "{what}: {name} is {}", e[name]);
    }
    assert_eq!((e["frames"].as_u64(), e["lost"].as_u64()), (Some(FRAMES as u64), Some(0)), "{what}: {e}");
    assert!(e["rms_t_mm"].as_f64() < Some(0.1), "{what}: {e}");
}

const EVALUATION: [&str; 14] = [
    "frames",
    "lost",
    "missing",
    "without_truth",
    "rms_t_mm",
    "rms_r_deg",
    "translation_mm",
    "rotation_deg",
    "add_mm",
    "corner_px",
    "relative",
    "jitter",
    "ms_per_frame",
    "iterations_mean",
];

#[test]
fn demo_shows_both_directions_and_can_be_repeated() {
    let out = folder("demo");
    let summary = out.join("summary.json");
    let (demo, json) = (out.join("demo"), summary.display());
    for _ in 0..2 {
        let text =
            done(&format!("demo --frames {FRAMES} --backend cpu --out {} --json {json}", demo.display()));
        assert!(text.contains("translation z") && text.contains("time per frame"), "{text}");
    }
    let summary: Value = serde_json::from_slice(&fs::read(&summary).expect("written")).expect("JSON");
    check_members("demo", &summary, &["sequences"]);
    for (sequence, tracked) in summary["sequences"].as_array().expect("a list").iter().zip([1, 2]) {
        check_members("sequence", sequence, &[&["name", "method", "backend"], &EVALUATION[..]].concat());
        check_evaluation("sequence", sequence);
        assert!(sequence["iterations_mean"].is_number(), "{sequence}");
        assert!(demo.join(format!("scene-{tracked}.jsonl")).is_file(), "details of scene {tracked}");
        assert!(demo.join(format!("scene-{tracked}.aam6d")).is_file(), "model of scene {tracked}");
        let pictures = names(&demo.join(format!("overlay-{tracked}")));
        assert_eq!(pictures, ["000000.png"], "pictures of scene {tracked}");
        let results = fs::read_to_string(demo.join(format!("scene-{tracked}.csv"))).expect("results");
        assert_eq!(results.lines().count(), 1 + FRAMES, "a header and a line per frame");
    }
}

#[test]
fn simulate_and_train_say_what_they_made() {
    let out = folder("simulate");
    let data = out.join("data");
    let s = json(&format!(
        "simulate --scene box --frames 1 --seed 3 --light --occlusion 0.2 --noise 1 --out {}",
        data.display()
    ));
    check_members("simulate", &s, &["out", "scenes", "frames_per_scene", "options"]);
    assert_eq!(s["options"]["occlusion"].as_f64(), Some(0.2), "{s}");
    assert_eq!(names(&data.join("test/000002")), ["gray", "scene_camera.json", "scene_gt.json"], "a scene");
    let model = out.join("model.aam6d");
    let t = json(&format!("train {} --scene 1 --frames 0 --out {}", data.display(), model.display()));
    let members =
        ["model", "object", "triangles", "triangles_with_chart", "reference_views", "template_px", "modes"];
    check_members("train", &t, &members);
    assert_eq!(t["template_px"].as_array().map(Vec::len), Some(4), "four levels: {t}");
    assert_eq!(names(&out), ["data", "model.aam6d"], "nothing else is left");
}

/// Numbers of a JSON list.
fn count(value: &Value) -> usize {
    let list = value.as_array().expect("a list");
    list.iter().filter(|v| v.as_f64().is_some_and(f64::is_finite)).count()
}

/// The parts of a frame's time are known and not more than the whole.
fn check_times(line: &Value) {
    let stages = ["visibility_ms", "accumulate_ms", "solve_ms", "score_ms", "search_ms"];
    let before = ["decode_ms", "rectify_ms", "set_frame_ms"];
    check_members("times", &line["times"], &[&before[..], &stages].concat());
    let ms = |name: &&str| line["times"][*name].as_f64().expect("a number");
    assert!(before.iter().take(1).chain(&stages[..4]).all(|name| ms(name) > 0.0), "{line}");
    let parts: f64 = before.iter().skip(1).chain(&stages).map(ms).sum();
    assert!(Some(parts) <= line["time_ms"].as_f64(), "{parts} ms of parts: {line}");
}

fn check_details(path: &Path) {
    let text = fs::read_to_string(path).expect("details");
    let lines: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).expect("JSON")).collect();
    assert_eq!(lines.len(), FRAMES, "one line per frame");
    for (k, line) in lines.iter().enumerate() {
        let members = [
            "scene_id",
            "frame",
            "status",
            "probability",
            "spread_px",
            "camera_from_object",
            "appearance",
            "covariance_ros",
            "rms",
            "iterations",
            "converged",
            "visible",
            "correlation",
            "recognised",
            "time_ms",
            "times",
        ];
        check_members("details", line, &members);
        check_times(line);
        assert_eq!(
            (line["frame"].as_u64(), line["status"].as_str()),
            (Some(k as u64), Some("tracking")),
            "{line}"
        );
        let pose = &line["camera_from_object"];
        assert_eq!((count(&pose["rotation"]), count(&pose["translation_mm"])), (9, 3), "{line}");
        assert_eq!(count(&line["covariance_ros"]), 36, "{line}");
    }
}

#[test]
fn track_align_and_eval_work_together() {
    let (m, out) = (made(), folder("track"));
    let path = |name: &str| out.join(name).display().to_string();
    let (model, data) = (m.model.display(), m.data.display());
    let t = json(&format!(
        "track {model} {data} --scene 1 --init gt --backend cpu --out {} --details {} --overlay {} --tum {}",
        path("new/results.csv"),
        path("details.jsonl"),
        path("overlay"),
        path("poses.tum")
    ));
    let members = [
        "frames",
        "tracked",
        "uncertain",
        "lost",
        "lost_frames",
        "ms_per_frame",
        "iterations_mean",
        "method",
        "backend",
        "results",
    ];
    check_members("track", &t, &members);
    assert_eq!((t["tracked"].as_u64(), t["uncertain"].as_u64()), (Some(FRAMES as u64), Some(0)), "{t}");
    assert_eq!(t["backend"], "cpu", "{t}");
    check_details(&out.join("details.jsonl"));
    assert_eq!(names(&out.join("overlay")).len(), FRAMES, "a picture per frame");
    let tum = fs::read_to_string(out.join("poses.tum")).expect("a trajectory");
    let poses: Vec<&str> = tum.lines().filter(|l| !l.starts_with('#')).collect();
    assert!(poses.len() == FRAMES && poses.iter().all(|l| l.split(' ').count() == 8), "{tum}");
    assert_eq!(names(&out.join("new")), ["results.csv"], "no partial file is left");

    // Every start twice, in the opposite order.
    let rows = fs::read_to_string(out.join("new/results.csv")).expect("results");
    let mut starts: Vec<&str> = rows.lines().skip(1).chain(rows.lines().skip(1)).collect();
    starts.reverse();
    fs::write(out.join("starts.csv"), starts.join("\n")).expect("written");
    let align = format!("align {model} {data} --scene 1 --backend cpu --starts {}", path("starts.csv"));
    let a = json(&format!("{align} --out {}", path("aligned.csv")));
    check_members(
        "align",
        &a,
        &["starts", "aligned", "lost", "iterations_mean", "method", "backend", "results"],
    );
    let aligned = fs::read_to_string(out.join("aligned.csv")).expect("results");
    let frame = |line: &str| line.split(',').nth(1).map(str::to_owned);
    let found: Vec<_> = aligned.lines().skip(1).map(frame).collect();
    assert_eq!(found, starts.iter().map(|l| frame(l)).collect::<Vec<_>>(), "in the order of the starts");

    let eval = |results: &str, more: &str| json(&format!("eval {} {data} --scene 1 {more}", path(results)));
    let e = eval("new/results.csv", &format!("--details {}", path("details.jsonl")));
    check_members("eval", &e, &[&EVALUATION[..], &["normalised_error_squared"]].concat());
    check_evaluation("eval", &e);
    assert_eq!(e["iterations_mean"], t["iterations_mean"], "from the details");
    assert_eq!(eval("aligned.csv", "")["frames"].as_u64(), Some(2 * FRAMES as u64), "every start is judged");
}

#[test]
fn info_names_adapters_and_choice() {
    let i = json("info --backend cpu");
    assert!(i["version"].is_string() && i["chosen"]["why"].is_string(), "{i}");
    assert_eq!(i["chosen"]["backend"], "cpu", "{i}");
    #[cfg(feature = "gpu")]
    check_members("info", &i, &["version", "adapters", "chosen", "self_test"]);
}

#[test]
fn exit_codes_tell_success_failure_and_usage_apart() {
    for words in ["--help", "--version", "track --help"] {
        assert_eq!(run(words).code, Some(0), "{words}");
    }
    let usage = [
        "",
        "fly",
        "track",
        "simulate",
        "train . --scene 1 --out m",
        "train . --scene x --frames 0 --out m",
        "train . --scene 1 --frames 0,x --out m",
        "demo --frames 1",
        "demo --backend tpu",
        "simulate --out d --scene cup",
        "eval r.csv . --scene 1 --poses",
        "info --jsn -",
    ];
    for words in usage {
        let outcome = run(words);
        assert_eq!((outcome.code, outcome.stdout.as_str()), (Some(2), ""), "{words}: {outcome:?}");
        assert!(
            outcome.stderr.contains("Usage") || outcome.stderr.contains("--help"),
            "{words}: {outcome:?}"
        );
    }
    assert_eq!(run("eval no/such/results.csv . --scene 1").code, Some(1), "a failure");
}
