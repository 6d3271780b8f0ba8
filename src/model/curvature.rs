//! Second differences of the template: what bilinear sampling of a frame takes from it.

use super::chart::Chart;
use super::template::Pixels;

/// Step of d2T/du2 and d2T/dv2, grey levels per pixel squared: 11 bits with sign hold what bytes can differ by.
pub const STRAIGHT_STEP: f32 = 0.5;
/// Step of d2T/du dv, grey levels per pixel squared: 10 bits with sign.
pub const MIXED_STEP: f32 = 0.25;

/// d2T/du2, d2T/du dv, d2T/dv2 of T0 at a pixel, grey levels per pixel squared, whole numbers of their steps.
pub type Curvature = [f32; 3];

/// The curvature at every pixel, from the pixels around it in its view; 0 where one of them is not in the template.
pub fn curvature(pixels: &Pixels, charts: &[Chart]) -> Vec<Curvature> {
    let views = charts.iter().map(|c| c.view).max().map_or(0, |last| last + 1);
    let mut all = vec![[0.0; 3]; pixels.len()];
    for view in 0..views {
        let charts: Vec<&Chart> = charts.iter().filter(|c| c.view == view && !c.is_empty()).collect();
        let map = Map::new(pixels, &charts);
        for chart in charts {
            for p in chart.range() {
                all[p] = map.curvature(place(pixels, chart, p));
            }
        }
    }
    all
}

/// Position of a pixel in its view.
fn place(pixels: &Pixels, chart: &Chart, p: usize) -> [usize; 2] {
    [0, 1].map(|k| chart.origin[k] as usize + usize::from(pixels.position[p][k]))
}

/// The template as an image, with a border of one pixel.
struct Map {
    first: [usize; 2],
    width: usize,
    /// NaN where there is no pixel.
    values: Vec<f32>,
}

impl Map {
    fn new(pixels: &Pixels, charts: &[&Chart]) -> Self {
        let places = || charts.iter().flat_map(|c| c.range().map(|p| (place(pixels, c, p), p)));
        let (lo, hi) = places().fold(([usize::MAX; 2], [0; 2]), |(lo, hi), (at, _)| {
            ([0, 1].map(|k| at[k].min(lo[k])), [0, 1].map(|k| at[k].max(hi[k])))
        });
        let [width, height] = [0, 1].map(|k| (hi[k] + 3).saturating_sub(lo[k]));
        let mut map = Self { first: lo, width, values: vec![f32::NAN; width * height] };
        for (at, p) in places() {
            let index = map.index(at);
            map.values[index] = pixels.intensity[p];
        }
        map
    }

    fn index(&self, at: [usize; 2]) -> usize {
        (at[1] - self.first[1] + 1) * self.width + at[0] - self.first[0] + 1
    }

    fn curvature(&self, at: [usize; 2]) -> Curvature {
        let (here, w) = (self.index(at), self.width);
        let value = |index: usize| self.values[index];
        let second = |along: usize| value(here + along) + value(here - along) - 2.0 * value(here);
        let mixed = value(here + w + 1) + value(here - w - 1) - value(here + w - 1) - value(here - w + 1);
        let rounded = |x: f32, step: f32, most: f32| {
            if x.is_nan() { 0.0 } else { (x / step).round().clamp(-most, most) * step }
        };
        let straight = |along: usize| rounded(second(along), STRAIGHT_STEP, 1023.0);
        [straight(1), rounded(mixed / 4.0, MIXED_STEP, 511.0), straight(w)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of a quadratic surface in two charts of one view, cut along a column, and the same in another view.
    fn charts() -> (Pixels, Vec<Chart>) {
        let mut pixels = Pixels::default();
        let mut charts = Vec::new();
        for (view, columns) in [(0, 0..4_u16), (0, 4..7), (1, 0..4)] {
            let start = u32::try_from(pixels.len()).expect("small");
            for (u, v) in columns.clone().flat_map(|u| (0..5_u16).map(move |v| (u, v))) {
                let (x, y) = (f32::from(u), f32::from(v));
                pixels.position.push([u - columns.start, v]);
                pixels.intensity.push(3.0 * x * x + 2.5 * x * y - y * y + 7.0 * x + 20.0);
            }
            let end = u32::try_from(pixels.len()).expect("small");
            charts.push(Chart { view, origin: [10 + u32::from(columns.start), 20], start, end });
        }
        (pixels, charts)
    }

    #[test]
    fn neighbours_are_found_across_charts_of_a_view() {
        let (pixels, charts) = charts();
        let found = curvature(&pixels, &charts);
        for (chart, columns) in charts.iter().zip([1..4, 0..2, 1..3]) {
            for p in chart.range() {
                let [u, v] = pixels.position[p];
                let [along_u, along_v] = [columns.contains(&u), (1..4).contains(&v)];
                let known = [(along_u, 6.0), (along_u && along_v, 2.5), (along_v, -2.0)];
                let expected = known.map(|(known, second)| if known { second } else { 0.0 });
                assert_eq!(found[p], expected, "chart {chart:?} pixel ({u}, {v})");
            }
        }
    }

    #[test]
    fn extremes_fit_their_bits() {
        let mut pixels = Pixels::default();
        for (u, v) in (0..3).flat_map(|u| (0..3).map(move |v| (u, v))) {
            pixels.position.push([u, v]);
            pixels.intensity.push(if (u, v) == (1, 1) { 255.0 } else { 0.0 });
        }
        let charts = [Chart { end: 9, ..Chart::default() }];
        assert_eq!(curvature(&pixels, &charts)[4], [-510.0, 0.0, -510.0], "11 bits hold 1020 steps");
    }
}
