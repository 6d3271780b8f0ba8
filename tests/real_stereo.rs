//! Real stereo, where it is present (see `support/data.rs`): landmarks from a stereo pair, and what the pair's calibration
//! says about the size of the box.

mod support;

use std::collections::BTreeMap;
use std::path::Path;

use aam6d::align::InverseCompositional;
use aam6d::backend::CpuBackend;
use aam6d::dataset::stereo::read_stereo;
use aam6d::dataset::{Dataset, PoseSource, Scene};
use aam6d::eval::EvalObject;
use aam6d::eval::errors::motion_error;
use aam6d::eval::statistics::{median, percentile};
use aam6d::geometry::bundle::{self, Mark, Prior, Sighting};
use aam6d::geometry::raster::visible_shares;
use aam6d::geometry::stereo::{ClickOptions, ClickPair, StereoRig};
use aam6d::geometry::{Pose, TriangleMesh};
use aam6d::imaging::{GrayImage, corners, gray};
use aam6d::track::{Status, Tracker};
use aam6d::train::{TrainOptions, TrainingImage, annotated::landmark_mesh, train};
use libtest_mimic::Failed;
use nalgebra::{Point2, Point3, Rotation3, Vector3};
use support::data::{self, check, figure};

const CASES: [(&str, data::Case); 2] =
    [("teabox_stereo_size", teabox_stereo_size), ("teabox_stereo_landmarks", teabox_stereo_landmarks)];

/// Not the goal (0.5 mm) but what is reached, with a margin.
const STEREO_MM: f64 = 2.8;

/// Frames that show the landmarks once more; the first one is where they are clicked.
const MORE_FRAMES: [usize; 6] = [20, 40, 60, 80, 100, 120];

fn main() {
    data::main(CASES.map(|(name, case)| data::trial(name, case)).into());
}

/// The box as each camera sees it on its own, put together by the calibration of the pair: no tracker has a part in it.
///
/// Each camera's own reference fits its images to 0.15 px. The corners of the box in both images, triangulated with
/// `stereo.json`, should be a box of 165 x 68 x 80 mm.
fn teabox_stereo_size(folder: &Path) -> Result<(), Failed> {
    let folder = folder.join("teabox_stereo");
    let dataset = Dataset::open(&folder)?;
    let rig = read_stereo(&folder.join("stereo.json"))?.rig;
    let mesh = dataset.mesh(1)?;
    let own = |scene: u32| {
        let file = folder.join(format!("test/{scene:06}/scene_ref_mono.json"));
        dataset.poses(scene, 1, &PoseSource::File(file))
    };
    let (left, right) = (own(1)?, own(2)?);
    let corners = EvalObject::new(&mesh)?.corners();
    let (mut ratios, mut nearer, mut off) = (Vec::new(), Vec::new(), Vec::new());
    for (frame, pose) in &left {
        let pair = |x: &Point3<f64>| {
            let left = rig.left.project(&pose.transform_point(x))?;
            Some(ClickPair {
                name: String::new(),
                left,
                right: rig.right.project(&right[frame].transform_point(x))?,
            })
        };
        let pairs: Option<Vec<ClickPair>> = corners.iter().map(pair).collect();
        let pairs = pairs.ok_or("a corner is behind a camera")?;
        off.extend(pairs.iter().filter_map(|p| rig.epipolar_px(p)));
        let options = ClickOptions { max_epipolar_px: f64::INFINITY, ..ClickOptions::default() };
        let points = rig.triangulate_all(&pairs, &options)?;
        for a in 0..8 {
            nearer.push(points[a].position.z / pose.transform_point(&corners[a]).z);
            for b in 0..a {
                let known = (corners[a] - corners[b]).norm();
                ratios.push((points[a].position - points[b].position).norm() / known);
            }
        }
    }
    let [ratio, depth, epipolar] = [ratios, nearer, off].map(|v| median(&v).unwrap_or(f64::NAN));
    figure(&format!(
        "the box by both cameras' own references and stereo.json: {ratio:.4} times its size, at {depth:.4} times the \
         depth the left camera alone says; epipolar distance {epipolar:.2} px (medians)"
    ));
    check((ratio - 1.0).abs() < 0.06, format!("{ratio} times its size"))
}

