//! Does each stage give the same on the CPU and on the device? Every comparison has a control that must be noticed.

#[path = "parity/scan.rs"]
mod scan;
mod support;

use std::process::ExitCode;

use aam6d::backend::cpu::downsample::downsample;
use aam6d::backend::gpu::{GpuOptions, PyramidPlace};
use aam6d::backend::{Backend, TriangleWarp};
use libtest_mimic::Failed;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::gpu::{linearization, open, shared, sums, trial};
use support::linear::LinearReference;
use support::sums::Reference;
use support::{Scene, compare_images, image};

/// Around the sizes of workgroups and chunks, and a full template.
const PIXELS: [usize; 5] = [1, 255, 256, 257, 72_000];
/// None, less than a plane, one plane, two planes.
const MODES: [usize; 4] = [0, 3, 4, 8];
/// Poses; the large template only takes the small ones.
const ITEMS: [usize; 3] = [1, 3, 65];
const LARGE: usize = 10_000;

fn main() -> ExitCode {
    let mut trials = Vec::new();
    for pixels in PIXELS {
        for modes in MODES {
            trials.push(trial(format!("accumulate/{pixels}px/{modes}modes"), move || {
                accumulate_agrees(pixels, modes)
            }));
            trials.push(trial(format!("linearize/{pixels}px/{modes}modes"), move || {
                linearize_agrees(pixels, modes)
            }));
        }
    }
    trials.extend([
        trial("accumulate/as_hardware", || accumulate_agrees_cut_for(false)),
        trial("accumulate/as_software", || accumulate_agrees_cut_for(true)),
        trial("accumulate/overexposed", overexposed_frames_agree),
        trial("linearize/as_hardware", || linearize_agrees_cut_for(false)),
        trial("linearize/as_software", || linearize_agrees_cut_for(true)),
        trial("linearize/control", disturbed_linearizations_are_noticed),
        trial("linearize/split", split_linearizations_are_equal),
        trial("accumulate/control_warp", a_moved_warp_is_noticed),
        trial("accumulate/control_pixel", a_changed_pixel_is_noticed),
        trial("accumulate/control_rendering", other_blur_and_light_are_noticed),
        trial("accumulate/control_frame", a_changed_frame_is_noticed),
        trial("accumulate/many_chunks", more_chunks_than_groups_agree),
        trial("accumulate/split", split_batches_are_equal),
        trial("accumulate/repeats", two_runs_are_equal),
        trial("accumulate/levels", every_level_sees_its_own_image),
        trial("scan/device", scan::scan_agrees),
        trial("scan/fast", scan::fast_scan_agrees),
        trial("scan/control", scan::a_changed_template_is_noticed),
        trial("downsample/device", || downsample_agrees(PyramidPlace::Device)),
        trial("downsample/host", || downsample_agrees(PyramidPlace::Host)),
        trial("downsample/control", a_changed_image_is_noticed),
    ]);
    support::gpu::main(trials)
}

fn accumulate_agrees(pixels: usize, modes: usize) -> Result<(), Failed> {
    for items in ITEMS.into_iter().filter(|&items| pixels < LARGE || items < 10) {
        let scene = Scene::new(7 + items as u64, pixels, modes, items);
        let found = sums(&mut shared(), &scene)?;
        Reference::new(&scene).compare(&scene, &found).map_err(|e| format!("{items} poses: {e}"))?;
    }
    Ok(())
}

/// Both ways of cutting the work must be right on every adapter.
fn accumulate_agrees_cut_for(software: bool) -> Result<(), Failed> {
    let mut gpu = open(GpuOptions { as_software: Some(software), ..GpuOptions::default() });
    // 24 modes do not fit a large workgroup's memory.
    for (pixels, modes) in [(257, 0), (72_000, 4), (257, 24)] {
        let scene = Scene::new(3, pixels, modes, 2);
        Reference::new(&scene).compare(&scene, &sums(&mut gpu, &scene)?)?;
    }
    Ok(())
}

fn linearize_agrees(pixels: usize, modes: usize) -> Result<(), Failed> {
    for items in ITEMS.into_iter().filter(|&items| items < 10) {
        let scene = Scene::new(27 + items as u64, pixels, modes, items);
        let found = linearization(&mut shared(), &scene)?;
        LinearReference::new(&scene).compare(&scene, &found).map_err(|e| format!("{items} poses: {e}"))?;
    }
    Ok(())
}

