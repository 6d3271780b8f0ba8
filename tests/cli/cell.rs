//! The robot cell, from clicks to motion against the robot.

use crate::program::{done, folder, json, refused};

#[test]
fn from_clicks_to_the_robot() {
    let out = folder("cell");
    let path = |name: &str| out.join(name).display().to_string();
    let (data, model, results) = (path("data"), path("model.aam6d"), path("results.csv"));
    done(&format!("simulate --scene cell --frames 4 --out {data}"));
    let pair = format!("--stereo {data}/stereo.json --clicks {data}/clicks.json");
    let landmarks = path("landmarks.json");
    done(&format!("landmarks {pair} --frame-of {data}/landmarks_gt.json --out {landmarks}"));
    let train = format!(
        "train {data} --scene 2 --annotations {data}/test/000002/annotations.json --landmarks {landmarks} --out {model}"
    );
    let t = json(&format!("{train} {pair}"));
    let [before, after] = ["sigma_before_mm", "sigma_after_mm"].map(|name| t["refinement"][name].as_f64());
    assert!(after.is_some_and(|mm| mm > 0.0) && after < before, "the images say more than the clicks: {t}");
    refused(&format!("{train} {}", pair.replace("clicks.json", "none.json")), &["none.json"]);
    done(&format!("track {model} {data} --scene 1 --init gt --backend cpu --out {results}"));
    let robot = format!("{data}/test/000001/scene_robot.json");
    let hand_eye = format!("{data}/test/000001/hand_eye.json");
    let e = json(&format!("eval {results} {data} --scene 1 --robot {robot} --hand-eye {hand_eye}"));
    assert_eq!(e["lost"].as_u64(), Some(0), "{e}");
    assert!(e["robot"]["rms_t_mm"].as_f64().is_some_and(|mm| mm < 0.5), "{e}");
    let calibrate = format!("hand-eye {data} --scene 1 --robot {robot} --poses gt --out {}", path("he.json"));
    refused(&calibrate, &["parallel axes"]);
}
