use nalgebra::{Point2, UnitQuaternion, Vector3};

use super::super::object::{Patch, relief, textured_box};
use super::*;
use crate::geometry::{Distortion, TriangleMesh};
use crate::imaging::sample::bilinear;

fn camera() -> Camera {
    Camera::pinhole(800.0, 800.0, 319.5, 239.5, 640, 480)
}

fn small_camera() -> Camera {
    Camera::pinhole(100.0, 100.0, 39.5, 29.5, 80, 60)
}

fn pose(x: f64, y: f64, z: f64, rotation: [f64; 3]) -> Pose {
    Pose::from_quaternion(UnitQuaternion::from_scaled_axis(Vector3::from(rotation)), Vector3::new(x, y, z))
}

/// Rectangles of one grey value each that face the camera: corners (x0, y0, z left) to (x1, y1, z right).
fn cards(cards: &[([f64; 3], [f64; 3], u8)]) -> TexturedMesh {
    let mut object =
        TexturedMesh { mesh: TriangleMesh::default(), patches: Vec::new(), textures: Vec::new() };
    for (k, (from, to, grey)) in (0_u32..).zip(cards) {
        let [[x0, y0, z0], [x1, y1, z1]] = [*from, *to];
        object.mesh.vertices.extend([
            Point3::new(x0, y0, z0),
            Point3::new(x0, y1, z0),
            Point3::new(x1, y1, z1),
            Point3::new(x1, y0, z1),
        ]);
        object.mesh.triangles.extend([[4 * k, 4 * k + 1, 4 * k + 2], [4 * k, 4 * k + 2, 4 * k + 3]]);
        object.patches.extend([Patch { texture: k as usize, corners: [Point2::origin(); 3] }; 2]);
        object.textures.push(Texture::new(2, vec![*grey; 4]));
    }
    object
}

/// Median difference of the grey values at which two views show the same surface points.
fn median_difference(renderer: &Renderer, views: [(&GrayImage, &Pose); 2]) -> f64 {
    let mesh = &renderer.object().mesh;
    let mut differences = Vec::new();
    for t in 0..mesh.triangles.len() {
        let facing = views.iter().all(|(_, pose)| {
            let at = pose.transform_point(&mesh.corners(t)[0]).coords;
            pose.rotate(&mesh.normal(t)).dot(&at) < 0.0
        });
        for (a, b) in (0..100).map(|k| (f64::from(k % 10) / 10.0, f64::from(k / 10) / 10.0)) {
            if facing && a + b < 0.95 {
                let [p, q, r] = mesh.corners(t);
                let point = p + (q - p) * (a + 0.02) + (r - p) * (b + 0.02);
                let grey = |(image, pose): (&GrayImage, &Pose)| {
                    let pixel = renderer.camera().project(&pose.transform_point(&point)).expect("in front");
                    bilinear(image, pixel.x, pixel.y).expect("inside")
                };
                differences.push((grey(views[0]) - grey(views[1])).abs());
            }
        }
    }
    assert!(differences.len() > 300, "{} points are seen in both views", differences.len());
    differences.sort_by(f64::total_cmp);
    differences[differences.len() / 2]
}

#[test]
fn surface_points_keep_their_grey_value() {
    for object in [relief(1), textured_box(1)] {
        let renderer = Renderer::new(object, camera()).expect("a scene");
        let a = pose(0.01, 0.0, 0.6, [0.45, 0.5, 0.1]);
        let b = pose(-0.02, 0.015, 0.55, [0.3, 0.4, -0.1]);
        let (first, second) = (renderer.render(&a), renderer.render(&b));
        let right = median_difference(&renderer, [(&first, &a), (&second, &b)]);
        assert!(right < 1.5, "median difference {right} grey levels");
        // The measure must notice a pose that is wrong by 2 mm.
        let wrong = pose(-0.018, 0.015, 0.55, [0.3, 0.4, -0.1]);
        let control = median_difference(&renderer, [(&first, &a), (&second, &wrong)]);
        assert!(control > 2.5 * right, "2 mm off gives {control}, the true pose {right}");
    }
}

#[test]
fn a_card_covers_exactly_its_projection() {
    let renderer = Renderer::new(cards(&[([-0.111, -0.052, 0.5], [0.073, 0.084, 0.5], 200)]), small_camera())
        .and_then(|r| r.with_supersampling(8))
        .expect("a scene");
    let coverage = renderer.coverage(&Pose::identity());
    let sum = |f: &dyn Fn(f64, f64) -> f64| -> f64 {
        coverage.iter().enumerate().map(|(k, c)| c * f((k % 80) as f64, (k / 80) as f64)).sum()
    };
    let area = sum(&|_, _| 1.0);
    let expected = (0.184 * 200.0) * (0.136 * 200.0);
    assert!((area - expected).abs() < 0.01 * expected, "{area} instead of {expected} px");
    let middle = (sum(&|u, _| u) / area, sum(&|_, v| v) / area);
    let expected = (39.5 - 0.019 * 200.0, 29.5 + 0.016 * 200.0);
    let off = (middle.0 - expected.0).abs().max((middle.1 - expected.1).abs());
    assert!(off < 0.07, "centre {middle:?} instead of {expected:?}");
}

