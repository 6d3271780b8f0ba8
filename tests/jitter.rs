//! Does the pose of an object at rest stand still? Only the noise changes from frame to frame.

mod support;

use aam6d::geometry::Pose;
use aam6d::imaging::GrayImage;
use aam6d::simulate::{Noise, SceneKind, View};
use aam6d::train::TrainOptions;
use nalgebra::Vector3;
use rayon::prelude::*;
use support::tracking::{cpu, say, sequence, sixteen, track, tracker, trained};

/// Standard deviations per camera axis with noise of 2 grey levels: millimetres of the centre and degrees.
const MOST: [f64; 2] = [0.02, 0.01];
const FRAMES: u64 = 60;
/// Not of the sequence that the model was trained on.
const AT: usize = 40;

/// Largest standard deviation of the three axes.
fn deviation(values: &[Vector3<f64>]) -> f64 {
    let count = values.len() as f64;
    let mean = values.iter().sum::<Vector3<f64>>() / count;
    let square = |v: &Vector3<f64>| (v - mean).component_mul(&(v - mean));
    (values.iter().map(square).sum::<Vector3<f64>>() / (count - 1.0)).max().sqrt()
}

fn jitter(scene: SceneKind, noise: f64) -> [f64; 2] {
    let model = trained(&sequence(scene, 2, 2.0), &sixteen(), &TrainOptions::default());
    let sequence = sequence(scene, 1, 2.0);
    let truth = sequence.pose(AT);
    let image = |frame: u64| {
        let noise = Some(Noise { sigma: noise, seed: 21, frame });
        sequence.renderer().render_view(&View { pose: truth, noise, ..View::default() })
    };
    let frames: Vec<GrayImage> = (0..FRAMES).into_par_iter().map(image).collect();
    let tracked = track(&mut tracker(&model, *sequence.camera(), cpu()), truth, &frames);
    let poses: Vec<Pose> = tracked.iter().map(|t| t.estimate.camera_from_object).collect();
    let centres: Vec<_> = poses.iter().map(|p| p.transform_point(&model.shape.centre).coords * 1e3).collect();
    let turn = |p: &Pose| p.compose(&truth.inverse()).rotation_vector().map(f64::to_degrees);
    let turns: Vec<_> = poses.iter().map(turn).collect();
    let found = [deviation(&centres), deviation(&turns)];
    say(format_args!(
        "{scene:?}, noise of {noise}: {:.4} mm and {:.4} deg on the worst axis",
        found[0], found[1]
    ));
    found
}

#[test]
fn an_object_at_rest_stands_still() {
    for scene in [SceneKind::Relief, SceneKind::Box] {
        let [mm, degrees] = jitter(scene, 2.0);
        assert!(mm <= MOST[0] && degrees <= MOST[1], "{scene:?}: {mm} mm, {degrees} degrees");
        // Without noise little changes (a frame ends within a small step of the end, which is in turns before and behind it
        // where all of a face crosses pixels at a time), with more of it more does.
        let (still, worse) = (jitter(scene, 0.0), jitter(scene, 8.0));
        assert!(still[0] < 0.5 * mm && worse[0] > 2.0 * mm, "{scene:?}: {still:?} and {worse:?}");
    }
}
