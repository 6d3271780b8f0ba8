//! Does the fast implementation of the CPU backend give what the twin gives, and is it fast? Comparisons have controls
//! that must be noticed.

mod support;

use aam6d::align::InverseCompositional;
use aam6d::backend::cpu::downsample::downsample;
use aam6d::backend::{Backend, CpuBackend, Implementation, Instructions, Linearization, Request, Sums};
use aam6d::geometry::Pose;
use aam6d::simulate::{Sequence, SequenceOptions};
use aam6d::track::{Status, Tracker};
use aam6d::train::{TrainOptions, TrainingImage, train};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::linear::LinearReference;
use support::sums::Reference;
use support::{Scene, image};

/// Around the widths of vectors and blocks, and a full template.
const PIXELS: [usize; 12] = [1, 3, 4, 7, 8, 15, 16, 17, 255, 256, 257, 72_000];
/// None, and around the runs of four and eight that are worked on at a time.
const MODES: [usize; 11] = [0, 1, 2, 3, 4, 5, 6, 8, 11, 12, 16];
/// Poses; the large template only takes the small ones.
const ITEMS: [usize; 4] = [1, 3, 17, 65];
const LARGE: usize = 10_000;
/// Every set of instructions of this machine.
const INSTRUCTIONS: [Instructions; 3] = [Instructions::Best, Instructions::Avx2, Instructions::Sse42];

fn sums_with(instructions: Instructions, scene: &Scene) -> Sums {
    let mut cpu = CpuBackend::with(Implementation::Fast(instructions));
    let model = cpu.load(&scene.model).expect("the CPU takes every model");
    cpu.set_frame(&scene.image, 1).expect("the CPU takes every frame");
    let mut sums = Sums::default();
    cpu.accumulate(&scene.request(model), &mut sums).expect("the scene fits itself");
    sums
}

fn sums(scene: &Scene) -> Sums {
    sums_with(Instructions::Best, scene)
}

fn agrees(scene: &Scene, what: &str) {
    let reference = Reference::new(scene);
    for instructions in INSTRUCTIONS {
        let problem = reference.compare(scene, &sums_with(instructions, scene)).err();
        assert!(problem.is_none(), "{what}, {instructions:?}: {}", problem.unwrap_or_default());
    }
}

#[test]
fn all_sizes_agree() {
    for pixels in PIXELS {
        for modes in MODES {
            for items in ITEMS.into_iter().filter(|&items| pixels < LARGE || items < 10) {
                let scene = Scene::new(7 + items as u64, pixels, modes, items);
                agrees(&scene, &format!("{pixels} pixels, {modes} modes, {items} poses"));
            }
        }
    }
}

#[test]
fn single_pixels_and_many_poses_agree() {
    agrees(&Scene::of_single_pixels(8, 3_000, 3, 2), "single pixels");
    agrees(&Scene::new(9, 5_000, 4, 130), "many poses");
}

/// Images so wide that few rows, or at last none, fit into the window of a chart.
#[test]
fn wide_frames_agree_and_moved_warps_do_not() {
    for width in [4_000, 10_000, 18_000, 44_000] {
        for pixels in [257, 5_000] {
            let scene = Scene::new(17, pixels, 4, 2).widened(width);
            agrees(&scene, &format!("{width} columns, {pixels} pixels"));
        }
        let scene = Scene::new(19, 5_000, 3, 2).widened(width);
        let problem =
            LinearReference::new(&scene).compare(&scene, &linearization(Instructions::Best, &scene));
        assert!(problem.is_ok(), "{width} columns: {problem:?}");
        let scene = Scene::new(18, 257, 4, 1).widened(width);
        let mut disturbed = scene.clone();
        disturbed.warps[0].image_from_chart[(0, 2)] += 0.05;
        must_differ(&scene, &disturbed);
    }
}

#[test]
fn overexposed_frames_agree_and_other_light_does_not() {
    for (pixels, modes) in [(257, 0), (257, 4), (257, 9), (20_000, 3)] {
        let scene = Scene::new(14, pixels, modes, 3).overexposed();
        agrees(&scene, &format!("{pixels} pixels, {modes} modes"));
    }
    let scene = Scene::new(16, 257, 4, 1).overexposed();
    let mut disturbed = scene.clone();
    disturbed.warps[0].light[1] += 1.0;
    must_differ(&scene, &disturbed);
}

#[test]
fn a_changed_blur_is_noticed() {
    let scene = Scene::new(15, 257, 4, 1);
    for k in 0..6 {
        let mut disturbed = scene.clone();
        disturbed.warps[0].blur.as_flattened_mut()[k] += 0.05;
        must_differ(&scene, &disturbed);
    }
}

fn linearization(instructions: Instructions, scene: &Scene) -> Linearization {
    let mut cpu = CpuBackend::with(Implementation::Fast(instructions));
    let model = cpu.load(&scene.model).expect("the CPU takes every model");
    cpu.set_frame(&scene.image, 1).expect("the CPU takes every frame");
    let mut out = Linearization::default();
    cpu.linearize(&scene.request(model), &mut out).expect("the scene fits itself");
    out
}

#[test]
fn linearizations_agree_and_disturbed_ones_do_not() {
    for pixels in [1, 7, 16, 255, 257, 20_000] {
        for modes in [0, 1, 2, 3, 4, 5, 8] {
            let scene = Scene::new(21, pixels, modes, 3);
            let reference = LinearReference::new(&scene);
            for instructions in INSTRUCTIONS {
                let problem = reference.compare(&scene, &linearization(instructions, &scene)).err();
                let problem = problem.unwrap_or_default();
                assert!(problem.is_empty(), "{pixels} pixels, {modes} modes, {instructions:?}: {problem}");
            }
            let mut disturbed = scene.clone();
            disturbed.model.levels[0].pixels.intensity[0] += 4.0;
            let report = reference.compare(&scene, &linearization(Instructions::Best, &disturbed));
            let report = report.expect_err("a changed pixel must be noticed");
            assert!(report.contains("triangle 0:"), "the wrong rows were reported: {report}");
        }
    }
}

