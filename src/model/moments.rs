//! Per-triangle sums over the template that give JtQJ at any pose without touching a pixel again.
//!
//! With barycentric coordinates b_a(x) and f(x) = (b_1 g_u, b_1 g_v, b_2 g_u, b_2 g_v, b_3 g_u, b_3 g_v):
//! `hessian` = sum q f f^T, `cross` = sum q f A^T, `appearance` = sum q A A^T, where the appearance columns are
//! A = (T0, 1, T1..Tl). `docs/maths.md` section "Moments".

use nalgebra::{DMatrix, Matrix6, Vector3, Vector6};

use super::chart::{Chart, ChartGeometry};
use super::template::Pixels;

/// Position of the intensity column T0 (gain) among the appearance columns.
pub const GAIN: usize = 0;
/// Position of the constant column (bias) among the appearance columns.
pub const BIAS: usize = 1;
/// Position of the first mode among the appearance columns.
pub const FIRST_MODE: usize = 2;

/// Sums over one chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Moments {
    /// sum q f f^T, 6x6.
    pub hessian: Matrix6<f64>,
    /// sum q f A^T, 6 x (2+l).
    pub cross: DMatrix<f64>,
    /// sum q A A^T, (2+l) x (2+l).
    pub appearance: DMatrix<f64>,
    /// Number of pixels.
    pub count: f64,
    /// Root mean square gradient, grey levels per pixel.
    pub contrast: f64,
}

impl Moments {
    /// Moments of a chart without pixels, for `modes` appearance modes.
    pub fn zero(modes: usize) -> Self {
        Self {
            hessian: Matrix6::zeros(),
            cross: DMatrix::zeros(6, FIRST_MODE + modes),
            appearance: DMatrix::zeros(FIRST_MODE + modes, FIRST_MODE + modes),
            count: 0.0,
            contrast: 0.0,
        }
    }

    /// Sums over the pixels of a chart.
    pub fn new(pixels: &Pixels, chart: &Chart, geometry: &ChartGeometry) -> Self {
        let mut sums = Self::zero(pixels.modes.len());
        let mut columns = vec![0.0; FIRST_MODE + pixels.modes.len()];
        let mut energy = 0.0;
        for p in chart.range() {
            let [u, v] = pixels.position[p].map(f64::from);
            let b = geometry.barycentric * Vector3::new(u, v, 1.0);
            let [gu, gv] = pixels.gradient[p].map(f64::from);
            let f = Vector6::new(b[0] * gu, b[0] * gv, b[1] * gu, b[1] * gv, b[2] * gu, b[2] * gv);
            columns[GAIN] = f64::from(pixels.intensity[p]);
            columns[BIAS] = 1.0;
            for (k, mode) in pixels.modes.iter().enumerate() {
                columns[FIRST_MODE + k] = f64::from(mode[p]);
            }
            let q = f64::from(pixels.weight[p]);
            sums.hessian.syger(q, &f, &f, 1.0);
            for (i, &a) in columns.iter().enumerate() {
                sums.cross.column_mut(i).axpy(q * a, &f, 1.0);
                for (j, &b) in columns.iter().enumerate() {
                    sums.appearance[(i, j)] += q * a * b;
                }
            }
            energy += gu * gu + gv * gv;
        }
        sums.hessian.fill_upper_triangle_with_lower_triangle();
        #[expect(clippy::cast_precision_loss, reason = "pixel counts are far below 2^52")]
        let count = chart.range().len() as f64;
        Self { count, contrast: (energy / count.max(1.0)).sqrt(), ..sums }
    }

    /// sum q.
    pub fn weight(&self) -> f64 {
        self.appearance[(BIAS, BIAS)]
    }

    /// Weighted variance of the template intensity over the chart, grey levels squared.
    pub fn variance(&self) -> f64 {
        let n = self.weight();
        if n <= 0.0 {
            return 0.0;
        }
        let mean = self.appearance[(GAIN, BIAS)] / n;
        (self.appearance[(GAIN, GAIN)] / n - mean * mean).max(0.0)
    }
}
