//! Tests of [`super`] on sequences worked out by hand.

use nalgebra::{Point3, Rotation3};
use serde_json::{Value, json};

use super::*;
use crate::geometry::TriangleMesh;

/// A flat square of 100 mm about the origin: centre and object origin agree.
fn square() -> EvalObject {
    let at = |x: f64, y: f64| Point3::new(x * 0.05, y * 0.05, 0.0);
    let vertices = vec![at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)];
    EvalObject::new(&TriangleMesh { vertices, triangles: vec![[0, 1, 2], [0, 2, 3]] }).unwrap()
}

/// Pose at 0.5 m, off by x millimetres to the right and `deg` about the optical axis.
fn pose(x_mm: f64, deg: f64) -> Pose {
    let turn = Rotation3::new(Vector3::z() * deg.to_radians());
    Pose::new(turn, Vector3::new(x_mm / 1000.0, 0.0, 0.5))
}

fn estimate(frame: u32, x_mm: f64, deg: f64) -> Estimate {
    Estimate { frame, pose: pose(x_mm, deg), score: 1.0, time_s: None, iterations: None }
}

fn truth(frames: u32) -> BTreeMap<u32, Pose> {
    (0..frames).map(|k| (k, pose(0.0, 0.0))).collect()
}

fn near(value: Option<f64>, expected: f64) -> bool {
    value.is_some_and(|v| (v - expected).abs() < 1e-6)
}

#[test]
fn a_sequence_by_hand() {
    let camera = Camera::pinhole(500.0, 500.0, 320.0, 240.0, 640, 480);
    let cameras = (0..9).map(|k| (k, camera)).collect();
    let mut estimates =
        vec![estimate(0, 1.0, 0.0), estimate(1, -3.0, 0.0), estimate(2, 60.0, 0.0), estimate(3, 2.0, 1.0)];
    estimates[0].time_s = Some(0.010);
    estimates[2].time_s = Some(0.030);
    estimates[1].iterations = Some(7.0);
    estimates.push(Estimate { score: 0.0, ..estimate(4, 0.0, 0.0) });
    estimates.push(estimate(77, 0.0, 0.0));
    let e = evaluate(&estimates, &truth(6), &square(), &cameras).unwrap();
    assert_eq!(
        (e.frames, e.lost, e.missing, e.without_truth),
        (6, 3, 1, 1),
        "2 too far, 4 given up, 5 missing"
    );
    assert!(near(e.rms_t_mm, (14.0_f64 / 3.0).sqrt()), "1, 3, 2 mm: {:?}", e.rms_t_mm);
    assert!(near(e.rms_r_deg, (1.0_f64 / 3.0).sqrt()), "0, 0, 1 deg: {:?}", e.rms_r_deg);
    let x = e.translation_mm.x;
    assert!(near(x.avg, 2.0) && near(x.max, 3.0) && near(x.std, (2.0_f64 / 3.0).sqrt()), "{x:?}");
    assert!(near(e.translation_mm.y.max, 0.0), "nothing down: {:?}", e.translation_mm.y);
    assert!(near(e.rotation_deg.z.max, 1.0) && near(e.rotation_deg.x.max, 0.0), "{:?}", e.rotation_deg);
    // Frames 0 and 1 move all vertices by 1 and 3 mm, and at 0.5 m with f = 500 the corners by 1 and 3 px.
    // Turned by 1 degree, a corner at radius r goes 2 r sin(0.5 deg) further; r^2 = 50^2 + 50^2.
    let turned = |x: f64| (x * x + 4.0 * 5000.0 * 0.5_f64.to_radians().sin().powi(2)).sqrt();
    assert!(near(e.corner_px.median, turned(2.0)), "1, {}, 3 px: {:?}", turned(2.0), e.corner_px);
    assert!(near(e.corner_px.max, 3.0), "{:?}", e.corner_px);
    assert!(e.add_mm.median.is_some_and(|m| (2.0..2.3).contains(&m)), "{:?}", e.add_mm);
    // Motion since frame 0: off by -4 mm in frame 1, +1 mm and 1 degree in frame 3.
    assert!(e.relative.r_deg_median.is_some_and(|r| (r - 0.5).abs() < 1e-6), "0 and 1: {:?}", e.relative);
    // Only frames 0 and 1 follow each other tracked: the error changes by 4 mm.
    assert!(near(e.jitter.t_mm, 4.0 / 2.0_f64.sqrt()) && near(e.jitter.r_deg, 0.0), "{:?}", e.jitter);
    assert!(near(e.ms_per_frame.median, 20.0), "the lost frame's time counts: {:?}", e.ms_per_frame);
    assert!(near(e.iterations_mean, 7.0), "{:?}", e.iterations_mean);
}

