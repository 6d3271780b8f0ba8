//! Does a tracked frame allocate? Counted over all threads of the process, which is why this file has one test.

mod support;

use std::alloc::System;

use aam6d::align::Method;
use aam6d::backend::CpuBackend;
use aam6d::geometry::{Camera, Distortion};
use aam6d::imaging::GrayImage;
use aam6d::simulate::{SceneKind, Sequence, SequenceOptions};
use aam6d::track::{Status, Tracked, Tracker};
use aam6d::train::TrainOptions;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use support::tracking::{say, sequence, sixteen, trained};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Frames in which buffers may grow to their size, and frames that are counted.
const WARM_UP: usize = 4;
const COUNTED: usize = 20;

/// Bytes that one more stream may take on the host. It has its own frame (three times its size: pairs and halves),
/// depth buffer and sums, and no copy of the model.
const MOST_PER_STREAM: usize = 2_800_000;

/// Tracks all frames, or copies of them; returns how often memory was asked for, or more of it, after the warm-up.
fn allocations(
    sequence: &Sequence,
    frames: &[GrayImage],
    modes: usize,
    camera: Camera,
    copied: bool,
) -> usize {
    let options = TrainOptions { modes, ..TrainOptions::default() };
    let model = trained(sequence, &sixteen(), &options);
    let backend = Box::new(CpuBackend::new());
    let mut tracker =
        Tracker::new(model, camera, backend, Method::default().aligner()).expect("a good model");
    tracker.start_at(sequence.pose(0));
    let mut tracked = Tracked::default();
    let mut region = Region::new(ALLOCATOR);
    for (k, frame) in frames.iter().enumerate() {
        if k == WARM_UP {
            region.reset();
        }
        let copy = copied.then(|| frame.clone());
        tracker.track_into(copy.as_ref().unwrap_or(frame), &mut tracked).expect("a good frame");
        assert_eq!(tracked.status, Status::Tracking, "frame {k}");
    }
    let change = region.change();
    change.allocations + change.reallocations
}

/// Bytes that a tracker takes, with its model, and what one more stream of the same object takes, frame included.
fn bytes_of_streams(sequence: &Sequence, image: &GrayImage) -> [usize; 2] {
    let model = trained(sequence, &sixteen(), &TrainOptions { modes: 4, ..TrainOptions::default() });
    let region = Region::new(ALLOCATOR);
    let held = |region: &Region<'_, System>| {
        let change = region.change();
        change.bytes_allocated.saturating_sub(change.bytes_deallocated)
    };
    let aligner = Method::default().aligner();
    let mut first =
        Tracker::new(model, *sequence.camera(), Box::new(CpuBackend::new()), aligner).expect("a good model");
    let model = held(&region);
    let mut more: Vec<Tracker> = (0..8).map(|_| first.another().expect("shared")).collect();
    let before = held(&region);
    for tracker in more.iter_mut().chain([&mut first]) {
        tracker.start_at(sequence.pose(0));
        assert_eq!(tracker.track(image).expect("a good frame").status, Status::Tracking, "in view");
    }
    [model, (held(&region) - before) / 9 + (before - model) / 8]
}

#[test]
fn a_tracked_frame_allocates_nothing() {
    let relief = sequence(SceneKind::Relief, 1, 2.0);
    let [model, stream] = bytes_of_streams(&relief, &relief.image(0));
    say(format_args!("{model} bytes for a model, {stream} for every further stream"));
    assert!(stream < MOST_PER_STREAM, "{stream} bytes per stream");

    for (modes, kind) in [(0, SceneKind::Relief), (4, SceneKind::Relief), (0, SceneKind::Box)] {
        let options = SequenceOptions { light: modes > 0, ..*sequence(kind, 1, 2.0).options() };
        let sequence = Sequence::new(options).expect("good options");
        let frames: Vec<_> = (0..WARM_UP + COUNTED).map(|k| sequence.image(k)).collect();
        let plain = *sequence.camera();
        // So little distortion that the frames still fit, but every one is rectified.
        let bent = Camera { distortion: Distortion { k1: 1e-9, ..Distortion::default() }, ..plain };
        for camera in [plain, bent] {
            let n = allocations(&sequence, &frames, modes, camera, false);
            say(format_args!("{kind:?}, {modes} modes: {n} allocations in {COUNTED} frames"));
            assert_eq!(n, 0, "{kind:?}, {modes} modes, {camera:?}");
        }
        // The control: one allocation per frame is noticed.
        let n = allocations(&sequence, &frames, modes, plain, true);
        assert_eq!(n, COUNTED, "copies of frames are counted");
    }
}
