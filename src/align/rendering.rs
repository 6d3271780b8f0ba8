//! How a frame shows a triangle: where, how much blurred by sampling, and how bright (`docs/maths.md`, "Sampling" and "Saturation").

use nalgebra::Matrix3;

use super::photometric::Solution;
use crate::backend::TriangleWarp;
use crate::model::{ChartGeometry, Groups};

/// With less gain than this a triangle is next to flat, and what it would show if it were brighter says nothing.
const MIN_GAIN: f64 = 0.1;

/// Grey levels of a triangle in the frame beyond those of the template with its modes: `gain` T0 + `bias`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Light {
    gain: f64,
    bias: f64,
}

impl Default for Light {
    /// Not known: what is saturated stays as it is.
    fn default() -> Self {
        let [gain, bias] = TriangleWarp::UNKNOWN_LIGHT;
        Self { gain, bias }
    }
}

impl Light {
    /// The light on every triangle by the gain and bias of its group.
    pub(super) fn of_triangles(groups: &Groups, solutions: &[Solution], light: &mut Vec<Self>) {
        light.clear();
        light.extend(groups.of_triangle.iter().map(|&group| {
            let [(_, gain), (_, bias)] = solutions[group].columns(groups.centre[group]);
            Self { gain, bias }
        }));
    }

    /// [`TriangleWarp::light`].
    fn of_saturated(self) -> [f64; 2] {
        if 1.0 + self.gain < MIN_GAIN { TriangleWarp::UNKNOWN_LIGHT } else { [self.gain, self.bias] }
    }
}

/// The warp of a triangle in its light; with `is_blurred` the template is blurred as the frame is.
pub(super) fn rendered(
    image_from_chart: Matrix3<f64>,
    geometry: &ChartGeometry,
    light: Light,
    is_blurred: bool,
) -> TriangleWarp {
    let warp = TriangleWarp { light: light.of_saturated(), ..TriangleWarp::plain(image_from_chart) };
    if is_blurred { warp.blurred(&geometry.centroid(), light.gain) } else { warp }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4x3, Point2, Point3};

    #[test]
    fn full_size_is_blurred_and_flat_triangles_say_nothing_of_what_is_saturated() {
        let corners = [Point2::new(0.0, 0.0), Point2::new(30.0, 0.0), Point2::new(0.0, 30.0)];
        let geometry = ChartGeometry {
            object_from_chart: Matrix4x3::zeros(),
            barycentric: Matrix3::identity(),
            corners,
            points: [Point3::origin(); 3],
        };
        let seen = |gain, is_blurred| {
            rendered(Matrix3::identity(), &geometry, Light { gain, bias: 200.0 }, is_blurred)
        };
        let warp = seen(0.5, true);
        assert_eq!((warp.blur[0], warp.light), ([0.75, 0.0, 0.0], [0.5, 200.0]), "full size");
        let warp = seen(-0.95, false);
        assert_eq!((warp.blur, warp.light), ([[0.0; 3]; 2], TriangleWarp::UNKNOWN_LIGHT), "flat");
    }
}
