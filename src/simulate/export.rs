//! Writes sequences as a BOP dataset: millimetres, row-major matrices, one folder per sequence.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, GrayImage, ImageEncoder};
use nalgebra::Vector3;
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use super::sequence::{Sequence, SequenceOptions};
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose, TriangleMesh};

/// BOP's number of the only object.
const OBJECT_ID: u32 = 1;

/// Writes `out/camera.json`, `out/models` and `out/test/00000S` for every sequence S.
///
/// Everything is written beside `out` first and renamed at the end, so that a half-written dataset never stays.
/// `progress` is called with the number of frames written and of all frames.
///
/// # Errors
/// [`Error::Invalid`] for bad or contradicting options and if `out` exists and is not an empty folder;
/// [`Error::Io`] and [`Error::Image`] if something cannot be written.
pub fn write_dataset(
    out: &Path,
    sequences: &[SequenceOptions],
    mut progress: impl FnMut(usize, usize),
) -> Result<()> {
    check_options(sequences)?;
    let total = sequences.iter().map(|s| s.frames).sum();
    write_folder(out, |folder| {
        let mut done = 0;
        for (index, options) in sequences.iter().enumerate() {
            let sequence = Sequence::new(*options)?;
            if index == 0 {
                write_models(&folder.join("models"), &sequence.object().mesh)?;
                write_text(&folder.join("camera.json"), &pretty(&camera_json(sequence.camera())))?;
            }
            let scene = folder.join("test").join(format!("{:06}", options.sequence));
            write_sequence(&scene, &sequence, || {
                done += 1;
                progress(done, total);
            })?;
        }
        Ok(())
    })
}

/// Has a folder written beside `out` and renames it when it is complete.
pub(super) fn write_folder(out: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    check_folder(out)?;
    let name = out.file_name().ok_or_else(|| {
        Error::invalid(out.display().to_string(), "is not the name of a folder", "give a new folder")
    })?;
    let parent = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    create_folder(parent)?;
    let prefix = format!(".{}-", name.to_string_lossy());
    let temporary =
        tempfile::Builder::new().prefix(&prefix).tempdir_in(parent).map_err(|e| Error::io(parent, e))?;
    // The temporary folder is private to the user; the dataset inside has ordinary permissions.
    let unfinished = temporary.path().join("dataset");
    create_folder(&unfinished)?;
    write(&unfinished)?;
    if out.exists() {
        fs::remove_dir(out).map_err(|e| Error::io(out, e))?;
    }
    fs::rename(&unfinished, out).map_err(|e| Error::io(out, e))
}

/// One dataset has one object and one camera, and every sequence a folder of its own.
fn check_options(sequences: &[SequenceOptions]) -> Result<()> {
    let Some(first) = sequences.first() else {
        return Err(Error::invalid("sequences", "there is none", "give at least one"));
    };
    for (i, options) in sequences.iter().enumerate() {
        options.validate()?;
        if (options.scene, options.seed) != (first.scene, first.seed) {
            let problem = "scene or seed differs from the first sequence's";
            let what = format!("sequence {}", options.sequence);
            return Err(Error::invalid(what, problem, "write one dataset per scene and seed"));
        }
        if sequences[..i].iter().any(|other| other.sequence == options.sequence) {
            let what = format!("sequence {}", options.sequence);
            return Err(Error::invalid(what, "is given twice", "write them into two datasets"));
        }
    }
    Ok(())
}

fn check_folder(out: &Path) -> Result<()> {
    let refuse = |problem: &str| {
        let remedy = "give a new folder, or delete this one first";
        Err(Error::invalid(out.display().to_string(), problem, remedy))
    };
    match fs::read_dir(out).map(|mut entries| entries.next().is_some()) {
        Ok(true) => refuse("the folder exists and is not empty"),
        Err(_) if out.exists() => refuse("exists and is not a folder"),
        _ => Ok(()),
    }
}