fn linearize_agrees_cut_for(software: bool) -> Result<(), Failed> {
    let mut gpu = open(GpuOptions { as_software: Some(software), ..GpuOptions::default() });
    for (pixels, modes) in [(257, 0), (72_000, 4), (257, 24)] {
        let scene = Scene::new(23, pixels, modes, 2);
        LinearReference::new(&scene).compare(&scene, &linearization(&mut gpu, &scene)?)?;
    }
    Ok(())
}

/// A warp moved by a tenth of a pixel, a template pixel brighter by one, a coefficient of a mode changed by 0.1.
fn disturbed_linearizations_are_noticed() -> Result<(), Failed> {
    let scene = Scene::new(31, 257, 4, 1);
    let reference = LinearReference::new(&scene);
    reference.compare(&scene, &linearization(&mut shared(), &scene)?)?;
    let mut disturbed = [scene.clone(), scene.clone(), scene.clone()];
    let h = &mut disturbed[0].warps[0].image_from_chart;
    let moved = h.row(0) + 0.1 * h.row(2);
    h.set_row(0, &moved);
    disturbed[1].model.levels[0].pixels.intensity[0] += 1.0;
    disturbed[2].appearance[3] += 0.1;
    for (k, disturbed) in disturbed.iter().enumerate() {
        match reference.compare(&scene, &linearization(&mut shared(), disturbed)?) {
            Err(report) if report.contains("pose 0 triangle 0:") => {}
            Err(report) => return Err(format!("{k}: the wrong rows were reported: {report}").into()),
            Ok(()) => return Err(format!("disturbance {k} went unnoticed").into()),
        }
    }
    Ok(())
}

fn split_linearizations_are_equal() -> Result<(), Failed> {
    let scene = Scene::new(25, 257, 4, 9);
    let whole = linearization(&mut shared(), &scene)?;
    let mut gpu = open(GpuOptions { max_dispatch_bytes: Some(1000), ..GpuOptions::default() });
    let split = linearization(&mut gpu, &scene)?;
    if split == whole { Ok(()) } else { Err("small dispatches give other sums".into()) }
}

/// What comes of a scene on the device must not pass as what the twin makes of another.
fn must_differ(scene: &Scene, disturbed: &Scene) -> Result<(), Failed> {
    let reference = Reference::new(scene);
    reference.compare(scene, &sums(&mut shared(), scene)?)?;
    match reference.compare(scene, &sums(&mut shared(), disturbed)?) {
        Err(report) if report.contains("pose 0 triangle 0:") => Ok(()),
        Err(report) => Err(format!("the wrong rows were reported: {report}").into()),
        Ok(()) => Err("the disturbance went unnoticed".into()),
    }
}

fn a_moved_warp_is_noticed() -> Result<(), Failed> {
    for pixels in PIXELS {
        let scene = Scene::new(11, pixels, 4, 1);
        let mut disturbed = scene.clone();
        let h = &mut disturbed.warps[0].image_from_chart;
        // A tenth of a pixel to the right.
        let moved = h.row(0) + 0.1 * h.row(2);
        h.set_row(0, &moved);
        must_differ(&scene, &disturbed)?;
    }
    Ok(())
}

fn a_changed_pixel_is_noticed() -> Result<(), Failed> {
    for pixels in PIXELS {
        let scene = Scene::new(12, pixels, 4, 1);
        let mut disturbed = scene.clone();
        disturbed.model.levels[0].pixels.intensity[0] += 1.0;
        must_differ(&scene, &disturbed)?;
    }
    Ok(())
}

fn overexposed_frames_agree() -> Result<(), Failed> {
    for (pixels, modes) in [(257, 0), (257, 4), (72_000, 3)] {
        let scene = Scene::new(14, pixels, modes, 3).overexposed();
        Reference::new(&scene).compare(&scene, &sums(&mut shared(), &scene)?)?;
    }
    Ok(())
}

