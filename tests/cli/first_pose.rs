//! `track` without a pose to start from: by a search, and by clicked points.

use std::fs;

use crate::program::{FRAMES, done, folder, json, made, refused};

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

/// The templates of the search are kept beside the model: the same poses with them, without them and with a file that is damaged.
#[test]
fn templates_are_kept_beside_the_model() {
    let (m, out) = (made(), folder("templates"));
    let model = out.join("model.aam6d");
    fs::copy(&m.model, &model).expect("copied");
    let kept = out.join("model.aam6d.templates");
    let track = format!("track {} {} --scene 1 --backend cpu", model.display(), m.data.display());
    let poses = |name: &str, more: &str| {
        let path = out.join(name);
        done(&format!("{track} {more} --out {}", path.display()));
        let text = fs::read_to_string(path).expect("results");
        text.lines().map(|l| l.rsplit_once(',').expect("columns").0.to_owned()).collect::<Vec<_>>()
    };
    let first = poses("first.csv", "");
    let bytes = fs::read(&kept).expect("the templates");
    assert_eq!(poses("again.csv", ""), first, "with the templates of the file");
    assert!(fs::read(&kept).expect("the templates") == bytes, "they were not written again");
    let mut damaged = bytes.clone();
    damaged[bytes.len() / 2] ^= 1;
    fs::write(&kept, &damaged).expect("written");
    assert_eq!(poses("damaged.csv", ""), first, "rendered anew");
    assert!(fs::read(&kept).expect("the templates") == bytes, "and written anew");
    poses("near.csv", "--distance 500..700");
    assert!(fs::read(&kept).expect("the templates") != bytes, "others are needed for other distances");
    fs::remove_file(&kept).expect("removed");
    fs::create_dir(&kept).expect("a folder in its place");
    assert_eq!(poses("unwritable.csv", ""), first, "a file that cannot be written costs time only");
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