pub(super) fn write_sequence(folder: &Path, sequence: &Sequence, mut written: impl FnMut()) -> Result<()> {
    let images = folder.join("gray");
    create_folder(&images)?;
    let frames: Vec<usize> = (0..sequence.len()).collect();
    // In batches, so that progress is reported from this thread and in order.
    for batch in frames.chunks(rayon::current_num_threads()) {
        batch
            .par_iter()
            .try_for_each(|&k| write_png(&images.join(format!("{k:06}.png")), &sequence.image(k)))?;
        batch.iter().for_each(|_| written());
    }
    let camera = scene_camera_json(sequence.camera());
    write_frames(&folder.join("scene_camera.json"), sequence.len(), |_| camera.clone())?;
    write_frames(&folder.join("scene_gt.json"), sequence.len(), |k| pose_json(&sequence.pose(k)))
}

pub(super) fn write_models(folder: &Path, mesh: &TriangleMesh) -> Result<()> {
    create_folder(folder)?;
    write_text(&folder.join(format!("obj_{OBJECT_ID:06}.ply")), &ply(mesh))?;
    let info = Map::from_iter([(OBJECT_ID.to_string(), model_info(mesh))]);
    write_text(&folder.join("models_info.json"), &pretty(&Value::Object(info)))
}

pub(super) fn camera_json(camera: &Camera) -> Value {
    json!({
        "cx": camera.cx, "cy": camera.cy, "depth_scale": 1.0, "fx": camera.fx, "fy": camera.fy,
        "height": camera.height, "width": camera.width,
    })
}

pub(super) fn scene_camera_json(camera: &Camera) -> Value {
    json!({ "cam_K": row_major(&camera.matrix()), "depth_scale": 1.0 })
}

pub(super) fn pose_json(pose: &Pose) -> Value {
    let t_mm: Vec<f64> = pose.translation().iter().map(|t| t * 1000.0).collect();
    json!([{ "cam_R_m2c": row_major(&pose.rotation()), "cam_t_m2c": t_mm, "obj_id": OBJECT_ID }])
}

fn row_major(m: &nalgebra::Matrix3<f64>) -> Vec<f64> {
    m.transpose().iter().copied().collect()
}

/// Diameter and bounding box, millimetres.
fn model_info(mesh: &TriangleMesh) -> Value {
    let (lo, hi) = mesh.bounds();
    let size = hi - lo;
    let distances = mesh.vertices.iter().flat_map(|a| mesh.vertices.iter().map(move |b| (a - b).norm()));
    let mm = |metres: f64| metres * 1000.0;
    json!({
        "diameter": mm(distances.fold(0.0, f64::max)),
        "min_x": mm(lo.x), "min_y": mm(lo.y), "min_z": mm(lo.z),
        "size_x": mm(size.x), "size_y": mm(size.y), "size_z": mm(size.z),
    })
}

/// ASCII PLY in millimetres with area-weighted vertex normals.
fn ply(mesh: &TriangleMesh) -> String {
    let mut normals = vec![Vector3::zeros(); mesh.vertices.len()];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        triangle.iter().for_each(|&k| normals[k as usize] += mesh.normal(t));
    }
    let mut text = String::from("ply\nformat ascii 1.0\ncomment units: millimetres\n");
    let mut line = |line: std::fmt::Arguments<'_>| writeln!(text, "{line}").expect("a string takes any text");
    line(format_args!("element vertex {}", mesh.vertices.len()));
    ["x", "y", "z", "nx", "ny", "nz"].iter().for_each(|p| line(format_args!("property float {p}")));
    line(format_args!("element face {}", mesh.triangles.len()));
    line(format_args!("property list uchar int vertex_indices\nend_header"));
    for (v, n) in mesh.vertices.iter().zip(&normals) {
        let (v, n) = (v * 1000.0, n.normalize());
        line(format_args!("{:.10} {:.10} {:.10} {:.6} {:.6} {:.6}", v.x, v.y, v.z, n.x, n.y, n.z));
    }
    mesh.triangles.iter().for_each(|[a, b, c]| line(format_args!("3 {a} {b} {c}")));
    text
}

/// A JSON object with one line per frame.
pub(super) fn write_frames(path: &Path, count: usize, entry: impl Fn(usize) -> Value) -> Result<()> {
    let lines: Vec<String> = (0..count).map(|k| format!("  \"{k}\": {}", entry(k))).collect();
    write_text(path, &format!("{{\n{}\n}}\n", lines.join(",\n")))
}

pub(super) fn pretty(value: &Value) -> String {
    format!("{value:#}\n")
}

