//! The derivative of the residual by the pose, per triangle: from the template's gradient (inverse compositional) or
//! from the frame's (forward additive). `docs/maths.md`, "Moments" and "Forward additive".

use nalgebra::{DMatrix, Matrix2, Matrix3, Matrix6, Point3, Vector3, Vector6};

use super::normal_equations::Rows;
use super::workspace::{copy_matrix, reset_matrix};
use crate::backend::LinearRow;
use crate::geometry::warp::{affine, increment_jacobian};
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
    /// Mean of D^T D.
    pub(super) metric: Matrix6<f64>,
}

impl CornerMotion {
    /// Motion with an increment on the right about `centre`; `None` if back-facing, edge-on or behind the camera.
    pub(super) fn new(camera: &Camera, pose: &Pose, g: &ChartGeometry, centre: &Point3<f64>) -> Option<Self> {
        let inverse = chart_from_image(camera, pose, g)?;
        let zero = Matrix6::zeros();
        let mut motion = Self { image: zero, template: zero, metric: zero };
        for (k, x) in g.points.iter().enumerate() {
            let d = increment_jacobian(camera, pose, x, centre);
            motion.image.fixed_view_mut::<2, 6>(2 * k, 0).copy_from(&d);
            motion.template.fixed_view_mut::<2, 6>(2 * k, 0).copy_from(&(inverse * d));
            motion.metric += d.transpose() * d / 3.0;
        }
        Some(motion)
    }
}

/// `A^-1`: how a position in the chart moves with its position in the image; `None` if the triangle is back-facing,
/// edge-on or behind the camera.
pub(super) fn chart_from_image(camera: &Camera, pose: &Pose, g: &ChartGeometry) -> Option<Matrix2<f64>> {
    let mut projected = g.corners;
    for (p, x) in projected.iter_mut().zip(&g.points) {
        *p = camera.project(&pose.transform_point(x))?;
    }
    let a: Matrix2<f64> = affine(&g.corners, &projected)?.fixed_view::<2, 2>(0, 0).into_owned();
    if a.determinant() < MIN_DETERMINANT * a.norm_squared() / 2.0 {
        return None;
    }
    a.try_inverse()
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
pub(super) struct TrianglePart {
    pub(super) motion: Matrix6<f64>,
    /// sum q f f^T.
    pub(super) hessian: Matrix6<f64>,
    /// sum q f A^T, appearance columns in the order of [`crate::model::moments`].
    pub(super) cross: DMatrix<f64>,
    /// sum q r f.
    pub(super) gradient: Vector6<f64>,
}

impl Default for TrianglePart {
    fn default() -> Self {
        let zero = Matrix6::zeros();
        Self { motion: zero, hessian: zero, cross: DMatrix::zeros(6, 0), gradient: Vector6::zeros() }
    }
}

impl Derivative<'_> {
    /// Writes the part of a triangle; `gain` is that of its group.
    pub(super) fn of_triangle(
        &self,
        level: &LevelTemplate,
        (triangle, geometry): (usize, &ChartGeometry),
        rows: &Rows<'_>,
        corners: &CornerMotion,
        gain: f64,
        part: &mut TrianglePart,
    ) {
        let moments = &level.moments[triangle];
        part.gradient = barycentric_gradient(rows.row(triangle).gradient(), geometry);
        match self {
            Self::Template => {
                let inside = rows.inside(level, triangle);
                // The template's gradient follows its gain.
                part.motion = corners.template * (1.0 + gain);
                part.hessian = moments.hessian * inside;
                copy_matrix(&mut part.cross, &moments.cross);
                part.cross *= inside;
            }
            Self::Frame(seconds) => {
                let row = LinearRow(&seconds.data[triangle * seconds.row_len..][..seconds.row_len]);
                part.motion = -corners.image;
                part.hessian = barycentric_hessian(row.hessian(), geometry);
                reset_matrix(&mut part.cross, 6, moments.cross.ncols());
                for (k, mut column) in part.cross.column_iter_mut().enumerate() {
                    column.copy_from(&barycentric_gradient(row.cross(k), geometry));
                }
            }
        }
    }
}