/// What comes of a scene must not pass as what the twin makes of another.
fn must_differ(scene: &Scene, disturbed: &Scene) {
    let reference = Reference::new(scene);
    reference.compare(scene, &sums(scene)).expect("the undisturbed scene agrees");
    let report = reference.compare(scene, &sums(disturbed)).expect_err("a disturbance must be noticed");
    assert!(report.contains("pose 0 triangle 0:"), "the wrong rows were reported: {report}");
}

#[test]
fn a_moved_warp_is_noticed() {
    for pixels in PIXELS {
        let scene = Scene::new(11, pixels, 4, 1);
        let mut disturbed = scene.clone();
        let h = &mut disturbed.warps[0].image_from_chart;
        // A tenth of a pixel to the right.
        let moved = h.row(0) + 0.1 * h.row(2);
        h.set_row(0, &moved);
        must_differ(&scene, &disturbed);
    }
}

#[test]
fn changed_pixels_and_frames_are_noticed() {
    for pixels in PIXELS {
        let scene = Scene::new(12, pixels, 4, 1);
        let mut disturbed = scene.clone();
        disturbed.model.levels[0].pixels.intensity[0] += 1.0;
        must_differ(&scene, &disturbed);
        let mut disturbed = scene.clone();
        disturbed.image.iter_mut().for_each(|value| *value = value.saturating_add(1));
        must_differ(&scene, &disturbed);
    }
}

/// The same bytes whatever the number of threads, and again from the same backend.
#[test]
fn sums_do_not_depend_on_threads_or_history() {
    for (pixels, items) in [(72_000, 3), (300_000, 1), (5_000, 65)] {
        let scene = Scene::new(6, pixels, 5, items);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| sums(&scene))
        };
        let first = on(1);
        for threads in [1, 2, 3, 7] {
            assert!(
                on(threads) == first,
                "{pixels} pixels, {items} poses: {threads} threads give other sums"
            );
        }
    }
}

/// A frame of two levels, with the template on level 1: the sums must be those over the small image. Larger and
/// smaller frames before must not matter.
#[test]
fn every_level_sees_its_own_image() {
    let mut scene = Scene::new(9, 257, 3, 2);
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let full = image(&mut rng, 2 * scene.image.width() + 1, 2 * scene.image.height());
    scene.image = downsample(&full);
    let mut cpu = CpuBackend::new();
    let model = cpu.load(&scene.model).expect("the CPU takes every model");
    for (width, height) in [(900, 700), (3, 2), (1, 1)] {
        cpu.set_frame(&image(&mut rng, width, height), 4).expect("the CPU takes every frame");
    }
    cpu.set_frame(&full, 2).expect("the CPU takes every frame");
    let mut sums = Sums::default();
    cpu.accumulate(&Request { image_level: 1, ..scene.request(model) }, &mut sums).expect("the scene fits");
    Reference::new(&scene).compare(&scene, &sums).expect("the sums over the small image");
}

/// Largest distance between the corners of two poses in the image.
fn distance_px(tracker: &Tracker, sequence: &Sequence, a: &Pose, b: &Pose) -> f64 {
    let project = |pose: &Pose, x| sequence.camera().project(&pose.transform_point(x)).expect("in front");
    let corners = tracker.model().shape.corners.iter();
    corners.map(|x| (project(a, x) - project(b, x)).norm()).fold(0.0, f64::max)
}

/// A track in f32 must end where the one in f64 ends, frame by frame.
#[test]
fn whole_tracks_agree() {
    let sequence = |sequence| {
        let options = SequenceOptions {
            frames: 8,
            sequence,
            light: true,
            supersampling: 2,
            ..SequenceOptions::default()
        };
        Sequence::new(options).expect("valid options")
    };
    let (trained_on, tracked) = (sequence(2), sequence(1));
    let image = |k| TrainingImage {
        image: trained_on.image(k),
        camera: *trained_on.camera(),
        camera_from_object: trained_on.pose(k),
    };
    let options = TrainOptions { modes: 3, ..TrainOptions::default() };
    let images: Vec<_> = [0, 2, 4, 6].map(image).into();
    let model = train(&trained_on.object().mesh, &images, &options).expect("a model");
    let shifted = tracked.pose(0).compose(&Pose::about(
        Vector3::new(0.01, -0.01, 0.01),
        Vector3::new(0.001, 0.001, -0.001),
        &model.shape.centre,
    ));
    let mut trackers = [CpuBackend::new(), CpuBackend::twin()].map(|backend| {
        let aligner = Box::new(InverseCompositional::default());
        let mut tracker = Tracker::new(model.clone(), *tracked.camera(), Box::new(backend), aligner)
            .expect("a valid camera");
        tracker.start_at(shifted);
        tracker
    });
    for (k, (_, image)) in tracked.frames().enumerate() {
        let [a, b] = &mut trackers;
        let [fast, twin] = [a.track(&image), b.track(&image)].map(|t| t.expect("a frame of the camera"));
        assert_eq!([fast.status, twin.status], [Status::Tracking; 2], "frame {k}");
        let (p, q) = (fast.estimate.camera_from_object, twin.estimate.camera_from_object);
        let distance = distance_px(a, &tracked, &p, &q);
        assert!(distance <= 0.02, "frame {k}: the tracks are {distance} px apart");
        assert!(distance_px(a, &tracked, &p, &shifted) > 0.02, "frame {k}: the measure sees a moved pose");
    }
}
