//! Do the analytic columns equal central differences, do the moments stand for the pixels, and does the step go the
//! right way? All over the pixels of a model of the relief, trained on one frontal view.

#[path = "jacobian/pixels.rs"]
mod pixels;
mod support;

use aam6d::align::{Grouping, Options, PoseEstimate};
use aam6d::geometry::Pose;
use aam6d::geometry::warp::apply;
use aam6d::imaging::GrayImage;
use aam6d::imaging::sample::bilinear;
use nalgebra::{DMatrix, Matrix2x6, Matrix6, RowVector6, SMatrix, SVector, Vector6};
use pixels::{Pixel, SETUP, arbitrary, differences, frontal, pixels, turned};
use support::tracking::{Disturbance, cpu, distance_px, say, start, tracker_with};

/// Largest error of a column of D, of its largest value over all pixels; rounding leaves about 1e-9.
const COLUMN_ERROR: f64 = 1e-8;
/// What is left of an error that one step should remove; differences and f32 gradients leave some 1e-8.
const NOTHING_LEFT: f64 = 1e-6;
/// A small error, pixels, and the share of it that one step may leave; a constant J leaves more than all of it.
const SMALL_PX: f64 = 0.2;
const LEFT: f64 = 0.25;
/// Largest difference between moments and pixels, normalised.
const MOMENTS: f64 = 0.02;

/// Largest error of every column, as a share of its largest value.
fn column_errors(pairs: &[(Matrix2x6<f64>, Matrix2x6<f64>)]) -> [f64; 6] {
    std::array::from_fn(|axis| {
        let error = |(a, b): &(Matrix2x6<f64>, Matrix2x6<f64>)| (a.column(axis) - b.column(axis)).norm();
        let most = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
        most(&mut pairs.iter().map(error)) / most(&mut pairs.iter().map(|(a, _)| a.column(axis).norm()))
    })
}

fn check_columns(what: &str, errors: [f64; 6]) {
    let text = format!("{what} is off by {}", errors.map(|e| format!("{e:.1e}")).join(" "));
    say(format_args!("{text}"));
    assert!(errors.iter().all(|e| *e < COLUMN_ERROR), "{text}");
}

#[test]
fn columns_equal_central_differences() {
    for (name, pose) in [("reference", frontal()), ("arbitrary", arbitrary())] {
        let pixels = pixels(&pose, 23);
        let d: Vec<_> =
            pixels.iter().map(|p| (p.d(&pose), differences(&pose, |pose| p.image(pose)))).collect();
        let errors = column_errors(&d);
        check_columns(&format!("{name}: dW/d(eps)"), errors);
        // The motion of the template pixel: through the warp there, and back at the unmoved pose.
        let motion: Vec<_> = pixels
            .iter()
            .map(|p| {
                let back = p.warp(&pose).try_inverse().expect("not edge-on");
                let seen = |moved: &Pose| apply(&back, &p.image(moved)).expect("in front");
                (p.motion(&pose), differences(&pose, seen))
            })
            .collect();
        let errors = column_errors(&motion);
        check_columns(&format!("{name}: A^-1 D"), errors);
    }
}

#[test]
fn at_the_reference_the_jacobian_is_the_constant_one() {
    let pose = frontal();
    for p in pixels(&pose, 23) {
        let difference = (p.motion(&pose) - p.d(&pose)).abs().max();
        assert!(difference <= 1e-9 * p.d(&pose).abs().max(), "at {}: {difference:e}", p.position);
    }
}

