//! Does tracking keep its memory to itself? Measured on the whole process, which is why this file has one test.

mod support;

use aam6d::simulate::SceneKind;
use aam6d::track::Status;
use aam6d::train::TrainOptions;
use support::tracking::{cpu, say, sequence, tracker, trained};

/// Frames after which memory is looked at, first and last.
const FRAMES: [usize; 2] = [50, 300];
/// Memory may grow by this much in between: what an allocator keeps here and there.
const GROWTH_KIB: u64 = 4 * 1024;
/// The most the process may ever need on the CPU backend, with simulation and training.
const PEAK_KIB: u64 = 300 * 1024;

/// A line of the process's status, KiB; `None` where there is no such thing.
fn status_kib(name: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with(name))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

#[test]
fn tracking_does_not_grow() {
    if status_kib("VmRSS").is_none() {
        say(format_args!("skipped: this system has no /proc/self/status"));
        return;
    }
    let sequence = sequence(SceneKind::Box, 1, 2.0);
    let model = trained(&sequence, &[0, 8], &TrainOptions::default());
    // Back and forth over a few frames, rendered beforehand.
    let frames: Vec<_> = (0..8).map(|k| sequence.image(k)).collect();
    let mut tracker = tracker(&model, *sequence.camera(), cpu());
    tracker.start_at(sequence.pose(0));
    let mut resident = Vec::new();
    for k in 1..=FRAMES[1] {
        let at = (k - 1) % 14;
        let tracked = tracker.track(&frames[at.min(14 - at)]).expect("a good frame");
        assert_eq!(tracked.status, Status::Tracking, "frame {k}");
        if FRAMES.contains(&k) {
            resident.extend(status_kib("VmRSS"));
        }
    }
    let peak = status_kib("VmHWM").expect("known beside VmRSS");
    say(format_args!("{resident:?} KiB after {FRAMES:?} frames, {peak} KiB at most"));
    assert!(resident[1] <= resident[0] + GROWTH_KIB, "{resident:?} KiB after {FRAMES:?} frames");
    assert!(peak <= PEAK_KIB, "{peak} KiB at most");
}
