//! Does the program give the same again, and with another order of reading?

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::program::{FRAMES, done, folder, made};

/// What does not depend on the clock.
fn without_times(path: &Path) -> Vec<Value> {
    let text = fs::read_to_string(path).expect("details");
    let mut lines: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).expect("JSON")).collect();
    for line in &mut lines {
        let members = line.as_object_mut().expect("an object");
        assert!(["time_ms", "times"].map(|m| members.remove(m)).iter().all(Option::is_some), "times");
    }
    lines
}

#[test]
fn reading_ahead_changes_nothing() {
    let (m, out) = (made(), folder("latency"));
    let details = |latency: &str| {
        let path = |end: &str| out.join(format!("{latency}.{end}"));
        let track = format!("track {} {} --scene 1 --backend cpu", m.model.display(), m.data.display());
        let files = format!("--out {} --details {}", path("csv").display(), path("jsonl").display());
        done(&format!("{track} {files} --latency {latency}"));
        without_times(&path("jsonl"))
    };
    let low = details("low");
    assert_eq!(low.len(), FRAMES, "every frame");
    assert_eq!(details("pipelined"), low, "the same results");
}

/// The same input gives the same bytes, apart from times.
#[test]
fn two_runs_give_the_same_bytes() {
    let (m, out) = (made(), folder("twice"));
    let timeless = |name: &str, cut: &str| {
        let text = fs::read_to_string(out.join(name)).expect("written");
        // The time stands last in every line.
        text.lines().map(|l| l.rsplit_once(cut).expect(cut).0.to_owned()).collect::<Vec<_>>()
    };
    let run = |k: usize| {
        let path = |name: &str| out.join(format!("{name}{k}")).display().to_string();
        done(&format!("simulate --frames {FRAMES} --out {}", path("data")));
        let train = format!("train {} --scene 2 --frames 0,1,2,3 --modes 2", path("data"));
        done(&format!("{train} --out {}", path("model")));
        let track = format!("track {} {} --scene 1 --init gt --backend cpu", path("model"), path("data"));
        done(&format!("{track} --out {} --details {}", path("results"), path("details")));
    };
    run(1);
    run(2);
    let bytes = |path: &Path| fs::read(path).expect("written");
    assert!(bytes(&out.join("model1")) == bytes(&out.join("model2")), "models differ");
    let image = "test/000001/gray/000003.png";
    assert!(bytes(&out.join("data1").join(image)) == bytes(&m.data.join(image)), "images differ");
    assert_eq!(timeless("results1", ","), timeless("results2", ","), "results");
    assert_eq!(timeless("details1", ",\"time_ms\""), timeless("details2", ",\"time_ms\""), "details");
}