/// J^T Q r and J^T Q J of the pose with gain and bias eliminated, pixel by pixel.
fn normal_equations(pose: &Pose, image: &GrayImage) -> (Matrix6<f64>, Vector6<f64>) {
    let pixels = pixels(pose, 1);
    let weight: f64 = pixels.iter().map(|p| p.weight).sum();
    let mean = pixels.iter().map(|p| p.weight * p.intensity).sum::<f64>() / weight;
    let residual = |p: &Pixel<'_>| {
        let w = p.image(pose);
        p.sampled(pose) - bilinear(image, w.x, w.y).expect("inside the image")
    };
    let (mut h, mut g) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
    for p in &pixels {
        let row = p.row(&p.motion(pose));
        let mut j = SVector::<f64, 8>::zeros();
        j.fixed_rows_mut::<6>(0).copy_from(&row.transpose());
        (j[6], j[7]) = (p.intensity - mean, 1.0);
        h += p.weight * j * j.transpose();
        g += p.weight * residual(p) * j;
    }
    let inverse = h.fixed_view::<2, 2>(6, 6).into_owned().try_inverse().expect("texture");
    let gain = 1.0 - (inverse * g.fixed_rows::<2>(6))[0];
    let cross = h.fixed_view::<6, 2>(0, 6) * gain;
    let pose_block = h.fixed_view::<6, 6>(0, 0) * gain * gain;
    (
        pose_block - cross * inverse * cross.transpose(),
        g.fixed_rows::<6>(0) * gain - cross * inverse * g.fixed_rows::<2>(6),
    )
}

/// Undamped steps from a pose, without triangle weights.
fn steps(pose: &Pose, image: &GrayImage, count: usize) -> PoseEstimate {
    let options = Options {
        max_iterations: count,
        // Every step is taken, whatever becomes of the error.
        stop_px: vec![1e9],
        damping: 0.0,
        robust: false,
        full_size_grouping: Grouping::FaceAndView,
    };
    let mut tracker = tracker_with(&SETUP.model, SETUP.camera, cpu(), options);
    tracker.align(image, &[start(&SETUP.model, *pose)]).expect("a good start").remove(0)
}

/// The increment between a pose and the pose one step later.
fn increment(before: &Pose, after: &Pose) -> Vector6<f64> {
    let c = SETUP.model.shape.centre.coords;
    let moved = after.inverse().compose(before);
    let mut d = moved.to_params();
    let shift = moved.translation() - c + moved.rotation() * c;
    d.fixed_rows_mut::<3>(0).copy_from(&shift);
    d
}

/// Poses at which the step is looked at, and poses 2 px off.
fn disturbed() -> Vec<(&'static str, Pose, Pose)> {
    let points = &SETUP.renderer.object().mesh.vertices;
    let mut disturbance = Disturbance::new(3, SETUP.camera, points, SETUP.model.shape.centre);
    [("reference", frontal()), ("tilt", turned([0.0, 30.0, 0.0])), ("roll", turned([0.0, 0.0, 90.0]))]
        .map(|(name, pose)| (name, pose, disturbance.apply(&pose, 2.0)))
        .to_vec()
}

#[test]
fn moments_stand_for_the_pixels() {
    for (name, truth, pose) in disturbed() {
        let image = SETUP.renderer.render(&truth);
        let (h, g) = normal_equations(&pose, &image);
        let at = steps(&pose, &image, 0);
        let found = at.hessian;
        let step = increment(&pose, &steps(&pose, &image, 1).camera_from_object);
        let scale = h.diagonal().map(|d| 1.0 / d.sqrt());
        let scale_h = Matrix6::from_diagonal(&scale);
        let h_error = (scale_h * (found - h) * scale_h).abs().max();
        let g_error = scale.component_mul(&(-found * step - g)).norm() / scale.component_mul(&g).norm();
        say(format_args!("{name}: JtQJ {h_error:.1e}, JtQr {g_error:.1e}"));
        assert!(h_error < MOMENTS && g_error < MOMENTS, "{name}: JtQJ {h_error:e}, JtQr {g_error:e}");
    }
}

#[test]
fn one_step_lowers_the_error_and_the_opposite_step_raises_it() {
    for (name, truth, pose) in disturbed() {
        let image = SETUP.renderer.render(&truth);
        let next = steps(&pose, &image, 1).camera_from_object;
        let step = increment(&pose, &next);
        let opposite = pose.compose(&Pose::increment(&step, &SETUP.model.shape.centre));
        let all = [truth, pose, next, opposite].map(|p| steps(&p, &image, 0).rms);
        let [floor, before, after, wrong] = all;
        let text = format!("{before:.2} to {after:.2}, the other way {wrong:.2}, at the truth {floor:.2}");
        say(format_args!("{name}: rms {text}"));
        assert!(floor < after && after < before && before < wrong, "{name}: rms {text}");
    }
}

