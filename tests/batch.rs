//! Does a batch of streams track as each of them alone, and is the model stored once?

mod support;

use std::process::ExitCode;

use aam6d::backend::cpu::downsample::downsample;
use aam6d::backend::gpu::{GpuOptions, PyramidPlace};
use aam6d::backend::{Backend, CpuBackend, Request, Sums};
use aam6d::geometry::Pose;
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{SceneKind, Sequence};
use aam6d::track::{Status, Tracked, Tracker};
use aam6d::train::TrainOptions;
use libtest_mimic::{Failed, Trial};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use support::gpu::{open, trial};
use support::tracking::{cpu, sequence, tracker, trained};
use support::{Scene, compare_images};

/// Streams of one object, and frames of each.
const STREAMS: usize = 3;
const FRAMES: usize = 5;

fn main() -> ExitCode {
    support::gpu::main(vec![
        Trial::test("streams/cpu", || streams_track_alike(cpu())),
        trial("streams/gpu", || streams_track_alike(Box::new(open(GpuOptions::default())))),
        trial("calls/gpu", streams_share_calls),
        trial("frames/host", || frames_are_told_apart(PyramidPlace::Host)),
        trial("frames/device", || frames_are_told_apart(PyramidPlace::Device)),
        trial("frames/refused", frames_that_do_not_fit_are_refused),
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

/// Three streams that see the same cost as many calls as one of them.
fn streams_share_calls() -> Result<(), Failed> {
    let Streams { sequence, model, starts, frames } = streams();
    let first = tracker(&model, *sequence.camera(), Box::new(open(GpuOptions::default())));
    let mut alone = several(first.another()?, &starts[..1])?;
    let mut together = several(first, &[starts[0]; STREAMS])?;
    for (k, image) in frames[0].iter().enumerate() {
        let before = alone[0].traffic();
        alone[0].track(image)?;
        let between = alone[0].traffic();
        for tracked in Tracker::track_batch(&mut together, &[image; STREAMS])? {
            tracked?;
        }
        let after = alone[0].traffic();
        let one = [between.submits - before.submits, between.maps - before.maps];
        let all = [after.submits - between.submits, after.maps - between.maps];
        let bytes = [between.bytes_read - before.bytes_read, after.bytes_read - between.bytes_read];
        if all != one || bytes[1] != STREAMS as u64 * bytes[0] || one[1] < 4 {
            return Err(format!("frame {k}: {all:?} submits and maps, {one:?} alone; bytes {bytes:?}").into());
        }
    }
    Ok(())
}

/// Poses in several frames at once have the sums that they have in their frame alone, and no others.
fn frames_are_told_apart(pyramid: PyramidPlace) -> Result<(), Failed> {
    let mut gpu = open(GpuOptions { pyramid, ..GpuOptions::default() });
    let mut scene = Scene::new(50, 257, 4, 6);
    let model = gpu.load(&scene.model)?;
    let size = scene.image.dimensions();
    // Twice the size, for poses on level 1 of the pyramid.
    let images: Vec<_> = (60..63)
        .map(|seed| support::image(&mut ChaCha8Rng::seed_from_u64(seed), 2 * size.0 + 1, 2 * size.1))
        .collect();
    let mut alone = Vec::new();
    for image in &images {
        gpu.set_frame(image, 2)?;
        let mut sums = Sums::default();
        gpu.accumulate(&Request { image_level: 1, ..scene.request(model) }, &mut sums)?;
        alone.push(sums);
    }
    scene.frames = vec![2, 0, 1, 1, 0, 2];
    gpu.set_frames(&images.iter().collect::<Vec<_>>(), 2)?;
    let mut sums = Sums::default();
    gpu.accumulate(&Request { image_level: 1, ..scene.request(model) }, &mut sums)?;
    for (item, frame) in scene.frames.iter().enumerate() {
        for (k, alone) in alone.iter().enumerate() {
            if (sums.item(item) == alone.item(item)) != (k == *frame) {
                return Err(format!("pose {item} in frame {frame}: compared with frame {k}").into());
            }
        }
        compare_images(&downsample(&images[*frame]), &gpu.read_level(*frame, 1)?)?;
    }
    Ok(())
}

fn frames_that_do_not_fit_are_refused() -> Result<(), Failed> {
    let says = |what: &str, result: aam6d::Result<()>| match result {
        Err(e) if e.to_string().contains(what) => Ok(()),
        other => Err(format!("{what}: {other:?}")),
    };
    let (image, other) = (GrayImage::new(64, 48), GrayImage::new(48, 64));
    let mut gpu = open(GpuOptions::default());
    says("have one size", gpu.set_frames(&[&image, &other], 1))?;
    says("the device takes", gpu.set_frames(&vec![&image; gpu.frames_at_once((64, 48)) + 1], 1))?;
    says("holds one", CpuBackend::new().set_frames(&[&image, &image], 1))?;
    let mut scene = Scene::new(51, 1, 0, 2);
    let model = gpu.load(&scene.model)?;
    gpu.set_frames(&[&image, &image], 1)?;
    scene.frames = vec![0, 2];
    says("frame 2 of 2", gpu.accumulate(&scene.request(model), &mut Sums::default()))?;
    scene.frames = vec![0];
    Ok(says("1 frames named for 2 poses", gpu.accumulate(&scene.request(model), &mut Sums::default()))?)
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
struct Alone(CpuBackend);

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

    fn accumulate(&mut self, request: &Request<'_>, sums: &mut Sums) -> aam6d::Result<()> {
        self.0.accumulate(request, sums)
    }

    fn linearize(
        &mut self,
        request: &Request<'_>,
        out: &mut aam6d::backend::Linearization,
    ) -> aam6d::Result<()> {
        self.0.linearize(request, out)
    }
}

fn backends_that_cannot_be_shared_say_so() -> Result<(), Failed> {
    let Streams { sequence, model, .. } = streams();
    let backend = Box::new(Alone(CpuBackend::new()));
    match tracker(&model, *sequence.camera(), backend).another() {
        Err(e) if e.to_string().contains("alone cannot be shared") => Ok(()),
        other => Err(format!("{other:?}").into()),
    }
}