/// Every factor of the blur, gain and bias of what is saturated.
fn other_blur_and_light_are_noticed() -> Result<(), Failed> {
    let scene = Scene::new(16, 257, 4, 1).overexposed();
    for k in 0..8 {
        let mut disturbed = scene.clone();
        let TriangleWarp { blur, light, .. } = &mut disturbed.warps[0];
        let number = blur.as_flattened_mut().iter_mut().chain(light).nth(k).ok_or("eight numbers")?;
        *number += [0.2, 0.2, 0.2, 0.2, 0.2, 0.2, 0.01, 1.0][k];
        must_differ(&scene, &disturbed)
            .map_err(|e| format!("number {k}: {}", e.message().unwrap_or_default()))?;
    }
    Ok(())
}

fn a_changed_frame_is_noticed() -> Result<(), Failed> {
    let scene = Scene::new(13, 257, 4, 1);
    let mut disturbed = scene.clone();
    disturbed.image.iter_mut().for_each(|value| *value = value.saturating_add(1));
    must_differ(&scene, &disturbed)
}

fn split_batches_are_equal() -> Result<(), Failed> {
    let scene = Scene::new(5, 257, 4, 65);
    let whole = sums(&mut shared(), &scene)?;
    for max_dispatch_bytes in [Some(1), Some(1000)] {
        let mut gpu = open(GpuOptions { max_dispatch_bytes, ..GpuOptions::default() });
        if sums(&mut gpu, &scene)? != whole {
            return Err(format!("dispatches of {max_dispatch_bytes:?} bytes give other sums").into());
        }
    }
    Ok(())
}

/// A dispatch has at most 65535 workgroups per dimension.
fn more_chunks_than_groups_agree() -> Result<(), Failed> {
    let scene = Scene::of_single_pixels(8, 70_000, 3, 2);
    Ok(Reference::new(&scene).compare(&scene, &sums(&mut shared(), &scene)?)?)
}

fn two_runs_are_equal() -> Result<(), Failed> {
    let scene = Scene::new(6, 72_000, 8, 3);
    let first = sums(&mut shared(), &scene)?;
    let second = sums(&mut shared(), &scene)?;
    if first == second { Ok(()) } else { Err("two runs on one device differ".into()) }
}

/// A frame of two levels, with the template on level 1: the sums must be those over the small image.
fn every_level_sees_its_own_image() -> Result<(), Failed> {
    let mut scene = Scene::new(9, 257, 3, 2);
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let full = image(&mut rng, 2 * scene.image.width() + 1, 2 * scene.image.height());
    scene.image = downsample(&full);
    let mut gpu = shared();
    let model = gpu.load(&scene.model)?;
    gpu.set_frame(&full, 2)?;
    let mut sums = Default::default();
    gpu.accumulate(&aam6d::backend::Request { image_level: 1, ..scene.request(model) }, &mut sums)?;
    Ok(Reference::new(&scene).compare(&scene, &sums)?)
}

/// Images whose rows end within a word, on a word, on a row alignment and behind it, and images that vanish.
const IMAGES: [(u32, u32); 9] =
    [(640, 480), (641, 479), (7, 5), (256, 2), (257, 3), (1023, 9), (2, 2), (3, 1), (1, 1)];
const LEVELS: usize = 4;

fn downsample_agrees(pyramid: PyramidPlace) -> Result<(), Failed> {
    let mut gpu = open(GpuOptions { pyramid, ..GpuOptions::default() });
    for (seed, (width, height)) in (0..).zip(IMAGES) {
        let mut expected = image(&mut ChaCha8Rng::seed_from_u64(seed), width, height);
        gpu.set_frame(&expected, LEVELS)?;
        for level in 0..LEVELS {
            compare_images(&expected, &gpu.read_level(0, level)?)
                .map_err(|e| format!("{width}x{height} level {level}: {e}"))?;
            expected = downsample(&expected);
        }
    }
    Ok(())
}

fn a_changed_image_is_noticed() -> Result<(), Failed> {
    let mut gpu = open(GpuOptions { pyramid: PyramidPlace::Device, ..GpuOptions::default() });
    let full = image(&mut ChaCha8Rng::seed_from_u64(1), 64, 48);
    let mut disturbed = full.clone();
    disturbed.put_pixel(21, 11, image::Luma([full.get_pixel(21, 11)[0] ^ 4]));
    gpu.set_frame(&disturbed, 2)?;
    match compare_images(&downsample(&full), &gpu.read_level(0, 1)?) {
        Err(report) if report.starts_with("(10, 5):") && !report.contains(", (") => Ok(()),
        other => Err(format!("one changed pixel was reported as {other:?}").into()),
    }
}
