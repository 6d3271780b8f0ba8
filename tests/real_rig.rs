//! Both cameras of the real stereo pair at once, where the data are present (see `support/data.rs`).

mod support;

use std::path::Path;

use aam6d::align::{InverseCompositional, Options};
use aam6d::backend::CpuBackend;
use aam6d::dataset::stereo::read_stereo;
use aam6d::dataset::{Dataset, PoseSource, Scene};
use aam6d::eval::EvalObject;
use aam6d::eval::errors::motion_error;
use aam6d::eval::statistics::{median, percentile};
use aam6d::geometry::{Camera, Pose, TriangleMesh};
use aam6d::imaging::{GrayImage, gray};
use aam6d::model::Model;
use aam6d::track::{RigCamera, RigTracker, Status, Tracker, calibrate};
use aam6d::train::{TrainOptions, TrainingImage, train};
use libtest_mimic::Failed;
use support::data::{self, check, figure};

/// The goal: medians of the distance from the joint reference, millimetres and degrees.
const GOAL: [f64; 2] = [0.5, 0.3];

fn main() {
    data::main(vec![data::trial("both_cameras", both_cameras)]);
}

fn images(scene: &Scene) -> Result<Vec<GrayImage>, Failed> {
    let read = |f: &aam6d::dataset::FrameInfo| gray::read_sized(&f.image, f.camera.width, f.camera.height);
    Ok(scene.frames.iter().map(read).collect::<Result<_, _>>()?)
}

/// What both cameras see, and the joint reference.
struct Stereo {
    cameras: [Camera; 2],
    right_from_left: Pose,
    images: [Vec<GrayImage>; 2],
    reference: Vec<Pose>,
    mesh: TriangleMesh,
}

impl Stereo {
    fn read(folder: &Path) -> Result<Self, Failed> {
        let dataset = Dataset::open(folder)?;
        let rig = read_stereo(&folder.join("stereo.json"))?.rig;
        Ok(Self {
            cameras: [rig.left, rig.right],
            right_from_left: rig.right_from_left,
            images: [images(&dataset.scene(1)?)?, images(&dataset.scene(2)?)?],
            reference: dataset.poses(1, 1, &PoseSource::Reference)?.into_values().collect(),
            mesh: dataset.mesh(1)?,
        })
    }

    /// A model of frames of one camera.
    fn model(&self, camera: usize, frames: &[usize]) -> Result<Model, Failed> {
        let place = if camera == 0 { Pose::identity() } else { self.right_from_left };
        let image = |&k: &usize| TrainingImage {
            image: self.images[camera][k].clone(),
            camera: self.cameras[camera],
            camera_from_object: place.compose(&self.reference[k]),
        };
        let images: Vec<TrainingImage> = frames.iter().map(image).collect();
        let mut model = train(&self.mesh, &images, &TrainOptions::default())?;
        calibrate(&mut model, &images)?;
        Ok(model)
    }

    /// Tracks all frames with both cameras; how many were tracked, and the poses.
    fn follow(&self, left: Model, right: Option<Model>) -> Result<(usize, Vec<Pose>), Failed> {
        let aligner = Box::new(InverseCompositional::default());
        let tracker = Tracker::new(left, self.cameras[0], Box::new(CpuBackend::new()), aligner)?;
        let other =
            RigCamera { camera: self.cameras[1], camera_from_reference: self.right_from_left, model: right };
        let mut rig = RigTracker::new(tracker, vec![other], Options::default())?;
        rig.start_at(self.reference[0]);
        let (mut tracked, mut poses) = (0, Vec::new());
        for (left, right) in self.images[0].iter().zip(&self.images[1]) {
            let found = rig.track(&[left, right])?;
            tracked += usize::from(found.status == Status::Tracking);
            poses.push(found.estimate.camera_from_object);
        }
        Ok((tracked, poses))
    }

    /// Medians of the distance from the joint reference: millimetres of the centre and degrees.
    fn judge(&self, what: &str, poses: &[Pose]) -> Result<[f64; 2], Failed> {
        let centre = EvalObject::new(&self.mesh)?.centre();
        let error = |(p, truth): (&Pose, &Pose)| {
            let mm = (p.transform_point(&centre) - truth.transform_point(&centre)).norm() * 1e3;
            (mm, p.compose(&truth.inverse()).rotation_vector().norm().to_degrees())
        };
        let (t, r): (Vec<f64>, Vec<f64>) = poses.iter().zip(&self.reference).map(error).unzip();
        let first = (&poses[0], &self.reference[0]);
        let motion = |k: usize| motion_error((first.0, &poses[k]), (first.1, &self.reference[k]), &centre);
        let (mt, mr): (Vec<f64>, Vec<f64>) = (1..poses.len()).map(motion).unzip();
        let [t50, r50, mt50, mr50] = [&t, &r, &mt, &mr].map(|v| median(v).unwrap_or(f64::INFINITY));
        let [t95, r95] = [&t, &r].map(|v| percentile(v, 95.0).unwrap_or(f64::INFINITY));
        figure(&format!(
            "{what}: {t50:.2} mm {r50:.2} deg (95 %: {t95:.2}, {r95:.2}), motion {mt50:.2} mm {mr50:.2} deg"
        ));
        Ok([t50, r50])
    }
}

/// Each camera with a model of its own images, all posed by the joint reference, and judged by it.
///
/// One model for both cameras cannot do it: tracked in the right camera with a model of the left one, the box is 3.4 px from
/// where the calibration of the pair puts it. That calibration and these images do not agree, and the reference, which
/// matches no texture across the cameras, does not show it.
fn both_cameras(folder: &Path) -> Result<(), Failed> {
    let stereo = Stereo::read(&folder.join("teabox_stereo"))?;
    let count = stereo.images[0].len();
    let mut reached = Vec::new();
    for (what, frames) in [
        ("1 frame", vec![0]),
        ("4 frames", vec![0, 40, 80, 120]),
        ("7 frames", (0..7).map(|k| 20 * k).collect()),
    ] {
        let (left, right) = (stereo.model(0, &frames)?, stereo.model(1, &frames)?);
        let (_, poses) = stereo.follow(left.clone(), None)?;
        stereo.judge(&format!("{what}, one model"), &poses)?;
        let (tracked, poses) = stereo.follow(left, Some(right))?;
        reached.push(stereo.judge(&format!("{what}, {tracked} of {count} tracked, own models"), &poses)?);
        check(tracked == count, format!("{what}: {tracked} of {count} tracked"))?;
    }
    let [t, r] = reached[0];
    check(t <= GOAL[0] && r <= GOAL[1], format!("medians of {t} mm and {r} degrees"))
}