#[test]
fn relative_motion_by_hand() {
    let estimates = [estimate(0, 1.0, 0.0), estimate(1, -3.0, 0.0), estimate(2, 7.0, 0.0)];
    let e = evaluate(&estimates, &truth(3), &square(), &BTreeMap::new()).unwrap();
    assert!(near(e.relative.t_mm_median, 5.0), "4 and 6 mm since frame 0: {:?}", e.relative);
    assert_eq!(e.corner_px, TypicalAndMax::default(), "no cameras, no pixels");
}

#[test]
fn a_frame_may_occur_several_times() {
    let estimates = [estimate(1, 3.0, 0.0), estimate(0, 1.0, 0.0), estimate(0, 2.0, 0.0)];
    let e = evaluate(&estimates, &truth(2), &square(), &BTreeMap::new()).unwrap();
    assert_eq!((e.frames, e.lost), (3, 0), "every estimate is judged");
    assert_eq!(e.jitter, Jitter::default(), "no single estimate of frame 0");
}

#[test]
fn nothing_tracked_is_null_not_invented() {
    let e = evaluate(&[], &truth(2), &square(), &BTreeMap::new()).unwrap();
    let none = json!({ "avg": null, "std": null, "max": null });
    let axes = json!({ "x": none, "y": none, "z": none });
    let expected = json!({
        "frames": 2, "lost": 2, "missing": 2, "without_truth": 0, "rms_t_mm": null, "rms_r_deg": null,
        "translation_mm": axes, "rotation_deg": axes,
        "add_mm": { "median": null, "p95": null },
        "corner_px": { "median": null, "p95": null, "max": null },
        "relative": { "t_mm_median": null, "r_deg_median": null },
        "jitter": { "t_mm": null, "r_deg": null },
        "ms_per_frame": { "median": null, "p95": null },
        "iterations_mean": null
    });
    assert_eq!(serde_json::to_value(&e).unwrap(), expected, "the JSON report");
    let again: Evaluation =
        serde_json::from_value::<Value>(expected).and_then(serde_json::from_value).unwrap();
    assert_eq!(again, e, "reads back");
}

#[test]
fn useless_input_is_refused() {
    assert!(evaluate(&[], &BTreeMap::new(), &square(), &BTreeMap::new()).is_err(), "no truth");
    let elsewhere = [estimate(9, 0.0, 0.0)];
    assert!(evaluate(&elsewhere, &truth(2), &square(), &BTreeMap::new()).is_err(), "no frame in common");
}

#[test]
fn the_table_has_units_and_dashes() {
    let estimates = [estimate(0, 1.0, 0.0), estimate(1, -3.0, 2.0)];
    let text = evaluate(&estimates, &truth(2), &square(), &BTreeMap::new()).unwrap().to_string();
    assert!(text.contains("translation x (right)        2.000     1.000     3.000 mm"), "{text}");
    assert!(text.contains("rotation about z             1.000     1.000     2.000 deg"), "{text}");
    assert!(text.contains("corners                 median - px"), "{text}");
    assert_eq!(text.lines().count(), 15, "{text}");
}
