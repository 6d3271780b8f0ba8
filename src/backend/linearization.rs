//! What `linearize` hands back: sums that give JtQJ and JtQr of the frame's own gradient.

use super::sums::Sums;

/// Sums of all poses and triangles of one request, with h = grad I(W(x)) of the frame and p = (u, v, 1) relative to
/// the chart's origin.
///
/// `sums` is as [`Sums`] says, with h in place of the template's gradient g. A row of second-order sums is
/// `[hessian (18), cross T0 (6), cross 1 (6), cross T1 (6) .. cross Tl (6)]`:
///
/// | name | sum of |
/// |---|---|
/// | hessian | q h_u^2 P, q h_u h_v P, q h_v^2 P with P = (u^2, u v, u, v^2, v, 1) |
/// | cross A | q A (h_u u, h_u v, h_u, h_v u, h_v v, h_v) |
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Linearization {
    /// The first-order sums.
    pub sums: Sums,
    triangles: usize,
    modes: usize,
    data: Vec<f64>,
}

impl Linearization {
    /// Numbers in a second-order row with `modes` appearance modes.
    pub const fn row_len(modes: usize) -> usize {
        30 + 6 * modes
    }

    /// Sets the shape and makes every sum zero. Keeps its memory.
    pub fn reset(&mut self, items: usize, triangles: usize, modes: usize) {
        self.sums.reset(items, triangles, modes);
        (self.triangles, self.modes) = (triangles, modes);
        self.data.clear();
        self.data.resize(items * triangles * Self::row_len(modes), 0.0);
    }

    /// The second-order row of a pose and triangle.
    pub fn row(&self, item: usize, triangle: usize) -> LinearRow<'_> {
        let n = Self::row_len(self.modes);
        LinearRow(&self.data[(item * self.triangles + triangle) * n..][..n])
    }

    /// All second-order rows of one pose, one after the other.
    pub fn item(&self, item: usize) -> &[f64] {
        let n = self.triangles * Self::row_len(self.modes);
        &self.data[item * n..][..n]
    }

    /// The numbers behind the first-order and the second-order rows, for backends that write in parallel.
    pub fn data_mut(&mut self) -> (&mut [f64], &mut [f64]) {
        (self.sums.data_mut(), &mut self.data)
    }
}

/// One second-order row of [`Linearization`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearRow<'a>(pub &'a [f64]);

impl<'a> LinearRow<'a> {
    /// sum `q h_a h_b P`: six numbers for each of uu, uv, vv.
    pub fn hessian(&self) -> &'a [f64] {
        &self.0[..18]
    }

    /// sum `q A (h_u u, h_u v, h_u, h_v u, h_v v, h_v)` of an appearance column in the order of
    /// [`crate::model::moments`].
    pub fn cross(&self, column: usize) -> &'a [f64] {
        &self.0[18 + 6 * column..][..6]
    }
}
