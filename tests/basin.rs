//! From how far away does the tracker find the box? With the search that it starts by itself.

mod support;

use aam6d::align::Start;
use aam6d::geometry::Pose;
use aam6d::simulate::SceneKind;
use aam6d::train::TrainOptions;
use nalgebra::{Point3, Vector3, Vector6};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use support::tracking::{cpu, distance_px, say, sequence, start, tracker, trained};

/// Found if the corners are nearer to the truth than this (rms), pixels.
const FOUND_PX: f64 = 1.0;
/// Frames looked at, and starts in each.
const FRAMES: usize = 16;
const STARTS: usize = 2;
/// Distance (millimetres), turn (degrees), and the share that must be found.
const BASIN: [(f64, f64, f64); 4] = [(5.0, 1.0, 1.0), (10.0, 2.0, 1.0), (20.0, 5.0, 0.97), (40.0, 10.0, 0.6)];

/// A random direction, uniform on the sphere.
fn direction(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    loop {
        let v = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        if (0.01..=1.0).contains(&v.norm()) {
            return v.normalize();
        }
    }
}

/// The pose moved in a random direction and turned about a random axis through the centre.
fn moved(rng: &mut ChaCha8Rng, pose: &Pose, centre: &Point3<f64>, mm: f64, degrees: f64) -> Pose {
    let (shift, turn) = (direction(rng) * mm * 1e-3, direction(rng) * degrees.to_radians());
    let d = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
    pose.compose(&Pose::increment(&d, centre))
}

#[test]
fn the_box_is_found_from_afar() {
    let sequence = sequence(SceneKind::Box, 1, 2.0);
    let model = trained(&sequence, &[0, 119], &TrainOptions::default());
    let (camera, corners) = (*sequence.camera(), model.shape.corners);
    let mut rng = ChaCha8Rng::seed_from_u64(41);
    let mut tracker = tracker(&model, camera, cpu());
    let mut failures = Vec::new();
    let images: Vec<_> =
        (0..FRAMES).map(|k| k * 119 / (FRAMES - 1)).map(|k| (sequence.pose(k), sequence.image(k))).collect();
    for (mm, degrees, least) in BASIN {
        let (mut found, mut wrong, mut steps) = (0, 0, 0);
        let began = cpu_time::ProcessTime::now();
        for (truth, image) in &images {
            let starts: Vec<Start> = (0..STARTS)
                .map(|_| start(&model, moved(&mut rng, truth, &model.shape.centre, mm, degrees)))
                .collect();
            for end in tracker.align(image, &starts).expect("good starts") {
                let near = distance_px(&camera, &corners, truth, &end.camera_from_object) < FOUND_PX;
                found += usize::from(near);
                wrong += usize::from(!near && !end.score.is_lost());
                steps += end.iterations;
            }
        }
        #[expect(clippy::cast_precision_loss, reason = "counts are small")]
        let [found, all, steps] = [found, FRAMES * STARTS, steps].map(|n| n as f64);
        let text = format!(
            "{mm} mm and {degrees} deg: {:.1} % found, {wrong} wrong ones believed, {:.1} steps and {:.1} ms of processor time for each start",
            100.0 * found / all,
            steps / all,
            began.elapsed().as_secs_f64() * 1e3 / all
        );
        say(format_args!("{text}"));
        if found < least * all {
            failures.push(text);
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}