pub(super) fn write_png(path: &Path, image: &GrayImage) -> Result<()> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(image.as_raw(), image.width(), image.height(), ExtendedColorType::L8)
        .map_err(|source| Error::Image { path: path.to_owned(), source })?;
    fs::write(path, bytes).map_err(|e| Error::io(path, e))
}

pub(super) fn write_text(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).map_err(|e| Error::io(path, e))
}

pub(super) fn create_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(|e| Error::io(path, e))
}

#[cfg(test)]
mod tests {
    use super::super::sequence::SceneKind;
    use super::*;

    fn options(scene: SceneKind, sequence: u32) -> SequenceOptions {
        SequenceOptions { scene, frames: 2, sequence, ..SequenceOptions::default() }
    }

    fn read_json(path: &Path) -> Value {
        serde_json::from_str(&fs::read_to_string(path).expect("written")).expect("JSON")
    }

    #[test]
    fn a_dataset_holds_images_models_and_exact_poses() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let out = folder.path().join("new/box");
        let mut calls = Vec::new();
        let all = [options(SceneKind::Box, 1), options(SceneKind::Box, 2)];
        write_dataset(&out, &all, |done, total| calls.push((done, total))).expect("written");
        assert_eq!(calls, [(1, 4), (2, 4), (3, 4), (4, 4)], "progress");
        let sequence = Sequence::new(all[1]).expect("options");
        let image = crate::imaging::gray::read(&out.join("test/000002/gray/000001.png")).expect("an image");
        assert_eq!(image, sequence.image(1), "the image survives");
        let gt = read_json(&out.join("test/000002/scene_gt.json"));
        let pose = sequence.pose(1);
        for (k, r) in row_major(&pose.rotation()).iter().enumerate() {
            assert_eq!(gt["1"][0]["cam_R_m2c"][k].as_f64(), Some(*r), "rotation, entry {k}");
        }
        let z = gt["1"][0]["cam_t_m2c"][2].as_f64().expect("a number");
        assert!((z / 1000.0 - pose.translation().z).abs() < 1e-15, "z {z} mm");
        let info = read_json(&out.join("models/models_info.json"));
        assert_eq!(info["1"]["size_x"].as_f64(), Some(165.0), "{info}");
        assert_eq!(read_json(&out.join("camera.json"))["fx"].as_f64(), Some(700.0), "focal length");
        let model = fs::read_to_string(out.join("models/obj_000001.ply")).expect("a model");
        assert!(model.contains("element vertex 8\n") && model.contains("element face 12\n"), "{model}");
        assert_eq!(
            fs::read_dir(folder.path().join("new")).expect("a folder").count(),
            1,
            "nothing else stays"
        );
    }

    #[test]
    fn vertices_survive_single_precision() {
        let mesh = SceneKind::Relief.object(1).mesh;
        let text = ply(&mesh);
        let lines = text.lines().skip_while(|l| *l != "end_header").skip(1);
        for (line, v) in lines.zip(&mesh.vertices) {
            for (word, c) in line.split(' ').zip(v.iter()) {
                let mm: f32 = word.parse().expect("a number");
                assert!((f64::from(mm) / 1000.0 - c).abs() < 1e-16, "{word} mm is not {c} m");
            }
        }
    }

    #[test]
    fn full_folders_and_contradicting_options_are_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        fs::write(folder.path().join("mine.txt"), "keep").expect("written");
        let refuse = |out: &Path, all: &[SequenceOptions]| {
            write_dataset(out, all, |_, _| ()).expect_err("refused").to_string()
        };
        let one = options(SceneKind::Relief, 1);
        assert!(refuse(folder.path(), &[one]).contains("not empty"), "a folder with a file");
        assert!(refuse(&folder.path().join("mine.txt"), &[one]).contains("not a folder"), "a file");
        let new = folder.path().join("new");
        assert!(refuse(&new, &[]).contains("at least one"), "no sequence");
        assert!(refuse(&new, &[one, one]).contains("twice"), "the same folder twice");
        let other = SequenceOptions { seed: 2, ..options(SceneKind::Relief, 2) };
        assert!(refuse(&new, &[one, other]).contains("differs"), "two objects");
        assert!(refuse(&new, &[SequenceOptions { noise: f64::NAN, ..one }]).contains("noise"), "NaN");
        assert!(!new.exists(), "nothing is left behind");
    }
}