/// Corners of the box's texture, found in the left image of frame 0 and matched in the right one.
fn clicks(dataset: &Dataset, pair: [&GrayImage; 2], stereo: &Path) -> Result<Vec<ClickPair>, Failed> {
    let rig = read_stereo(stereo)?.rig;
    let mesh = dataset.mesh(1)?;
    let pose = dataset.poses(1, 1, &PoseSource::Reference)?[&0];
    // A person would click on the box; here the reference says where it is.
    let seen = visible_shares(&mesh, &rig.left, &pose);
    let outlines: Vec<[Point2<f64>; 3]> = (0..mesh.triangles.len())
        .filter(|&t| seen[t] > 0.5)
        .filter_map(|t| {
            let [a, b, c] = mesh.corners(t).map(|x| rig.left.project(&pose.transform_point(&x)));
            Some([a?, b?, c?])
        })
        .collect();
    let inside = |p: &Point2<f64>| {
        outlines.iter().any(|t| {
            let side = |k: usize| {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x)
            };
            let s = [side(0), side(1), side(2)];
            s.iter().all(|v| *v >= 0.0) || s.iter().all(|v| *v <= 0.0)
        })
    };
    let found = corners::corners(pair[0], 120, 16.0, inside);
    let mut clicks = Vec::new();
    for (k, left) in found.iter().enumerate() {
        if let Some(right) = corners::partner(&rig, pair, left, [0.3, 0.6]) {
            clicks.push(ClickPair { name: format!("c{k}"), left: *left, right });
        }
    }
    figure(&format!("{} corners, {} with a partner", found.len(), clicks.len()));
    Ok(clicks)
}

/// Factor on the landmarks (left camera of frame 0) that puts them on the reference box, median over the landmarks.
fn scale_of_reference(mesh: &TriangleMesh, pose: &Pose, shape: &[Point3<f64>]) -> f64 {
    let factor = |x: &Point3<f64>| {
        let of_plane = |t: usize| {
            let (n, a) = (pose.rotate(&mesh.normal(t)), pose.transform_point(&mesh.corners(t)[0]));
            n.dot(&a.coords) / n.dot(&x.coords)
        };
        (0..mesh.triangles.len())
            .map(of_plane)
            .fold(0.0, |b: f64, s| if (s - 1.0).abs() < (b - 1.0).abs() { s } else { b })
    };
    median(&shape.iter().map(factor).collect::<Vec<_>>()).unwrap_or(1.0)
}

