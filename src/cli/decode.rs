//! Images of a scene one after the other, read when they are needed or one ahead.

use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Instant;

use image::GrayImage;

use super::frames;
use crate::dataset::{FrameInfo, Scene};

/// When the next frame is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub(super) enum Latency {
    /// When the one before it is finished: every frame gets all of the processor
    #[default]
    Low,
    /// While the one before it is tracked: more frames per second
    Pipelined,
}

/// An image and the wall time it took to read it, milliseconds.
#[derive(Debug)]
pub(super) struct Decoded {
    pub(super) image: GrayImage,
    pub(super) decode_ms: f64,
}

fn decode(frame: &FrameInfo) -> anyhow::Result<Decoded> {
    let began = Instant::now();
    let image = frames::read(frame)?;
    Ok(Decoded { image, decode_ms: began.elapsed().as_secs_f64() * 1e3 })
}

/// Calls `work` with every frame and its image, in order, until it fails.
pub(super) fn each_frame(
    scene: &Scene,
    latency: Latency,
    mut work: impl FnMut(usize, &FrameInfo, anyhow::Result<Decoded>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let numbered = || scene.frames.iter().enumerate();
    match latency {
        Latency::Low => numbered().try_for_each(|(k, frame)| work(k, frame, decode(frame))),
        Latency::Pipelined => thread::scope(|scope| {
            // Without room in the channel one image waits while another is being tracked.
            let (sender, receiver) = sync_channel(0);
            scope.spawn(move || {
                for frame in &scene.frames {
                    // Nobody receives any more once `work` has failed.
                    if sender.send(decode(frame)).is_err() {
                        return;
                    }
                }
            });
            numbered().zip(receiver).try_for_each(|((k, frame), image)| work(k, frame, image))
        }),
    }
}