/// Where the error is small, one step of the method removes nearly all of it, however the object is turned. What is
/// left beyond the linear part is the bias of sampling a turned image.
#[test]
fn one_step_removes_a_small_error() {
    let points = &SETUP.renderer.object().mesh.vertices;
    for degrees in [[0.0; 3], [0.0, 30.0, 0.0], [30.0, 0.0, 0.0], [0.0, 0.0, 90.0]] {
        let (truth, mut worst) = (turned(degrees), 0.0);
        let image = SETUP.renderer.render(&truth);
        let mut disturbance = Disturbance::new(3, SETUP.camera, points, SETUP.model.shape.centre);
        for _ in 0..6 {
            let next = steps(&disturbance.apply(&truth, SMALL_PX), &image, 1).camera_from_object;
            worst = f64::max(worst, distance_px(&SETUP.camera, points, &truth, &next));
        }
        say(format_args!("{degrees:?}: {SMALL_PX} px to at most {worst:.3} px"));
        assert!(worst < LEFT * SMALL_PX, "{degrees:?}: {SMALL_PX} px to {worst} px");
    }
}

/// Largest magnitude of the eigenvalues.
fn spectral_radius(m: &Matrix6<f64>) -> f64 {
    m.complex_eigenvalues().iter().map(|e| e.norm()).fold(0.0, f64::max)
}

/// M = (J^T Q J)^-1 J^T Q Jp of a method's rows J, where Jp are central differences of the template's motion.
fn response(pose: &Pose, row: impl Fn(&Pixel<'_>) -> RowVector6<f64>) -> Matrix6<f64> {
    let pixels = pixels(pose, 7);
    let (mut jj, mut jp) = (Matrix6::zeros(), Matrix6::zeros());
    for p in &pixels {
        let back = p.warp(pose).try_inverse().expect("not edge-on");
        let truth = differences(pose, |moved| apply(&back, &p.image(moved)).expect("in front"));
        let j = row(p);
        jj += p.weight * j.transpose() * j;
        jp += p.weight * j.transpose() * p.row(&truth);
    }
    let solve = DMatrix::from_iterator(6, 6, jj.iter().copied()).cholesky().expect("texture");
    Matrix6::from_iterator(solve.inverse().iter().copied()) * jp
}

#[test]
fn the_constant_jacobian_does_not_converge_where_the_method_does() {
    let constant = |p: &Pixel<'_>| p.row(&p.d(&frontal()));
    for degrees in [[0.0, 30.0, 0.0], [30.0, 0.0, 0.0], [0.0, 0.0, 90.0], [0.0, 0.0, 0.0]] {
        let pose = turned(degrees);
        let own = spectral_radius(&(Matrix6::identity() - response(&pose, |p| p.row(&p.motion(&pose)))));
        let right = spectral_radius(&(Matrix6::identity() - response(&pose, constant)));
        // Composed on the left the step acts in the axes of the reference view.
        let back = frontal().rotation().transpose() * pose.rotation();
        let mut turn = Matrix6::zeros();
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&back.transpose());
        turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&back.transpose());
        let left = spectral_radius(&(Matrix6::identity() - turn * response(&pose, constant)));
        say(format_args!("{degrees:?}: own {own:.1e}, constant J right {right:.2}, left {left:.2}"));
        assert!(own < NOTHING_LEFT, "{degrees:?}: {own:e}");
        match degrees {
            [0.0, 30.0, 0.0] => assert!(right > 1.0, "right order, tilt about y: {right}"),
            [0.0, 0.0, 90.0] => assert!(left > 1.3 && right < 0.1, "roll: left {left}, right {right}"),
            [0.0, 0.0, 0.0] => assert!(right < NOTHING_LEFT, "at the reference: {right:e}"),
            _ => {}
        }
    }
}
