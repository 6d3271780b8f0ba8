//! Does a batch of streams track as each of them alone, and is the model stored once?

mod support;

use std::process::ExitCode;

use aam6d::backend::Backend;
use aam6d::backend::gpu::GpuOptions;
use aam6d::geometry::Pose;
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{SceneKind, Sequence};
use aam6d::track::{Status, Tracked, Tracker};
use aam6d::train::TrainOptions;
use libtest_mimic::{Failed, Trial};
use support::gpu::{open, trial};
use support::tracking::{cpu, sequence, tracker, trained};

/// Streams of one object, and frames of each.
const STREAMS: usize = 3;
const FRAMES: usize = 5;

fn main() -> ExitCode {
    support::gpu::main(vec![
        Trial::test("streams/cpu", || streams_track_alike(cpu())),
        trial("streams/gpu", || streams_track_alike(Box::new(open(GpuOptions::default())))),
        Trial::test("objects/cpu", two_objects_in_one_frame),
        Trial::test("errors", one_bad_frame_is_its_own),
        Trial::test("refused", as_many_images_as_trackers),
        Trial::test("unshared", backends_that_cannot_be_shared_say_so),
    ])
}

/// The frames of some streams, each with a light, a noise and a start of its own; the second one loses the object.
struct Streams {
    sequence: Sequence,
    model: Model,
    starts: Vec<Pose>,
    frames: Vec<Vec<GrayImage>>,
}

fn streams() -> Streams {
    let sequence = sequence(SceneKind::Relief, 1, 2.0);
    let model = trained(&sequence, &[0, 60], &TrainOptions::default());
    let begin = |stream: usize| 10 * stream;
    let mut frames: Vec<Vec<_>> =
        (0..STREAMS).map(|s| (0..FRAMES).map(|k| sequence.image(begin(s) + k)).collect()).collect();
    frames[1][3] = GrayImage::new(640, 480);
    let starts = (0..STREAMS).map(|s| sequence.pose(begin(s))).collect();
    Streams { sequence, model, starts, frames }
}

/// What does not depend on the clock.
fn timeless(tracked: Tracked) -> Tracked {
    Tracked { time_ms: 0.0, times: Default::default(), ..tracked }
}

fn several(first: Tracker, starts: &[Pose]) -> Result<Vec<Tracker>, Failed> {
    let mut trackers = vec![first];
    while trackers.len() < starts.len() {
        trackers.push(trackers[0].another()?);
    }
    for (tracker, start) in trackers.iter_mut().zip(starts) {
        tracker.start_at(*start);
    }
    Ok(trackers)
}

fn streams_track_alike(backend: Box<dyn Backend>) -> Result<(), Failed> {
    let Streams { sequence, model, starts, frames } = streams();
    let first = tracker(&model, *sequence.camera(), backend);
    let mut alone = several(first.another()?, &starts)?;
    let mut together = several(first, &starts)?;
    let mut lost = 0;
    for k in 0..FRAMES {
        let images: Vec<&GrayImage> = frames.iter().map(|stream| &stream[k]).collect();
        let batch = Tracker::track_batch(&mut together, &images)?;
        for (s, (tracked, tracker)) in batch.into_iter().zip(&mut alone).enumerate() {
            let (tracked, expected) = (timeless(tracked?), timeless(tracker.track(images[s])?));
            if tracked != expected {
                return Err(format!("stream {s}, frame {k}: {tracked:?} and {expected:?}").into());
            }
            lost += usize::from(!tracked.status.has_pose());
        }
    }
    // Streams that saw each other's frames, or none, would not be told apart without this.
    if lost == 1 { Ok(()) } else { Err(format!("{lost} frames lost, not 1").into()) }
}

/// A second object, known by another model, in the same image.
fn two_objects_in_one_frame() -> Result<(), Failed> {
    let Streams { sequence, model, starts, frames } = streams();
    let other = trained(&sequence, &[0, 30, 90], &TrainOptions::default());
    let make = || {
        let mut trackers = [&model, &other].map(|m| tracker(m, *sequence.camera(), cpu()));
        trackers.iter_mut().for_each(|t| t.start_at(starts[0]));
        trackers
    };
    let (mut together, mut alone) = (make(), make());
    let image = &frames[0][0];
    let batch = Tracker::track_batch(&mut together, &[image, image])?;
    for (tracked, tracker) in batch.into_iter().zip(&mut alone) {
        let (tracked, expected) = (timeless(tracked?), timeless(tracker.track(image)?));
        if tracked != expected || tracked.status != Status::Tracking {
            return Err(format!("{tracked:?} and {expected:?}").into());
        }
    }
    Ok(())
}

fn one_bad_frame_is_its_own() -> Result<(), Failed> {
    let Streams { sequence, model, starts, frames } = streams();
    let mut trackers = several(tracker(&model, *sequence.camera(), cpu()), &starts)?;
    let small = GrayImage::new(8, 8);
    let batch = Tracker::track_batch(&mut trackers, &[&frames[0][0], &small, &frames[2][0]])?;
    let is_right: Vec<bool> = batch.iter().map(Result::is_ok).collect();
    if is_right == [true, false, true] { Ok(()) } else { Err(format!("{is_right:?}").into()) }
}

fn as_many_images_as_trackers() -> Result<(), Failed> {
    let Streams { sequence, model, starts, frames } = streams();
    let mut trackers = several(tracker(&model, *sequence.camera(), cpu()), &starts)?;
    match Tracker::track_batch(&mut trackers, &[&frames[0][0]]) {
        Err(e) if e.to_string().contains("1 images for 3 trackers") => Ok(()),
        other => Err(format!("{other:?}").into()),
    }
}

/// A backend that says nothing about sharing.
struct Alone(aam6d::backend::CpuBackend);

impl Backend for Alone {
    fn name(&self) -> String {
        "alone".into()
    }

    fn load(&mut self, model: &Model) -> aam6d::Result<aam6d::backend::ModelId> {
        self.0.load(model)
    }

    fn set_frame(&mut self, image: &GrayImage, levels: usize) -> aam6d::Result<()> {
        self.0.set_frame(image, levels)
    }

    fn accumulate(
        &mut self,
        request: &aam6d::backend::Request<'_>,
        sums: &mut aam6d::backend::Sums,
    ) -> aam6d::Result<()> {
        self.0.accumulate(request, sums)
    }

    fn linearize(
        &mut self,
        request: &aam6d::backend::Request<'_>,
        out: &mut aam6d::backend::Linearization,
    ) -> aam6d::Result<()> {
        self.0.linearize(request, out)
    }
}

fn backends_that_cannot_be_shared_say_so() -> Result<(), Failed> {
    let Streams { sequence, model, .. } = streams();
    let backend = Box::new(Alone(aam6d::backend::CpuBackend::new()));
    match tracker(&model, *sequence.camera(), backend).another() {
        Err(e) if e.to_string().contains("alone cannot be shared") => Ok(()),
        other => Err(format!("{other:?}").into()),
    }
}
