//! `track` without a pose to start from: by a search, and by clicked points.

use std::fs;

use crate::program::{FRAMES, folder, json, made, refused};

#[test]
fn a_track_starts_by_itself() {
    let (m, out) = (made(), folder("auto"));
    let track = format!("track {} {} --scene 1 --backend cpu", m.model.display(), m.data.display());
    let t = json(&format!("{track} --distance 500..700 --out {}/r.csv", out.display()));
    assert_eq!(t["tracked"].as_u64(), Some(FRAMES as u64), "found in the first frame: {t}");
    // Nothing of the object is where it is looked for: every frame is lost, and none is an error.
    let t = json(&format!("{track} --distance 500..700 --box 0,0,150,400 --out {}/e.csv", out.display()));
    assert_eq!(t["lost"].as_u64(), Some(FRAMES as u64), "{t}");
}

/// Four corners of the relief, clicked where the known pose of the first frame shows them.
#[test]
fn a_track_starts_from_clicked_points() {
    let (m, out) = (made(), folder("points"));
    let gt = fs::read_to_string(m.data.join("test/000001/scene_gt.json")).expect("poses");
    let gt: serde_json::Value = serde_json::from_str(&gt).expect("JSON");
    let numbers = |name: &str| -> Vec<f64> {
        gt["0"][0][name].as_array().expect("a list").iter().filter_map(serde_json::Value::as_f64).collect()
    };
    let (r, t) = (numbers("cam_R_m2c"), numbers("cam_t_m2c"));
    let click = |p: [f64; 3]| {
        let at = |k: usize| r[3 * k] * p[0] + r[3 * k + 1] * p[1] + r[3 * k + 2] * p[2] + t[k];
        let pixel = [800.0 * at(0) / at(2) + 319.5, 800.0 * at(1) / at(2) + 239.5].map(f64::round);
        serde_json::json!({"pixel": pixel, "point_mm": p})
    };
    let points = [[-80.0, -60.0, 0.0], [80.0, -60.0, 5.0], [80.0, 60.0, 0.0], [-70.0, 50.0, -5.0]].map(click);
    let file = out.join("points.json");
    fs::write(&file, serde_json::to_string(&points).expect("JSON")).expect("written");
    let track = format!("track {} {} --scene 1 --backend cpu", m.model.display(), m.data.display());
    let track = format!("{track} --out {}/r.csv", out.display());
    let t = json(&format!("{track} --init-points {}", file.display()));
    assert_eq!(t["tracked"].as_u64(), Some(FRAMES as u64), "{t}");
    fs::write(&file, serde_json::to_string(&points[..3]).expect("JSON")).expect("written");
    refused(
        &format!("{track} --init-points {}", file.display()),
        &["points.json", "3 points", "four points"],
    );
    let line: Vec<_> = (0..4).map(|k| serde_json::json!({"pixel": [k, 9], "point_mm": [k, 0, 0]})).collect();
    fs::write(&file, serde_json::to_string(&line).expect("JSON")).expect("written");
    refused(&format!("{track} --init-points {}", file.display()), &["points.json", "one line"]);
    refused(&format!("{track} --distance 900"), &["--distance 900", "MIN..MAX"]);
    refused(&format!("{track} --init gt --distance 400..900"), &["--init auto"]);
}
