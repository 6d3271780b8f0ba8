//! The model of the relief, its pixels with all that their rows of J are made of, and central differences.

use std::sync::LazyLock;

use aam6d::backend::TEMPLATE_BLUR;
use aam6d::geometry::raster::{facing, visible_shares};
use aam6d::geometry::warp::{apply, homography, increment_jacobian, warp_jacobian};
use aam6d::geometry::{Camera, Pose};
use aam6d::model::{ChartGeometry, Model};
use aam6d::simulate::{Renderer, SceneKind};
use aam6d::train::{TrainOptions, TrainingImage, train};
use nalgebra::{Matrix2, Matrix2x6, Matrix3, Point2, Point3, RowVector6, Vector3, Vector6};

/// Steps of the central differences: metres and radians.
const STEP: [f64; 6] = [1e-7, 1e-7, 1e-7, 1e-6, 1e-6, 1e-6];

pub(crate) struct Setup {
    pub(crate) renderer: Renderer,
    pub(crate) model: Model,
    pub(crate) camera: Camera,
}

/// One level, one frontal view, no noise.
pub(crate) static SETUP: LazyLock<Setup> = LazyLock::new(|| {
    let camera = SceneKind::Relief.camera();
    let renderer = Renderer::new(SceneKind::Relief.object(1), camera).expect("a pinhole").with_clutter(1, 1);
    let view = TrainingImage { image: renderer.render(&frontal()), camera, camera_from_object: frontal() };
    let options = TrainOptions { levels: 1, ..TrainOptions::default() };
    let model = train(&renderer.object().mesh, &[view], &options).expect("in view");
    Setup { renderer, model, camera }
});

pub(crate) fn frontal() -> Pose {
    Pose::from_params(&Vector6::new(0.004, -0.003, 0.56, 0.0, 0.0, 0.0))
}

/// The frontal pose after a rotation about the object's centre (rotation vector, degrees).
pub(crate) fn turned(degrees: [f64; 3]) -> Pose {
    let turn = Vector3::from(degrees).map(f64::to_radians);
    frontal().compose(&Pose::about(turn, Vector3::zeros(), &SETUP.model.shape.centre))
}

/// Anywhere: turned about all axes, moved, and nearer.
pub(crate) fn arbitrary() -> Pose {
    let turn = Vector3::new(0.3, -0.4, 0.9);
    frontal().compose(&Pose::about(turn, Vector3::new(0.012, -0.007, -0.03), &SETUP.model.shape.centre))
}

/// A pixel of the template with all that its row of J is made of.
pub(crate) struct Pixel<'a> {
    pub(crate) geometry: &'a ChartGeometry,
    pub(crate) position: Point2<f64>,
    /// On the object.
    pub(crate) point: Point3<f64>,
    pub(crate) gradient: [f64; 2],
    pub(crate) intensity: f64,
    /// Second differences of the intensity: uu, uv, vv.
    curvature: [f64; 3],
    /// Weight q times the visible share of the triangle.
    pub(crate) weight: f64,
}

/// Every `stride`-th pixel of the triangles that the method uses at a pose.
pub(crate) fn pixels(pose: &Pose, stride: usize) -> Vec<Pixel<'static>> {
    let (level, shape) = (&SETUP.model.levels[0], &SETUP.model.shape);
    let shares = visible_shares(&shape.mesh, &SETUP.camera.at_level(2), pose);
    let mut out = Vec::new();
    for (t, chart) in level.charts.iter().enumerate() {
        let Some(geometry) = &level.geometry[t] else { continue };
        if shares[t] < 0.5 || facing(&shape.mesh.corners(t), pose) < 0.06 {
            continue;
        }
        for p in chart.range().step_by(stride) {
            let [u, v] = level.pixels.position[p].map(f64::from);
            let x = geometry.object_from_chart * Vector3::new(u, v, 1.0);
            out.push(Pixel {
                geometry,
                position: Point2::new(u, v),
                point: Point3::from(x.xyz() / x.w),
                gradient: level.pixels.gradient[p].map(f64::from),
                intensity: level.pixels.intensity[p].into(),
                curvature: level.curvature[p].map(f64::from),
                weight: shares[t] * f64::from(level.pixels.weight[p]),
            });
        }
    }
    assert!(out.len() * stride > 20_000, "only {} pixels", out.len() * stride);
    out
}

impl Pixel<'_> {
    pub(crate) fn warp(&self, pose: &Pose) -> Matrix3<f64> {
        homography(&SETUP.camera, pose, &self.geometry.object_from_chart)
    }

    pub(crate) fn image(&self, pose: &Pose) -> Point2<f64> {
        apply(&self.warp(pose), &self.position).expect("in front")
    }

    pub(crate) fn d(&self, pose: &Pose) -> Matrix2x6<f64> {
        increment_jacobian(&SETUP.camera, pose, &self.point, &SETUP.model.shape.centre)
    }

    /// A^-1 D: motion in template pixels.
    pub(crate) fn motion(&self, pose: &Pose) -> Matrix2x6<f64> {
        let a = warp_jacobian(&self.warp(pose), &self.position);
        a.try_inverse().expect("not edge-on") * self.d(pose)
    }

    /// The intensity as sampling at a pose shows it, in the light of the template.
    pub(crate) fn sampled(&self, pose: &Pose) -> f64 {
        let [uu, uv, vv] = self.curvature;
        let inverse = warp_jacobian(&self.warp(pose), &self.position).try_inverse().expect("not edge-on");
        let second = inverse.transpose() * Matrix2::new(uu, uv, uv, vv) * inverse;
        let image = self.image(pose);
        let blur = |k: usize| {
            let f = image[k] - image[k].floor();
            (f * (1.0 - f) - TEMPLATE_BLUR) / 2.0 * second[(k, k)]
        };
        self.intensity + blur(0) + blur(1)
    }

    pub(crate) fn row(&self, motion: &Matrix2x6<f64>) -> RowVector6<f64> {
        motion.row(0) * self.gradient[0] + motion.row(1) * self.gradient[1]
    }
}

/// Central differences of `f` by the increment composed on the right of a pose.
pub(crate) fn differences(pose: &Pose, f: impl Fn(&Pose) -> Point2<f64>) -> Matrix2x6<f64> {
    let mut out = Matrix2x6::zeros();
    for (axis, h) in STEP.into_iter().enumerate() {
        let mut d = Vector6::zeros();
        d[axis] = h;
        let at = |d: &Vector6<f64>| f(&pose.compose(&Pose::increment(d, &SETUP.model.shape.centre)));
        out.set_column(axis, &((at(&d) - at(&-d)) / (2.0 * h)));
    }
    out
}
