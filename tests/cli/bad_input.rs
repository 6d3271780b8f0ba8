//! Bad input: one line that names the file, the place and the remedy; exit code 1; nothing half-written.

use std::fs;
use std::path::Path;

use crate::program::{copied, folder, made, names, refused, replace, run, truncate};

const SCENE: &str = "test/000001";

/// Damages a copy of the data set; training and tracking on it must name all the parts and write nothing.
fn damaged(test: &str, damage: impl FnOnce(&Path), parts: &[&str]) {
    let data = copied(test);
    damage(&data);
    let folder = data.parent().expect("a folder");
    let (m, out) = (made(), folder.join("out"));
    let (data, to) = (data.display(), out.display());
    refused(&format!("train {data} --scene 1 --frames 0,2 --out {to}/model"), parts);
    if !parts.contains(&"obj_000001.ply") {
        refused(
            &format!("track {} {data} --scene 1 --init gt --out {to}/results.csv", m.model.display()),
            parts,
        );
    }
    // A frame that cannot be read is noticed after the track has begun; what it leaves has no final name.
    let left = if out.exists() { names(&out) } else { Vec::new() };
    let begun = parts.iter().any(|p| p.ends_with(".png"));
    assert!(left.is_empty() || begun && left == ["results.csv.partial"], "{left:?} was written");
}

#[test]
fn files_that_are_missing() {
    let (m, out) = (made(), folder("missing"));
    let (data, model, to) = (m.data.display(), m.model.display(), out.display());
    refused(
        &format!("track {model} {to}/nothing --scene 1 --init gt --out {to}/r.csv"),
        &["nothing", "os error"],
    );
    refused(
        &format!("track {to}/no.aam6d {data} --scene 1 --init gt --out {to}/r.csv"),
        &["no.aam6d", "os error"],
    );
    refused(
        &format!("track {model} {to} --scene 1 --init gt --out {to}/r.csv"),
        &["missing", "no scene folder"],
    );
    refused(&format!("eval {to}/no.csv {data} --scene 1"), &["no.csv", "os error"]);
    refused(&format!("track {model} {data} --scene 1 --init ref --out {to}/r.csv"), &["scene_ref.json"]);
    refused(&format!("track {model} {data} --scene 7 --out {to}/r.csv"), &["scene 7", "[1, 2]"]);
    assert!(names(&out).is_empty(), "{:?}", names(&out));
    damaged(
        "missing_gt",
        |d| fs::remove_file(d.join(SCENE).join("scene_gt.json")).expect("gone"),
        &["scene_gt.json"],
    );
    damaged(
        "missing_mesh",
        |d| fs::remove_file(d.join("models/obj_000001.ply")).expect("gone"),
        &["obj_000001.ply"],
    );
    damaged(
        "missing_image",
        |d| fs::remove_file(d.join(SCENE).join("gray/000001.png")).expect("gone"),
        &["scene_camera.json", "\"1\"", "no such image"],
    );
}

#[test]
fn files_that_are_cut_off() {
    damaged("cut_gt", |d| truncate(&d.join(SCENE).join("scene_gt.json")), &["scene_gt.json:", "valid JSON"]);
    damaged(
        "cut_camera",
        |d| truncate(&d.join(SCENE).join("scene_camera.json")),
        &["scene_camera.json:", "valid JSON"],
    );
    damaged("cut_mesh", |d| truncate(&d.join("models/obj_000001.ply")), &["obj_000001.ply"]);
    damaged(
        "cut_image",
        |d| truncate(&d.join(SCENE).join("gray/000000.png")),
        &["000000.png", "not a readable image"],
    );
}

