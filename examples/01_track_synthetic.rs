//! Trains on one simulated sequence and tracks the other: `cargo run --release --example 01_track_synthetic`.

use std::io::Write;

use aam6d::align::InverseCompositional;
use aam6d::backend::CpuBackend;
use aam6d::simulate::{Sequence, SequenceOptions};
use aam6d::track::Tracker;
use aam6d::train::{TrainOptions, TrainingImage, train};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [seen, unseen] = [2, 1].map(|sequence| SequenceOptions { sequence, ..SequenceOptions::default() });
    let (seen, unseen) = (Sequence::new(seen)?, Sequence::new(unseen)?);

    // A view every 15 frames is enough: each triangle takes the ones that see it best.
    let view = |k: usize| TrainingImage {
        image: seen.image(k),
        camera: *seen.camera(),
        camera_from_object: seen.pose(k),
    };
    let views: Vec<TrainingImage> = (0..seen.len()).step_by(15).map(view).collect();
    let model = train(&seen.object().mesh, &views, &TrainOptions::default())?;
    let centre = model.shape.centre;

    let (backend, aligner) = (Box::new(CpuBackend::new()), Box::new(InverseCompositional::default()));
    let mut tracker = Tracker::new(model, *unseen.camera(), backend, aligner)?;
    tracker.start_at(unseen.pose(0));
    let mut out = std::io::stdout().lock();
    for (k, (truth, image)) in unseen.frames().enumerate().take(30) {
        let tracked = tracker.track(&image)?;
        let pose = tracked.estimate.camera_from_object;
        let off = (pose.transform_point(&centre) - truth.transform_point(&centre)).norm() * 1e3;
        let turned = pose.compose(&truth.inverse()).rotation_vector().norm().to_degrees();
        writeln!(out, "frame {k:2}: {:?}, {off:.4} mm and {turned:.4} degrees off", tracked.status)?;
    }
    Ok(())
}
