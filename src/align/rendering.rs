//! How a frame shows a triangle: where, how much blurred by sampling, and how bright (`docs/maths.md`, "Sampling" and "Saturation").

use nalgebra::Matrix3;

use super::photometric::Solution;
use crate::backend::TriangleWarp;
use crate::geometry::warp::warp_jacobian;
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

/// The warp of a triangle in its light. With `is_blurred` the template is blurred as the frame is by bilinear sampling; its second
/// differences are turned to the axes of the image by A^-1 at the centroid.
pub(super) fn rendered(
    image_from_chart: Matrix3<f64>,
    geometry: &ChartGeometry,
    light: Light,
    is_blurred: bool,
) -> TriangleWarp {
    let mut warp = TriangleWarp { light: light.of_saturated(), ..TriangleWarp::plain(image_from_chart) };
    let turned = || warp_jacobian(&image_from_chart, &geometry.centroid()).try_inverse();
    if let Some(inverse) = is_blurred.then(turned).flatten() {
        let half = (1.0 + light.gain) / 2.0;
        warp.blur = [0, 1].map(|axis| {
            let (u, v) = (inverse[(0, axis)], inverse[(1, axis)]);
            [half * u * u, 2.0 * half * u * v, half * v * v]
        });
    }
    warp
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4x3, Point2, Point3};

    fn geometry() -> ChartGeometry {
        ChartGeometry {
            object_from_chart: Matrix4x3::zeros(),
            barycentric: Matrix3::identity(),
            corners: [Point2::new(0.0, 0.0), Point2::new(30.0, 0.0), Point2::new(0.0, 30.0)],
            points: [Point3::origin(); 3],
        }
    }

    /// A template cos(w u) seen turned by 90 degrees and twice as large varies along v of the image with w / 2.
    #[test]
    fn second_differences_are_turned_to_the_axes_of_the_image() {
        let turned = Matrix3::new(0.0, -2.0, 50.0, 2.0, 0.0, 60.0, 0.0, 0.0, 1.0);
        let light = Light { gain: 0.5, bias: 3.0 };
        let warp = rendered(turned, &geometry(), light, true);
        // (1 + gain) / 2 times the square of the scale.
        let expected = [[0.0, 0.0, 0.1875], [0.1875, 0.0, 0.0]];
        for (found, expected) in warp.blur.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((found - expected).abs() < 1e-12, "{:?}", warp.blur);
        }
        assert_eq!(warp.light, [0.5, 3.0], "the light is passed on");
    }

    #[test]
    fn coarse_levels_are_not_blurred_and_flat_triangles_say_nothing_of_what_is_saturated() {
        let flat = Light { gain: -0.9, bias: 200.0 };
        let warp = rendered(Matrix3::identity(), &geometry(), flat, false);
        assert_eq!((warp.blur, warp.light), ([[0.0; 3]; 2], TriangleWarp::UNKNOWN_LIGHT), "{warp:?}");
    }
}