#[test]
fn wrong_fields() {
    let gt = |old: &'static str, new: &'static str| {
        move |d: &Path| replace(&d.join(SCENE).join("scene_gt.json"), old, new)
    };
    let camera = |old: &'static str, new: &'static str| {
        move |d: &Path| replace(&d.join(SCENE).join("scene_camera.json"), old, new)
    };
    damaged(
        "field_missing",
        gt("cam_R_m2c", "rotation"),
        &["scene_gt.json: \"0\"[0]", "cam_R_m2c is missing"],
    );
    damaged(
        "field_short",
        gt("\"cam_R_m2c\":[", "\"cam_R_m2c\":[1,"),
        &["\"0\"[0].cam_R_m2c", "10 numbers instead of 9"],
    );
    damaged(
        "field_text",
        gt("\"cam_t_m2c\":[", "\"cam_t_m2c\":[\"a\","),
        &["\"0\"[0].cam_t_m2c[0]", "not a finite number"],
    );
    damaged(
        "field_scaled",
        gt("\"cam_R_m2c\":[", "\"cam_R_m2c\":[1,0,0,0,1.5,0,0,0,1],\"x\":["),
        &["\"0\"[0].cam_R_m2c", "not orthonormal"],
    );
    damaged(
        "field_infinite",
        gt("\"cam_t_m2c\":[", "\"cam_t_m2c\":[1e999,0,0],\"x\":["),
        &["scene_gt.json:2:", "out of range"],
    );
    damaged("field_nan", gt("\"cam_t_m2c\":[", "\"cam_t_m2c\":[NaN,0,0],\"x\":["), &["scene_gt.json:2:"]);
    damaged("field_object", gt("\"obj_id\":1", "\"obj_id\":\"box\""), &["\"0\"[0].obj_id", "whole number"]);
    damaged(
        "camera_short",
        camera("\"cam_K\":[", "\"cam_K\":[1,2],\"x\":["),
        &["scene_camera.json: \"0\".cam_K", "2 numbers instead of 9"],
    );
    damaged(
        "camera_negative",
        camera("\"cam_K\":[800.0", "\"cam_K\":[-800.0"),
        &["scene_camera.json: \"0\".cam_K", "focal length"],
    );
    damaged(
        "camera_fisheye",
        camera("\"depth_scale\"", "\"cam_dist\":[0,0,0,0,0,0.1,0,0],\"x\""),
        &["\"0\".cam_dist"],
    );
    damaged("camera_key", camera("\"0\"", "\"first\""), &["scene_camera.json: \"first\"", "not an id"]);
}

#[test]
fn meshes_that_are_none() {
    let flat = |d: &Path| {
        let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
            element face 1\nproperty list uchar int vertex_indices\nend_header\n";
        fs::write(d.join("models/obj_000001.ply"), format!("{header}0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n"))
            .expect("written");
    };
    damaged("mesh_flat", flat, &["obj_000001.ply", "area"]);
    damaged(
        "mesh_nan",
        |d| replace(&d.join("models/obj_000001.ply"), "end_header\n", "end_header\nnan "),
        &["obj_000001.ply"],
    );
    damaged(
        "mesh_text",
        |d| fs::write(d.join("models/obj_000001.ply"), "hello").expect("written"),
        &["obj_000001.ply"],
    );
}

/// An image of another size: the first against camera.json, a later one against the first.
#[test]
fn images_of_another_size() {
    let stated = |d: &Path| replace(&d.join("camera.json"), "640", "641");
    damaged("size_stated", stated, &["camera.json: width", "641", "000000.png has 640"]);
    let data = copied("size_later");
    let small = data.join(SCENE).join("gray/000002.png");
    image::GrayImage::new(320, 240).save(&small).expect("written");
    let (folder, model) = (data.parent().expect("a folder"), made().model.display());
    let (data, to) = (data.display(), folder.join("out"));
    refused(
        &format!("train {data} --scene 1 --frames 0,2 --out {}/model", to.display()),
        &["000002.png", "320x240"],
    );
    let results = to.join("results.csv");
    let track = format!("track {model} {data} --scene 1 --init gt --out {}", results.display());
    refused(&track, &["000002.png", "320x240", "2 finished frames are in", "results.csv.partial"]);
    // What is finished is kept, under a name that says so.
    let partial = fs::read_to_string(results.with_extension("csv.partial")).expect("the finished frames");
    assert!(partial.lines().count() == 3 && !results.exists(), "{partial}");
}

#[test]
fn nothing_to_see() {
    let behind = |d: &Path| {
        let gt = "[{\"cam_R_m2c\":[1,0,0,0,1,0,0,0,1],\"cam_t_m2c\":[0,0,-600],\"obj_id\":1}]";
        let all: Vec<String> = (0..4).map(|k| format!("\"{k}\":{gt}")).collect();
        fs::write(d.join(SCENE).join("scene_gt.json"), format!("{{{}}}", all.join(","))).expect("written");
    };
    let data = copied("nothing_to_see");
    behind(&data);
    let to = data.parent().expect("a folder").join("out");
    let (model, shown) = (made().model.display(), data.display());
    refused(&format!("train {shown} --scene 1 --frames 0,2 --out {}/m", to.display()), &["no triangle"]);
    assert!(!to.exists(), "{:?} was written", names(&to));
    // Where tracking starts there may be nothing to see: that is a lost object.
    let tracks = |options: &str, end: &str| {
        let track = format!("track {model} {shown} --scene 1 --init gt --backend cpu {options}");
        let outcome = run(&format!("{track} --out {}/r.csv", to.display()));
        assert!(outcome.code == Some(0) && outcome.stdout.contains(end), "{outcome:?}");
    };
    tracks("--no-recover", "4 lost");
    // Unless it is looked for elsewhere.
    tracks("", "0 lost");
}

