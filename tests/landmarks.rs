//! Annotated training in the robot cell: how near the landmarks come to the truth. With `AAM6D_FIGURES=1` for seeds 1 to
//! `AAM6D_SEEDS` (3 unless given).

mod support;

use aam6d::dataset::Landmark;
use aam6d::geometry::rigid_fit::rigid_fit;
use aam6d::geometry::stereo::{ClickOptions, ClickPair, StereoPoint};
use aam6d::simulate::{Cell, CellOptions};
use aam6d::track::StereoPair;
use aam6d::track::annotated::prepare;
use aam6d::train::annotated::{AnnotatedImage, AnnotationOptions, pose};
use nalgebra::{Point3, Vector3};
use support::data::figure;

/// Triangulated landmarks in the frame of the left camera.
fn clicked(cell: &Cell) -> Vec<Landmark> {
    let clicks = cell.clicks();
    let points = cell.stereo().rig.triangulate_all(&clicks.pairs, &ClickOptions::default()).expect("points");
    let landmark = |(click, point): (&ClickPair, &StereoPoint)| Landmark {
        name: click.name.clone(),
        position: point.position,
        covariance: point.covariance,
    };
    clicks.pairs.iter().zip(&points).map(landmark).collect()
}

/// The annotated images of a sequence.
fn annotated(cell: &Cell, sequence: usize) -> Vec<AnnotatedImage> {
    let source = &cell.sequences()[sequence];
    let image = |(frame, landmarks)| AnnotatedImage {
        frame,
        image: source.image(frame as usize),
        camera: *source.camera(),
        landmarks,
    };
    cell.annotations(sequence, false).frames.into_iter().map(image).collect()
}

/// What is left after a rigid fit: distances (rms, mm), their part across the relief, and the scale.
#[derive(Debug)]
struct Off {
    all: f64,
    across: f64,
    scale: f64,
}

impl Off {
    fn new(points: &[Point3<f64>], exact: &[Point3<f64>]) -> Self {
        let count = points.len() as f64;
        let (fit, _) = rigid_fit(points, exact).expect("a fit");
        let centre = exact.iter().map(|p| p.coords).sum::<Vector3<f64>>() / count;
        let fitted: Vec<Point3<f64>> = points.iter().map(|p| fit.transform_point(p)).collect();
        let mean = |f: &dyn Fn(&Point3<f64>, &Point3<f64>) -> f64| {
            fitted.iter().zip(exact).map(|(p, q)| f(p, q)).sum::<f64>() / count
        };
        let scale = mean(&|p, q| (p.coords - centre).dot(&(q.coords - centre)))
            / mean(&|_, q| (q.coords - centre).norm_squared());
        let all = mean(&|p, q| (p - q).norm_squared()).sqrt() * 1e3;
        Self { all, across: mean(&|p, q| (p.z - q.z).powi(2)).sqrt() * 1e3, scale }
    }
}

/// A sequence with a wrong diagonal and a triangle of air in its Delaunay triangulation.
#[test]
fn the_images_place_the_landmarks() {
    let figures = std::env::var_os("AAM6D_FIGURES").is_some();
    let seeds = std::env::var("AAM6D_SEEDS").ok().and_then(|s| s.parse().ok()).unwrap_or(3);
    for seed in 1..=if figures { seeds } else { 1 } {
        let cell = Cell::new(CellOptions { seed, frames: 120, ..CellOptions::default() }).expect("a cell");
        let exact: Vec<Point3<f64>> = cell.landmarks().iter().map(|l| l.position).collect();
        let landmarks = clicked(&cell);
        for sequence in if figures { 0..2 } else { 1..2 } {
            let images = annotated(&cell, sequence);
            let options = AnnotationOptions::default();
            let before = pose(&landmarks, images.clone(), &options).expect("posed").mesh;
            let (rig, clicks) = (cell.stereo().rig, cell.clicks().pairs);
            let frontal = cell.frontal_images().expect("images");
            let pair = StereoPair::new(&rig, frontal, &clicks, options.sigma_px).expect("a pair");
            let after = prepare(&landmarks, Some(&pair), images, &options).expect("prepared");
            let clicks: Vec<Point3<f64>> = landmarks.iter().map(|l| l.position).collect();
            let [clicks, before, found] =
                [&clicks, &before.vertices, &after.mesh.vertices].map(|points| Off::new(points, &exact));
            figure(&format!(
                "seed {seed}, sequence {}: clicked {clicks:.5?}, by annotations {before:.5?}, by images {found:.5?}, {} \
                 triangles changed",
                sequence + 1,
                after.triangles_changed
            ));
            assert!(clicks.across > 0.7 && before.across > 0.1, "{clicks:?} {before:?}");
            assert!(found.across < 0.04 && found.all < 0.12, "{found:?}");
            assert!((found.scale - 1.0).abs() < 3e-4, "the pair says how large it is: {found:?}");
            assert!(after.triangles_changed > 0, "a triangle was wrong");
        }
    }
}
