//! Places that cannot be written to, and adapters that are not there.

use std::fs;

use crate::program::{check_refused, folder, made, names, refused, run_with};

/// A file where a folder is needed is in the way of everybody, also of root.
#[test]
fn a_file_in_the_way_of_a_folder() {
    let (m, out) = (made(), folder("file_in_the_way"));
    fs::write(out.join("file"), "mine").expect("written");
    let (data, model, file) = (m.data.display(), m.model.display(), out.join("file").display().to_string());
    let track = format!("track {model} {data} --scene 1 --init gt --backend cpu");
    refused(&format!("simulate --frames 1 --out {file}/data"), &[&file]);
    refused(&format!("simulate --frames 1 --out {file}"), &[&file, "not a folder"]);
    refused(&format!("demo --frames 2 --out {file}/demo"), &[&file]);
    refused(&format!("train {data} --scene 1 --frames 0 --out {file}/model"), &[&file]);
    refused(&format!("{track} --out {file}/r.csv"), &[&file]);
    refused(&format!("{track} --out {}/r.csv --details {file}/d.jsonl", out.display()), &[&file]);
    refused(&format!("{track} --out {}/r.csv --overlay {file}/o", out.display()), &[&file]);
    refused(&format!("{track} --out {}/s.csv --tum {file}/t.tum", out.display()), &[&file]);
    refused(&format!("{track} --out {}/s.csv --json {file}/t.json", out.display()), &[&file]);
    assert_eq!(fs::read_to_string(out.join("file")).expect("still there"), "mine", "untouched");
    assert!(!out.join("r.csv").exists(), "unfinished results have their final name");
}

#[test]
fn a_folder_in_the_way_of_a_file() {
    let (m, out) = (made(), folder("folder_in_the_way"));
    let (data, model, to) = (m.data.display(), m.model.display(), out.display());
    let mine = out.join("mine");
    fs::create_dir(&mine).expect("made");
    fs::write(mine.join("file"), "mine").expect("written");
    refused(&format!("train {data} --scene 1 --frames 0 --out {to}/mine"), &["mine"]);
    refused(&format!("track {model} {data} --scene 1 --init gt --backend cpu --out {to}/mine"), &["mine"]);
    refused(&format!("simulate --frames 1 --out {to}/mine"), &["mine", "not empty", "new folder"]);
    refused(&format!("demo --frames 2 --out {to}/mine"), &["mine", "not from an earlier demo", "--out"]);
    assert_eq!(names(&mine), ["file"], "untouched");
}

#[test]
fn adapters_that_are_not_there() {
    let (m, out) = (made(), folder("adapters"));
    let (data, model, to) = (m.data.display(), m.model.display(), out.display());
    let track = format!("track {model} {data} --scene 1 --init gt --out {to}/r.csv");
    refused(&format!("{track} --adapter no-such-device"), &["--backend cpu"]);
    refused(&format!("{track} --backend gpu --adapter 99"), &["--backend cpu"]);
    refused(&format!("{track} --backend cpu --adapter 0"), &["--adapter", "leave it out"]);
    assert!(names(&out).is_empty(), "{:?}", names(&out));
}

/// Asking for a GPU where there is none is an error; `auto` takes the CPU and says so.
#[test]
#[cfg(all(feature = "gpu", target_os = "linux"))]
fn no_driver() {
    let (m, out) = (made(), folder("no_driver"));
    let none = [("VK_DRIVER_FILES", "/no/such/driver.json"), ("VK_ICD_FILENAMES", "/no/such/driver.json")];
    let track = format!(
        "track {} {} --scene 1 --init gt --out {}/r.csv",
        m.model.display(),
        m.data.display(),
        out.display()
    );
    let words = format!("{track} --backend gpu");
    check_refused(
        &words,
        &run_with(&words, &none),
        &["no usable GPU adapter", "mesa-vulkan-drivers", "--backend cpu"],
    );
    assert!(names(&out).is_empty(), "{:?}", names(&out));
    let outcome = run_with(&track, &none);
    assert!(outcome.code == Some(0) && outcome.stdout.contains("no GPU adapter is present"), "{outcome:?}");
    let info = run_with("info", &none);
    assert!(info.code == Some(0) && info.stdout.contains("no GPU adapter"), "{info:?}");
}