/// What is tracked, and what it is compared with.
struct Track {
    frames: Vec<GrayImage>,
    ids: Vec<u32>,
    rig: StereoRig,
    centre: Point3<f64>,
    references: [(&'static str, BTreeMap<u32, Pose>); 2],
}

impl Track {
    /// Trains on frame 0, whose camera is the object frame, and tracks all frames; how many were tracked.
    fn follow(&self, shape: &[Point3<f64>]) -> Result<(Vec<Pose>, usize), Failed> {
        let start = Pose::new(Rotation3::identity(), Vector3::zeros());
        let mesh = landmark_mesh(shape, &self.rig.left, &start)?;
        let camera = self.rig.left;
        let image = TrainingImage { image: self.frames[0].clone(), camera, camera_from_object: start };
        let model = train(&mesh, &[image], &TrainOptions::default())?;
        let aligner = Box::new(InverseCompositional::default());
        let mut tracker = Tracker::new(model, camera, Box::new(CpuBackend::new()), aligner)?;
        tracker.start_at(start);
        let (mut poses, mut tracked) = (Vec::new(), 0);
        for frame in &self.frames {
            let result = tracker.track(frame)?;
            tracked += usize::from(result.status == Status::Tracking);
            poses.push(result.estimate.camera_from_object);
        }
        Ok((poses, tracked))
    }

    /// Median error of the motion since frame 0, mm and degrees, against the reference of both cameras; the translations of
    /// the poses are multiplied by `scale`.
    fn judge(&self, what: &str, poses: &[Pose], scale: f64) -> [f64; 2] {
        let scaled = |p: &Pose| Pose::from_quaternion(p.quaternion(), p.translation() * scale);
        let mut found = Vec::new();
        for (name, reference) in &self.references {
            let first = &reference[&self.ids[0]];
            let errors = |k: usize| {
                let estimate = (&scaled(&poses[0]), &scaled(&poses[k]));
                motion_error(estimate, (first, &reference[&self.ids[k]]), &self.centre)
            };
            let (t, r): (Vec<f64>, Vec<f64>) = (1..poses.len()).map(errors).unzip();
            let (tm, rm) = (median(&t), median(&r));
            let (t95, r95) = (percentile(&t, 95.0), percentile(&r, 95.0));
            figure(&format!(
                "{what}, against {name}: median {tm:.3?} mm {rm:.3?} deg, 95 % {t95:.3?} mm {r95:.3?} deg"
            ));
            found.push([tm.unwrap_or(f64::INFINITY), rm.unwrap_or(f64::INFINITY)]);
        }
        found[0]
    }

    /// Landmarks found again in later frames of the left camera, near where the track says, and refined with the poses of
    /// these frames. The prior of the stereo pair keeps their size. Those not found again in every frame are left out.
    fn refined(&self, points: &[Prior], poses: &[Pose]) -> Result<Vec<Point3<f64>>, Failed> {
        let left = self.rig.left;
        let first: Vec<Point2<f64>> =
            points.iter().map(|p| left.project(&p.position).unwrap_or(Point2::origin())).collect();
        let mut seen: Vec<Vec<Option<Point2<f64>>>> = vec![first.iter().map(|p| Some(*p)).collect()];
        for k in MORE_FRAMES {
            let moved = StereoRig::new(left, left, poses[k])?;
            let again = |(point, at): (&Prior, &Point2<f64>)| {
                let z = point.position.z;
                corners::partner(&moved, [&self.frames[0], &self.frames[k]], at, [z - 0.03, z + 0.03])
            };
            seen.push(points.iter().zip(&first).map(again).collect());
        }
        let kept: Vec<usize> = (0..points.len()).filter(|&i| seen.iter().all(|s| s[i].is_some())).collect();
        let sightings = [0].iter().chain(&MORE_FRAMES).zip(&seen).map(|(&k, pixels)| Sighting {
            camera: left,
            camera_from_object: poses[k],
            marks: kept.iter().filter_map(|&i| Some(Mark::new(pixels[i]?, 0.3))).collect(),
        });
        let sightings: Vec<Sighting> = sightings.collect();
        let priors: Vec<Prior> = kept.iter().map(|&i| points[i]).collect();
        let bundle = bundle::refine(&priors, &sightings)?;
        let moved: Vec<f64> =
            bundle.points.iter().zip(&priors).map(|(a, b)| (a.position - b.position).norm() * 1e3).collect();
        figure(&format!(
            "{} of {} landmarks seen again; moved by {:.2?} mm",
            kept.len(),
            points.len(),
            median(&moved)
        ));
        // Back to the frame of the left camera at frame 0.
        Ok(bundle.points.iter().map(|p| bundle.poses[0].transform_point(&p.position)).collect())
    }
}

/// Landmarks by stereo in the first pair, a model of that one frame, 121 frames of the left camera.
///
/// The goal of 0.5 mm is not reached in the scale of the stereo pair (2.4 mm as clicked, 2.2 mm refined over seven frames);
/// the limit here only guards against worse. Most of it is the scale: in that of the reference 1.1 mm are left, and 0.3 mm
/// against the reference of the left camera alone. The scale is for telling the parts apart, no model is trained with it.
/// Matches of the whole images do not mend the calibration (`docs/maths.md`, section 12).
fn teabox_stereo_landmarks(folder: &Path) -> Result<(), Failed> {
    let folder = folder.join("teabox_stereo");
    let dataset = Dataset::open(&folder)?;
    let (left, right) = (dataset.scene(1)?, dataset.scene(2)?);
    let read = |scene: &Scene, k: usize| {
        let frame = &scene.frames[k];
        gray::read_sized(&frame.image, frame.camera.width, frame.camera.height)
    };
    let frames = (0..left.frames.len()).map(|k| read(&left, k)).collect::<Result<Vec<_>, _>>()?;
    let stereo = folder.join("stereo.json");
    let rig = read_stereo(&stereo)?.rig;
    let mut clicks = clicks(&dataset, [&frames[0], &read(&right, 0)?], &stereo)?;
    let before = clicks.len();
    clicks.retain(|c| rig.epipolar_px(c).is_some_and(|d| d < 2.0));
    let points = rig.triangulate_all(&clicks, &ClickOptions::default())?;
    figure(&format!("{} of {before} within 2 px of the epipolar line", clicks.len()));
    let points: Vec<Prior> =
        points.iter().map(|p| Prior { position: p.position, covariance: p.covariance }).collect();
    let shape: Vec<Point3<f64>> = points.iter().map(|p| p.position).collect();
    let (mesh, joint) = (dataset.mesh(1)?, dataset.poses(1, 1, &PoseSource::Reference)?);
    let mono = PoseSource::File(folder.join("test/000001/scene_ref_mono.json"));
    let scale = scale_of_reference(&mesh, &joint[&0], &shape);
    figure(&format!("the reference box is {scale:.4} times as far away as the stereo pair says"));
    let track = Track {
        frames,
        ids: left.frames.iter().map(|f| f.id).collect(),
        rig,
        centre: EvalObject::new(&mesh)?.centre(),
        references: [("both cameras", joint), ("the left camera", dataset.poses(1, 1, &mono)?)],
    };
    let (poses, tracked) = track.follow(&shape)?;
    let [t, r] = track.judge("clicked", &poses, 1.0);
    track.judge("clicked, in the scale of the reference", &poses, scale);
    let (again, _) = track.follow(&track.refined(&points, &poses)?)?;
    track.judge("refined", &again, 1.0);
    track.judge("refined, in the scale of the reference", &again, scale);
    check(tracked == 121, format!("{tracked} of 121 tracked"))?;
    check(t <= STEREO_MM && r <= 0.3, format!("median {t} mm, {r} deg"))
}
