//! Two cameras that see the same simulated object.

use aam6d::align::{InverseCompositional, Options};
use aam6d::backend::Backend;
use aam6d::geometry::{Camera, Pose};
use aam6d::imaging::GrayImage;
use aam6d::model::Model;
use aam6d::simulate::{Noise, Renderer, SceneKind, Sequence, SequenceOptions};
use aam6d::track::{RigCamera, RigTracker, SearchOptions, Tracker};
use aam6d::train::TrainOptions;
use nalgebra::{Rotation3, Vector3};

use super::tracking::{Disturbance, cpu, sixteen, trained};

/// Two cameras 0.25 m apart that look at the same place, and what they see of a sequence.
pub(crate) struct Pair {
    pub(crate) sequence: Sequence,
    pub(crate) model: Model,
    pub(crate) camera: Camera,
    pub(crate) other: RigCamera,
    pub(crate) frames: Vec<[GrayImage; 2]>,
}

impl Pair {
    pub(crate) fn new(scene: SceneKind, frames: usize) -> Self {
        let sequence = |number| {
            let options = SequenceOptions { scene, sequence: number, ..SequenceOptions::default() };
            Sequence::new(options).expect("good options")
        };
        let model = trained(&sequence(2), &sixteen(), &TrainOptions::default());
        let sequence = sequence(1);
        let camera = *sequence.camera();
        let turn = Rotation3::new(Vector3::y() * 0.45);
        let camera_from_reference = Pose::new(turn, Vector3::new(-0.25, 0.0, 0.05));
        // Another focal length and another light.
        let second = Camera::pinhole(650.0, 655.0, 330.0, 235.0, 640, 480);
        let other = RigCamera { camera: second, camera_from_reference, model: None };
        let beside = Renderer::new(scene.object(1), second).expect("an object").with_clutter(9, 1);
        let pair = |k: usize| {
            let mut view = sequence.view(k);
            view.pose = camera_from_reference.compose(&view.pose);
            view.light.gain = 0.8;
            view.noise = Some(Noise { sigma: 2.0, seed: 8, frame: k as u64 });
            [sequence.image(k), beside.render_view(&view)]
        };
        let frames = (0..frames).map(pair).collect();
        Self { sequence, model, camera, other, frames }
    }

    pub(crate) fn tracker(&self, backend: Box<dyn Backend>) -> Tracker {
        let aligner = Box::new(InverseCompositional::default());
        Tracker::new(self.model.clone(), self.camera, backend, aligner).expect("it fits")
    }

    pub(crate) fn rig_on(&self, backend: Box<dyn Backend>, other: RigCamera) -> RigTracker {
        let mut tracker = self.tracker(backend);
        tracker.search_by(SearchOptions::default()).expect("good options");
        RigTracker::new(tracker, vec![other], Options::default()).expect("it fits")
    }

    pub(crate) fn rig(&self, other: RigCamera) -> RigTracker {
        self.rig_on(cpu(), other)
    }

    pub(crate) fn start(&self) -> Pose {
        let vertices = &self.sequence.object().mesh.vertices;
        Disturbance::new(5, self.camera, vertices, self.model.shape.centre).apply(&self.sequence.pose(0), 3.0)
    }
}
