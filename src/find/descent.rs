//! Levenberg-Marquardt on the normalised gradient with the mean of the gradients of template and image (efficient
//! second-order minimisation), for one hypothesis on one level.

use nalgebra::{Matrix6, Point3, Vector3, Vector6};

use super::map::Map;
use super::points::SurfacePoint;
use crate::geometry::{Camera, Pose};

/// Steps that move the object by less than this end a descent, pixels of the level.
const STOP_PX: f64 = 0.05;
const FIRST_DAMPING: f64 = 1e-2;

/// How one descent is done.
#[derive(Debug, Clone, Copy)]
pub(super) struct Settings {
    pub(super) iterations: usize,
    /// Scale of Geman-McClure's weights; infinite is least squares.
    pub(super) scale: f32,
}

/// Sums over all points at a pose.
#[derive(Debug, Clone)]
struct Sums {
    hessian: Matrix6<f64>,
    gradient: Vector6<f64>,
    cost: f64,
    /// sum t.F / sqrt(sum |t|^2).
    agreement: f64,
}

/// Where a descent ended.
#[derive(Debug, Clone)]
pub(super) struct Ended {
    pub(super) pose: Pose,
    /// z = sum t.F / sqrt(sum |t|^2) over the points given.
    pub(super) agreement: f64,
}

/// Descends from a pose; `centre` is the object's centre of rotation.
pub(super) fn descend(
    points: &[SurfacePoint],
    map: &Map,
    camera: &Camera,
    start: &Pose,
    centre: &Point3<f64>,
    settings: Settings,
) -> Ended {
    let mut pose = *start;
    let mut sums = sum(points, map, camera, &pose, centre, settings.scale);
    let mut damping = FIRST_DAMPING;
    for _ in 0..settings.iterations {
        let mut damped = sums.hessian;
        for k in 0..6 {
            damped[(k, k)] *= 1.0 + damping;
        }
        let Some(factor) = damped.cholesky() else { break };
        let step = -factor.solve(&sums.gradient);
        if !step.iter().all(|d| d.is_finite()) {
            break;
        }
        let middle = pose.transform_point(centre);
        let turn: Vector3<f64> = step.fixed_rows::<3>(3).into();
        let shift: Vector3<f64> = step.fixed_rows::<3>(0).into();
        let next = Pose::about(turn, shift, &middle).compose(&pose);
        let tried = sum(points, map, camera, &next, centre, settings.scale);
        let moved = (shift.norm() + turn.norm() * EXTENT) * camera.fx / middle.z;
        if tried.cost < sums.cost {
            (pose, sums) = (next, tried);
            damping = (damping / 10.0).max(1e-6);
        } else {
            damping *= 10.0;
        }
        if moved < STOP_PX {
            break;
        }
    }
    Ended { pose, agreement: sums.agreement }
}

/// Lever of a rotation in the stop rule, metres.
const EXTENT: f64 = 0.1;

#[expect(clippy::cast_possible_truncation, reason = "per-point work is f32")]
fn sum(
    points: &[SurfacePoint],
    map: &Map,
    camera: &Camera,
    pose: &Pose,
    centre: &Point3<f64>,
    scale: f32,
) -> Sums {
    let r = pose.rotation().map(|x| x as f32);
    let t = pose.translation().map(|x| x as f32);
    let c = pose.transform_point(centre).coords.map(|x| x as f32);
    let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(|x| x as f32);
    let inverse_square = 1.0 / (scale * scale);
    let mut hessian = [[0.0_f32; 6]; 6];
    let mut gradient = [0.0_f32; 6];
    let (mut cost, mut product, mut energy) = (0.0_f32, 0.0_f32, 0.0_f32);
    for p in points {
        let x = Vector3::from(p.position);
        let at = r * x + t;
        let [tu, tv] = p.value;
        energy += tu * tu + tv * tv;
        if at.z <= 0.0 {
            continue;
        }
        let inverse = 1.0 / at.z;
        let (u, v) = (at.x * inverse, at.y * inverse);
        let Some(f) = map.sample(fx * u + cx, fy * v + cy) else {
            // Outside the image nothing is known: the residual is the template itself.
            let square = tu * tu + tv * tv;
            cost += square / (1.0 + square * inverse_square);
            continue;
        };
        let (ru, rv) = (f[0] - tu, f[1] - tv);
        product += tu * f[0] + tv * f[1];
        let square = ru * ru + rv * rv;
        let robust = 1.0 / (1.0 + square * inverse_square);
        cost += square * robust;
        let weight = robust * robust;
        // Mean slope of image and template, or the image's where the template has none.
        let mean = |k: usize| if p.slope[k].is_nan() { f[2 + k] } else { 0.5 * (f[2 + k] + p.slope[k]) };
        let s = [mean(0), mean(1), mean(2), mean(3)];
        let arm = at - c;
        let mut rows = [[0.0_f32; 6]; 2];
        for (row, [a, b]) in rows.iter_mut().zip([[s[0], s[1]], [s[2], s[3]]]) {
            let (a, b) = (a * fx * inverse, b * fy * inverse);
            let d = [a, b, -(a * u + b * v)];
            *row = [
                d[0],
                d[1],
                d[2],
                arm.y * d[2] - arm.z * d[1],
                arm.z * d[0] - arm.x * d[2],
                arm.x * d[1] - arm.y * d[0],
            ];
        }
        for i in 0..6 {
            let (a, b) = (rows[0][i] * weight, rows[1][i] * weight);
            gradient[i] += a * ru + b * rv;
            for j in 0..6 {
                hessian[i][j] += a * rows[0][j] + b * rows[1][j];
            }
        }
    }
    Sums {
        hessian: Matrix6::from_fn(|i, j| f64::from(hessian[i][j])),
        gradient: Vector6::from_fn(|i, _| f64::from(gradient[i])),
        cost: f64::from(cost),
        agreement: if energy > 0.0 { f64::from(product / energy.sqrt()) } else { 0.0 },
    }
}