#[test]
fn the_nearest_surface_is_seen_whatever_the_order() {
    let near = ([-0.05, -0.05, 0.5], [0.05, 0.05, 0.5], 200);
    let far = ([-0.2, -0.2, 0.8], [0.2, 0.2, 0.8], 60);
    for order in [[near, far], [far, near]] {
        let image = Renderer::new(cards(&order), small_camera()).expect("a scene").render(&Pose::identity());
        assert_eq!(image.get_pixel(39, 29)[0], 200, "the near card in the middle");
        assert_eq!(image.get_pixel(20, 29)[0], 60, "the far card beside it");
        assert_eq!(image.get_pixel(1, 29)[0], 128, "the background outside");
    }
}

#[test]
fn crossing_surfaces_hide_each_other_where_they_cross() {
    let rising = ([-0.1, -0.1, 0.4], [0.1, 0.1, 0.6], 200);
    let falling = ([-0.1, -0.1, 0.6], [0.1, 0.1, 0.4], 60);
    let image =
        Renderer::new(cards(&[rising, falling]), small_camera()).expect("a scene").render(&Pose::identity());
    assert_eq!(image.get_pixel(34, 29)[0], 200, "the rising card is nearer on the left");
    assert_eq!(image.get_pixel(45, 29)[0], 60, "the falling one on the right");
}

#[test]
fn backs_and_what_is_behind_the_camera_are_not_seen() {
    let renderer = Renderer::new(relief(1), small_camera()).expect("a scene");
    let covered = |pose: &Pose| renderer.coverage(pose).iter().sum::<f64>();
    assert!(covered(&pose(0.0, 0.0, 0.6, [0.0; 3])) > 500.0, "the front");
    assert!(covered(&pose(0.0, 0.0, 0.6, [0.0, std::f64::consts::PI, 0.0])) < 1e-9, "the back");
    assert!(covered(&pose(0.0, 0.0, -0.6, [0.0; 3])) < 1e-9, "behind the camera");
}

#[test]
fn neighbours_leave_no_gaps() {
    let renderer = Renderer::new(relief(1), camera()).expect("a scene");
    for rotation in [[0.0, 0.0, 0.3], [0.2, -0.3, 0.1]] {
        let coverage = renderer.coverage(&pose(0.0, 0.0, 0.6, rotation));
        for v in 200..280 {
            let row = &coverage[v * 640 + 240..v * 640 + 400];
            assert!(row.iter().all(|c| (c - 1.0).abs() < 1e-9), "row {v} has a gap");
        }
    }
}

#[test]
fn noise_has_the_wanted_deviation_and_repeats() {
    let renderer = Renderer::new(relief(1), camera()).expect("a scene").with_clutter(1, 1);
    let clean = View { pose: pose(0.0, 0.0, 0.6, [0.0; 3]), ..View::default() };
    let noisy =
        |sigma, frame| renderer.render_view(&View { noise: Some(Noise { sigma, seed: 4, frame }), ..clean });
    let reference = renderer.render_view(&clean);
    for sigma in [1.0, 2.0, 5.0] {
        let differences: Vec<f64> = noisy(sigma, 0)
            .iter()
            .zip(reference.iter())
            .map(|(a, b)| f64::from(*a) - f64::from(*b))
            .collect();
        let n = differences.len() as f64;
        let variance = differences.iter().map(|d| d * d).sum::<f64>() / n;
        // Rounding adds 1/12, and another 1/12 where the noiseless value is not whole.
        let (least, most) = (sigma * sigma + 1.0 / 12.0, sigma * sigma + 1.0 / 6.0);
        assert!(variance > 0.98 * least && variance < 1.02 * most, "variance {variance} for sigma {sigma}");
    }
    assert_eq!(noisy(2.0, 7), noisy(2.0, 7), "the same frame twice");
    assert_ne!(noisy(2.0, 7), noisy(2.0, 8), "another frame");
}

#[test]
fn the_occluder_changes_the_wanted_share_of_the_object() {
    let renderer = Renderer::new(textured_box(1), camera()).expect("a scene").with_clutter(1, 1);
    let free = View { pose: pose(0.0, 0.0, 0.5, [0.4, 0.6, 0.0]), ..View::default() };
    let coverage = renderer.coverage(&free.pose);
    let before = renderer.render_view(&free);
    for (fraction, angle) in [(0.2, 0.4), (0.4, 3.0), (0.6, 5.0)] {
        let after = renderer.render_view(&View { occluder: Some(Occluder { fraction, angle }), ..free });
        let changed = before.iter().zip(after.iter()).zip(&coverage).filter(|((a, b), _)| a != b);
        let share = changed.map(|(_, c)| c).sum::<f64>() / coverage.iter().sum::<f64>();
        // Here and there clutter and object have the same grey value.
        assert!((share - fraction).abs() < 0.03, "{share} instead of {fraction} hidden");
    }
}

#[test]
fn wrong_cameras_objects_and_densities_are_refused() {
    let lens = Camera { distortion: Distortion { k1: 0.1, ..Distortion::default() }, ..camera() };
    assert!(Renderer::new(relief(1), lens).is_err(), "lens distortion");
    let mut object = relief(1);
    object.patches.pop();
    assert!(Renderer::new(object, camera()).is_err(), "a triangle without a patch");
    let renderer = Renderer::new(relief(1), camera()).expect("a scene");
    assert!(renderer.with_supersampling(0).is_err(), "no samples");
}
