//! How a frame shows a triangle: where, how much blurred by sampling, and how bright (`docs/maths.md`, "Sampling" and "Saturation").

use nalgebra::Matrix3;

use super::photometric::Solution;
use crate::backend::TriangleWarp;
use crate::geometry::warp::warp_jacobian;
use crate::model::{ChartGeometry, Groups};

/// With less gain than this a triangle is next to flat, and what it would show if it were brighter says nothing.
const MIN_GAIN: f64 = 0.2;

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
    let mut warp =
        TriangleWarp { light: light.of_saturated(), ..TriangleWarp::plain(image_from_chart) };
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
