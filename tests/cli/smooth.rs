//! Smoothed poses beside the tracked ones.

use std::fs;

use serde_json::Value;

use crate::program::{FRAMES, folder, json, made, refused};

/// Columns but the last, which is the time.
fn rows(path: &std::path::Path) -> Vec<String> {
    let text = fs::read_to_string(path).expect("results");
    text.lines().skip(1).map(|l| l.rsplit_once(',').expect("columns").0.to_owned()).collect()
}

#[test]
fn the_tracked_poses_stay_beside_the_smoothed_ones() {
    let (m, out) = (made(), folder("smooth"));
    let path = |name: &str| out.join(name);
    let track = format!("track {} {} --scene 1 --init gt --backend cpu", m.model.display(), m.data.display());
    let plain = json(&format!("{track} --out {}", path("plain.csv").display()));
    assert_eq!(plain["smoothed"], Value::Null, "{plain}");
    let (raw, smooth) = (path("raw.csv"), path("smooth.csv"));
    let both = format!("{track} --out {} --smooth {}", raw.display(), smooth.display());
    let t = json(&format!("{both} --lag 80 --fps 25"));
    let s = &t["smoothed"];
    assert_eq!(
        (s["lag_frames"].as_u64(), s["lag_ms"].as_f64(), s["fps"].as_f64()),
        (Some(2), Some(80.0), Some(25.0)),
        "{t}"
    );
    assert_eq!(rows(&raw), rows(&path("plain.csv")), "tracked poses are not touched");
    let frame = |row: &String| row.split(',').nth(1).map(str::to_owned);
    let [a, b] = [rows(&raw), rows(&smooth)];
    assert_eq!(
        a.iter().map(frame).collect::<Vec<_>>(),
        b.iter().map(frame).collect::<Vec<_>>(),
        "every frame"
    );
    assert!(a.iter().zip(&b).any(|(a, b)| a != b), "nothing was smoothed");
    let e = json(&format!("eval {} {} --scene 1", smooth.display(), m.data.display()));
    assert_eq!((e["frames"].as_u64(), e["lost"].as_u64()), (Some(FRAMES as u64), Some(0)), "{e}");
    assert!(e["rms_t_mm"].as_f64().is_some_and(|mm| mm < 0.1), "{e}");
    refused(&format!("{both} --fps 0"), &["--fps", "more than 0"]);
    refused(&format!("{both} --lag -1"), &["--lag", "milliseconds"]);
}
