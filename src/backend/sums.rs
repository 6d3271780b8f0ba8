//! What `accumulate` hands back: one row of sums per pose and triangle.

/// Sums of all poses and triangles of one request.
///
/// A row is `[gradient (6), cost, weight, count, intensity, one, modes (l)]`, each a sum over the triangle's pixels
/// whose warped position lies in the image, with r = T0 + sum lambda_k T_k - I:
///
/// | name | sum of |
/// |---|---|
/// | gradient | q r (g_u u, g_u v, g_u, g_v u, g_v v, g_v), (u, v) relative to the chart's origin |
/// | cost | q r^2 |
/// | weight | q |
/// | count | 1, less for a pixel with weight that is saturated and would be brighter |
/// | intensity | q r T0 |
/// | one | q r |
/// | modes | q r T_k |
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sums {
    triangles: usize,
    modes: usize,
    data: Vec<f64>,
}

impl Sums {
    /// Numbers in a row with `modes` appearance modes.
    pub const fn row_len(modes: usize) -> usize {
        11 + modes
    }

    /// Sets the shape and makes every sum zero. Keeps its memory.
    pub fn reset(&mut self, items: usize, triangles: usize, modes: usize) {
        (self.triangles, self.modes) = (triangles, modes);
        self.data.clear();
        self.data.resize(items * triangles * Self::row_len(modes), 0.0);
    }

    /// The row of a pose and triangle.
    pub fn row(&self, item: usize, triangle: usize) -> SumsRow<'_> {
        let n = Self::row_len(self.modes);
        SumsRow(&self.data[(item * self.triangles + triangle) * n..][..n])
    }

    /// All rows of one pose, one after the other.
    pub fn item(&self, item: usize) -> &[f64] {
        let n = self.triangles * Self::row_len(self.modes);
        &self.data[item * n..][..n]
    }

    /// All rows of all poses, one after the other, for backends to write to.
    pub fn rows_mut(&mut self) -> std::slice::ChunksExactMut<'_, f64> {
        let n = Self::row_len(self.modes);
        self.data.chunks_exact_mut(n)
    }

    /// The numbers behind the rows, for backends that write in parallel.
    pub fn data_mut(&mut self) -> &mut [f64] {
        &mut self.data
    }
}

/// One row of [`Sums`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SumsRow<'a>(pub &'a [f64]);

impl<'a> SumsRow<'a> {
    /// sum q r (g_u u, g_u v, g_u, g_v u, g_v v, g_v).
    pub fn gradient(&self) -> &'a [f64] {
        &self.0[..6]
    }

    /// sum q r^2.
    pub fn cost(&self) -> f64 {
        self.0[6]
    }

    /// sum q over the pixels inside the image.
    pub fn weight(&self) -> f64 {
        self.0[7]
    }

    /// Number of pixels inside the image.
    pub fn count(&self) -> f64 {
        self.0[8]
    }

    /// sum q r (T0, 1, T1..Tl), the order of the appearance columns in [`crate::model::moments`].
    pub fn appearance(&self) -> &'a [f64] {
        &self.0[9..]
    }
}
