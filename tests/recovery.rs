//! The object leaves the image, or is covered, and comes back elsewhere: lost at once, found again, and no pose in
//! between.

mod support;

use aam6d::geometry::Pose;
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{Noise, Occluder, SceneKind, Sequence, SequenceOptions, View};
use aam6d::track::{SearchOptions, Status, Tracked, calibrate};
use aam6d::train::TrainOptions;
use nalgebra::Vector3;
use rayon::prelude::*;
use support::tracking::{cpu, distance_px, say, sixteen, tracker, trained, training_image};

/// Frames before it goes, while it goes, and after its return.
const BEFORE: usize = 10;
const GOING: usize = 8;
const AFTER: usize = 12;
/// A pose farther off than this is never reported as tracked, pixels (rms over the mesh).
const FALSE_PX: f64 = 10.0;
/// Lost so many frames after it has gone, found so many after it is back.
const LOST_WITHIN: usize = 3;
const FOUND_WITHIN: usize = 5;

/// How it disappears.
#[derive(Debug, Clone, Copy)]
enum Story {
    Leaves,
    IsCovered,
}

impl Story {
    /// Frames without the object. Each is searched, so that one of the two is made short; `AAM6D_SEEDS`, which asks for more
    /// objects, has both long.
    fn away(self) -> usize {
        match self {
            Self::IsCovered if std::env::var_os("AAM6D_SEEDS").is_none() => 8,
            _ => 30,
        }
    }
}

/// A frame: its image, where the object is, and whether any of it, or all of it, is to be seen.
struct Frame {
    image: GrayImage,
    truth: Pose,
    seen: Seen,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Seen {
    Whole,
    Partly,
    Gone,
}

fn sequence(scene: SceneKind, seed: u64, number: u32) -> Sequence {
    let options = SequenceOptions { scene, seed, sequence: number, ..SequenceOptions::default() };
    Sequence::new(options).expect("good options")
}

fn model(scene: SceneKind, seed: u64) -> Model {
    let other = sequence(scene, seed, 2);
    let mut model = trained(&other, &sixteen(), &TrainOptions::default());
    let images: Vec<_> = sixteen().iter().map(|&k| training_image(&other, k)).collect();
    calibrate(&mut model, &images).expect("the images of the training");
    model
}

fn shifted(pose: &Pose, x: f64, y: f64) -> Pose {
    Pose::from_quaternion(pose.quaternion(), pose.translation() + Vector3::new(x, y, 0.0))
}

fn frame(sequence: &Sequence, story: Story, k: usize) -> Frame {
    let gone = BEFORE + GOING;
    let back = gone + story.away();
    let share = (k.saturating_sub(BEFORE) as f64 / GOING as f64).min(1.0);
    let seen = match share {
        _ if k >= back || share <= 0.0 => Seen::Whole,
        1.0 => Seen::Gone,
        _ => Seen::Partly,
    };
    let (truth, hidden) = match story {
        _ if k >= back => (shifted(&sequence.pose(k + 30), -0.04, 0.03), 0.0),
        // Faster and faster to the right, out of view when it has gone.
        Story::Leaves => (shifted(&sequence.pose(k), 0.62 * share * share, 0.0), 0.0),
        Story::IsCovered => (sequence.pose(k), share),
    };
    let noise = Some(Noise { sigma: 2.0, seed: 3, frame: k as u64 });
    let occluder = (hidden > 0.0).then_some(Occluder { fraction: hidden, angle: 2.2 });
    let view = View { pose: truth, occluder, noise, ..View::default() };
    Frame { image: sequence.renderer().render_view(&view), truth, seen }
}

/// What must not happen, and the frames from the return until the object is tracked again.
fn follow(scene: SceneKind, seed: u64, story: Story) -> (Vec<String>, Option<usize>) {
    let sequence = sequence(scene, seed, 1);
    let model = model(scene, seed);
    let count = BEFORE + GOING + story.away() + AFTER;
    let frames: Vec<Frame> = (0..count).into_par_iter().map(|k| frame(&sequence, story, k)).collect();
    let mut tracker = tracker(&model, *sequence.camera(), cpu());
    tracker.search_by(SearchOptions::default()).expect("good options");
    tracker.start_at(frames[0].truth);
    let vertices = &sequence.object().mesh.vertices;
    let (mut failures, mut found) = (Vec::new(), None);
    let (gone, back) = (BEFORE + GOING, BEFORE + GOING + story.away());
    let mut line = String::new();
    for (k, frame) in frames.iter().enumerate() {
        let Tracked { status, probability, estimate, .. } = tracker.track(&frame.image).expect("a frame");
        let px = distance_px(sequence.camera(), vertices, &frame.truth, &estimate.camera_from_object);
        line += &format!("{}{:.2}/{px:.1} ", &format!("{status:?}")[..1], probability);
        let report =
            |what: &str| format!("frame {k}: {what}, {status:?} with {probability:.3}, {px:.1} px off");
        if status == Status::Tracking && px > FALSE_PX {
            failures.push(report("a false pose"));
        }
        if status.has_pose() && frame.seen == Seen::Gone && k >= gone + LOST_WITHIN {
            failures.push(report("nothing is there"));
        }
        if frame.seen == Seen::Whole && k < back && status != Status::Tracking {
            failures.push(report("it was in full view"));
        }
        if k >= back && status == Status::Tracking && px < 1.0 && found.is_none() {
            found = Some(k - back + 1);
        }
    }
    if std::env::var_os("AAM6D_FIGURES").is_some() {
        say(format_args!("{line}"));
    }
    say(format_args!("{scene:?} {seed} {story:?}: {} failures, back after {found:?} frames", failures.len()));
    (failures, found)
}

fn returns(scene: SceneKind, story: Story) {
    let seeds = std::env::var("AAM6D_SEEDS").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    for seed in 1..=seeds {
        let (failures, found) = follow(scene, seed, story);
        assert!(failures.is_empty(), "{failures:#?}");
        assert!(found.is_some_and(|k| k <= FOUND_WITHIN), "found after {found:?} frames");
    }
}

#[test]
fn the_relief_leaves_and_returns() {
    returns(SceneKind::Relief, Story::Leaves);
}

#[test]
fn the_box_is_covered_and_returns() {
    returns(SceneKind::Box, Story::IsCovered);
}
