//! The derivative of the residual by the pose, per triangle: from the template's gradient (inverse compositional) or
//! from the frame's (forward additive). `docs/maths.md`, "Moments" and "Forward additive".

use nalgebra::{DMatrix, Matrix2, Matrix2x3, Matrix3, Matrix6, Vector3, Vector6};

use super::vertices::MovingVertex;
use super::workspace::reset_matrix;
use crate::backend::{LinearRow, SumsRow};
use crate::geometry::{Camera, Pose};
use crate::model::{ChartGeometry, LevelTemplate};

/// Triangles are back-facing or edge-on where det A falls below this share of its value |A|^2 / 2 for a warp that
/// only turns and scales; relative, so that a distant object keeps its triangles.
const MIN_DETERMINANT: f64 = 0.02;

/// How the corners of a triangle move with the pose.
#[derive(Debug, Clone)]
pub(super) struct CornerMotion {
    /// Stack of `D(X_a)`: pixels of the image per increment, 6x6.
    image: Matrix6<f64>,
    /// Stack of `A^-1 D(X_a)`: pixels of the template per increment, 6x6; L_i in `docs/maths.md`.
    pub(super) template: Matrix6<f64>,
}

impl CornerMotion {
    /// Motion of the corners of a triangle with their chart; `None` if it is back-facing or edge-on.
    pub(super) fn new(corners: [&MovingVertex; 3], g: &ChartGeometry) -> Option<Self> {
        let inverse = chart_from_image(&Matrix2x3::from_columns(&corners.map(|c| c.image.coords)), g)?;
        let zero = Matrix6::zeros();
        let mut motion = Self { image: zero, template: zero };
        for (k, corner) in corners.iter().enumerate() {
            motion.image.fixed_view_mut::<2, 6>(2 * k, 0).copy_from(&corner.motion);
            motion.template.fixed_view_mut::<2, 6>(2 * k, 0).copy_from(&(inverse * corner.motion));
        }
        Some(motion)
    }
}

/// The corners of a triangle in the image, pixels; `None` if one of them is behind the camera.
pub(super) fn projected_corners(camera: &Camera, pose: &Pose, g: &ChartGeometry) -> Option<Matrix2x3<f64>> {
    let mut projected = Matrix2x3::zeros();
    for (mut corner, x) in projected.column_iter_mut().zip(&g.points) {
        corner.copy_from(&camera.project(&pose.transform_point(x))?.coords);
    }
    Some(projected)
}

/// A: the affine map of a triangle from its chart to `projected` corners, 2x2.
pub(super) fn image_from_chart(projected: &Matrix2x3<f64>, g: &ChartGeometry) -> Matrix2<f64> {
    projected * g.barycentric.fixed_columns::<2>(0)
}

/// `A^-1`: how a position in the chart moves with its position in the image, where the corners are at `projected`; `None` if
/// the triangle is back-facing or edge-on.
pub(super) fn chart_from_image(projected: &Matrix2x3<f64>, g: &ChartGeometry) -> Option<Matrix2<f64>> {
    let a = image_from_chart(projected, g);
    if a.determinant() < MIN_DETERMINANT * a.norm_squared() / 2.0 { None } else { a.try_inverse() }
}

/// sum q x f from the kernels' low-rank sums of x g (u, v, 1): b_a is linear in (u, v, 1).
pub(super) fn barycentric_gradient(sums: &[f64], g: &ChartGeometry) -> Vector6<f64> {
    let along_u = g.barycentric * Vector3::new(sums[0], sums[1], sums[2]);
    let along_v = g.barycentric * Vector3::new(sums[3], sums[4], sums[5]);
    Vector6::new(along_u[0], along_v[0], along_u[1], along_v[1], along_u[2], along_v[2])
}

/// sum q f f^T from sums of `h_a h_b (u^2, u v, u, v^2, v, 1)`.
fn barycentric_hessian(sums: &[f64], g: &ChartGeometry) -> Matrix6<f64> {
    let block = |s: &[f64]| {
        let second = Matrix3::new(s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]);
        g.barycentric * second * g.barycentric.transpose()
    };
    let [uu, uv, vv] = [&sums[..6], &sums[6..12], &sums[12..18]].map(block);
    Matrix6::from_fn(|i, j| match (i % 2, j % 2) {
        (0, 0) => uu[(i / 2, j / 2)],
        (1, 1) => vv[(i / 2, j / 2)],
        _ => uv[(i / 2, j / 2)],
    })
}

/// Second-order rows of one pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct SecondRows<'a> {
    pub(super) data: &'a [f64],
    pub(super) row_len: usize,
}

/// Whose gradient drives the pose.
#[derive(Debug, Clone, Copy)]
pub(super) enum Derivative<'a> {
    /// The template's; r changes by +J d with J = g^T A^-1 D.
    Template,
    /// That of the frame at the warped pixels; r changes by -J d with J = grad I(W)^T D.
    Frame(SecondRows<'a>),
}

/// What one triangle contributes: dr/dd = f^T `motion` with the moments of f over its pixels inside the image.
#[derive(Debug, Clone)]
pub(super) struct TrianglePart<'p> {
    pub(super) motion: Matrix6<f64>,
    /// sum q f f^T.
    pub(super) hessian: Matrix6<f64>,
    /// sum q f A^T is `share` times this; appearance columns in the order of [`crate::model::moments`].
    pub(super) cross: &'p DMatrix<f64>,
    pub(super) share: f64,
    /// sum q r f.
    pub(super) gradient: Vector6<f64>,
}

impl Derivative<'_> {
    /// The part of a triangle of which a share `inside` is in the image; `gain` is that of its group, `memory` is for the
    /// cross moments where they are not the template's.
    pub(super) fn of_triangle<'p>(
        &self,
        level: &'p LevelTemplate,
        (triangle, geometry): (usize, &ChartGeometry),
        (row, inside): (SumsRow<'_>, f64),
        corners: &CornerMotion,
        gain: f64,
        memory: &'p mut DMatrix<f64>,
    ) -> TrianglePart<'p> {
        let moments = &level.moments[triangle];
        let gradient = barycentric_gradient(row.gradient(), geometry);
        match self {
            // The template's gradient follows its gain.
            Self::Template => TrianglePart {
                motion: corners.template * (1.0 + gain),
                hessian: moments.hessian * inside,
                cross: &moments.cross,
                share: inside,
                gradient,
            },
            Self::Frame(seconds) => {
                let row = LinearRow(&seconds.data[triangle * seconds.row_len..][..seconds.row_len]);
                reset_matrix(memory, 6, moments.cross.ncols());
                for (k, mut column) in memory.column_iter_mut().enumerate() {
                    column.copy_from(&barycentric_gradient(row.cross(k), geometry));
                }
                let hessian = barycentric_hessian(row.hessian(), geometry);
                TrianglePart { motion: -corners.image, hessian, cross: memory, share: 1.0, gradient }
            }
        }
    }
}
