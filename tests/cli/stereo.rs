//! Two cameras: the second one is a copy of the first, a micrometre beside it.

use std::fs;

use crate::program::{FRAMES, copied, json, made, refused};

#[test]
fn both_cameras_of_a_pair() {
    let data = copied("stereo");
    let model = made().model.display();
    let shown = data.display();
    let beside = |width: u32, right: u32| {
        let k = "[800,0,319.5,0,800,239.5,0,0,1]";
        let text = format!(
            "{{\"left_scene\":1,\"right_scene\":{right},\"K_left\":{k},\"K_right\":{k},\
             \"R_right_from_left\":[1,0,0,0,1,0,0,0,1],\"t_right_from_left_mm\":[-0.001,0,0],\
             \"width\":{width},\"height\":480}}"
        );
        fs::write(data.join("stereo.json"), text).expect("written");
    };
    beside(640, 3);
    let (from, to) = (data.join("test/000001"), data.join("test/000003"));
    for folder in ["", "gray"] {
        fs::create_dir_all(to.join(folder)).expect("a folder");
        for entry in fs::read_dir(from.join(folder)).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_file() {
                fs::copy(&path, to.join(folder).join(path.file_name().expect("a name"))).expect("copied");
            }
        }
    }
    let out = data.parent().expect("a folder").join("both.csv");
    let track = format!("track {model} {shown} --scene 1 --backend cpu --out {}", out.display());
    let stereo = format!("{track} --stereo {shown}/stereo.json");
    let t = json(&format!("{stereo} --other-model {model}"));
    assert_eq!(t["tracked"].as_u64(), Some(FRAMES as u64), "{t}");
    let e = json(&format!("eval {} {shown} --scene 1", out.display()));
    assert!(e["rms_t_mm"].as_f64().is_some_and(|mm| mm < 0.1), "{e}");
    refused(&format!("{stereo} --method edge"), &["--stereo works with", "edge"]);
    refused(
        &track.replace("--scene 1", &format!("--scene 2 --stereo {shown}/stereo.json")),
        &["1 and 3", "--scene is 2"],
    );
    refused(&format!("{stereo} --other-model {shown}/none"), &["none"]);
    fs::remove_file(to.join("gray/000002.png")).expect("removed");
    refused(&stereo, &["000003", "no such image"]);
}