#[test]
fn models_that_are_damaged() {
    let (m, out) = (made(), folder("models"));
    let good = fs::read(&m.model).expect("a model");
    let check = |name: &str, damage: &dyn Fn(&mut Vec<u8>), parts: &[&str]| {
        let (mut bytes, path) = (good.clone(), out.join(name));
        damage(&mut bytes);
        fs::write(&path, bytes).expect("written");
        let words = format!(
            "track {} {} --scene 1 --init gt --out {}/r.csv",
            path.display(),
            m.data.display(),
            out.display()
        );
        refused(&words, &[parts, &[name]].concat());
    };
    check("cut", &|b| b.truncate(b.len() / 2), &["payload", "the header says", "train the model again"]);
    check("cut_header", &|b| b.truncate(9), &["header", "ends after 9 bytes"]);
    check("empty", &|b| b.clear(), &["header", "ends after 0 bytes"]);
    check(
        "flipped",
        &|b| *b.last_mut().expect("bytes") ^= 16,
        &["payload", "checksum", "train the model again"],
    );
    check("flipped_early", &|b| b[24] ^= 1, &["checksum"]);
    check("newer", &|b| b[8] += 1, &["version 3", "reads version 2", "train the model again"]);
    check("picture", &|b| b.splice(..4, *b"\x89PNG").for_each(drop), &["magic", "not a model file"]);
    let left: Vec<_> = names(&out).into_iter().filter(|n| n.starts_with("r.csv")).collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn frames_and_starts_that_do_not_exist() {
    let (m, out) = (made(), folder("frames"));
    let (data, model, to) = (m.data.display(), m.model.display(), out.display());
    let train = format!("train {data} --scene 1 --out {to}/m");
    refused(&format!("{train} --frames 0,99"), &["no frame 99", "from 0 to 3"]);
    refused(&format!("{train} --frames 0 --object 5"), &["object 5", "scene_gt.json"]);
    refused(&format!("{train} --frames 0,1 --modes 2"), &["2 modes", "fewer modes"]);
    let starts = |name: &str, lines: &str, parts: &[&str]| {
        fs::write(out.join(name), lines).expect("written");
        let words = format!("align {model} {data} --scene 1 --starts {to}/{name} --out {to}/a.csv");
        refused(&words, &[&[name], parts].concat());
    };
    let pose = "1 0 0 0 1 0 0 0 1,0 0 600,-1";
    starts(
        "frame.csv",
        &format!("1,0,1,1,{pose}\n1,9,1,1,{pose}\n"),
        &["start 2", "image 9", "no such image"],
    );
    starts("scene.csv", &format!("2,0,1,1,{pose}\n"), &["start 1", "the scene asked for is 1"]);
    starts("object.csv", &format!("1,0,4,1,{pose}\n"), &["object 4", "the model is of 1"]);
    starts("empty.csv", "", &["no start pose"]);
    starts(
        "turn.csv",
        &format!("1,0,1,1,{pose}\n1,0,1,1,2 0 0 0 1 0 0 0 1,0 0 600,-1\n"),
        &["turn.csv:2:", "orthonormal"],
    );
    starts("nan.csv", "1,0,1,1,1 0 0 0 1 0 0 0 1,0 NaN 600,-1\n", &["nan.csv:1:", "not finite"]);
    starts("short.csv", "1,0,1\n", &["short.csv:1:"]);
    fs::write(out.join("init.csv"), format!("1,2,1,1,{pose}\n")).expect("written");
    refused(
        &format!("track {model} {data} --scene 1 --init {to}/init.csv --out {to}/r.csv"),
        &["init.csv: no pose for frame 0"],
    );
    let gone = copied("frames_without_pose");
    let gt = gone.join(SCENE).join("scene_gt.json");
    replace(&gt, "\"0\":", "\"10\":");
    let words = format!("track {model} {} --scene 1 --init gt --out {to}/r.csv", gone.display());
    refused(&words, &["scene_gt.json: no pose for frame 0"]);
    fs::write(out.join("d.jsonl"), "{\"frame\": 0}\n").expect("written");
    let eval = format!("eval {} {data} --scene 1 --details {to}/d.jsonl", m.results.display());
    refused(&eval, &["d.jsonl:1:", "aam6d track --details"]);
    refused(&format!("eval {} {data} --scene 2", m.results.display()), &["results.csv", "scene 2"]);
    let left: Vec<_> =
        names(&out).into_iter().filter(|n| ["m", "a.csv", "r.csv"].contains(&n.as_str())).collect();
    assert!(left.is_empty(), "{left:?}");
}
