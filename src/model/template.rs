//! The template: for every pyramid level the chart pixels of all triangles, sorted by triangle.

use serde::{Deserialize, Serialize};

use super::calibration::Calibration;
use super::chart::{Chart, ChartGeometry};
use super::curvature::{Curvature, curvature};
use super::groups::{Grouping, Groups};
use super::moments::Moments;
use super::shape::Shape;
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose};

/// A reference view: a pinhole camera (full size) and where the object was in it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Camera of the rectified image.
    pub camera: Camera,
    /// Pose of the object in it.
    pub camera_from_object: Pose,
}

/// Chart pixels of one level, one entry per pixel in every column; in a template all values are whole numbers of [`steps`].
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Pixels {
    /// Position relative to the chart's origin, pixels.
    pub position: Vec<[u16; 2]>,
    /// Template gradient (u, v), grey levels per pixel.
    pub gradient: Vec<[f32; 2]>,
    /// Mean template intensity T0, grey levels 0..255.
    pub intensity: Vec<f32>,
    /// Weight q of eq. (10), 0..1.
    pub weight: Vec<f32>,
    /// Appearance modes T1..Tl of eq. (4), one column each, in grey levels per standard deviation.
    pub modes: Vec<Vec<f32>>,
}

/// Steps of the values of a template: 16-bit numbers on the device, the same values on every backend.
pub mod steps {
    /// Of gradients (grey levels per pixel) and of modes (grey levels): 16 bits with sign.
    pub const SIGNED: f32 = 1.0 / 128.0;
    /// Of the mean intensity, grey levels: 16 bits.
    pub const INTENSITY: f32 = 1.0 / 256.0;
    /// Of the weight: 1 is 2^15.
    pub const WEIGHT: f32 = 1.0 / 32768.0;
}

impl Pixels {
    /// All values rounded to [`steps`] of what 16 bits hold, far below the noise of any image; [`LevelTemplate::new`] does so.
    #[must_use]
    pub fn rounded(mut self) -> Self {
        let to =
            |step: f32, lo: f32, hi: f32| move |x: &mut f32| *x = (*x / step).round().clamp(lo, hi) * step;
        let signed = to(steps::SIGNED, f32::from(i16::MIN), f32::from(i16::MAX));
        self.gradient.as_flattened_mut().iter_mut().chain(self.modes.iter_mut().flatten()).for_each(signed);
        self.intensity.iter_mut().for_each(to(steps::INTENSITY, 0.0, f32::from(u16::MAX)));
        self.weight.iter_mut().for_each(to(steps::WEIGHT, 0.0, 1.0 / steps::WEIGHT));
        self
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }
}

/// One pyramid level of the template.
#[derive(Debug, Clone)]
pub struct LevelTemplate {
    /// Pixels of all charts, sorted by triangle.
    pub pixels: Pixels,
    /// Second differences of the mean intensity, one entry per pixel.
    pub curvature: Vec<Curvature>,
    /// One chart per triangle of the shape.
    pub charts: Vec<Chart>,
    /// Geometry of every chart that has pixels.
    pub geometry: Vec<Option<ChartGeometry>>,
    /// Sums over every chart that give JtQJ at any pose.
    pub moments: Vec<Moments>,
    /// Triangles by face and view.
    pub by_face: Groups,
    /// Every triangle by itself.
    pub by_triangle: Groups,
}

impl LevelTemplate {
    /// Joins pixels, rounded to their [`steps`], and charts with what follows from them.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the columns differ in length, a chart reaches beyond them, or a number is not finite.
    pub fn new(
        shape: &Shape,
        views: &[View],
        level: usize,
        pixels: Pixels,
        charts: Vec<Chart>,
    ) -> Result<Self> {
        check(shape, (views, level), &pixels, &charts).map_err(|problem| {
            Error::invalid(format!("template level {level}"), problem, "train the model again")
        })?;
        let pixels = pixels.rounded();
        let geometry: Vec<_> = charts
            .iter()
            .enumerate()
            .map(|(t, c)| {
                (!c.is_empty())
                    .then(|| ChartGeometry::new(shape, t, &views[c.view as usize], level, c.origin))
                    .flatten()
            })
            .collect();
        let moments: Vec<_> = charts
            .iter()
            .zip(&geometry)
            .map(|(c, g)| {
                g.as_ref().map_or_else(|| Moments::zero(pixels.modes.len()), |g| Moments::new(&pixels, c, g))
            })
            .collect();
        let groups = |grouping| Groups::new(grouping, shape, &charts, &moments);
        let (by_face, by_triangle) = (groups(Grouping::FaceAndView), groups(Grouping::Triangle));
        let curvature = curvature(&pixels, &charts);
        Ok(Self { pixels, curvature, charts, geometry, moments, by_face, by_triangle })
    }

    /// The groups of the level.
    pub fn groups(&self, grouping: Grouping) -> &Groups {
        match grouping {
            Grouping::FaceAndView => &self.by_face,
            Grouping::Triangle => &self.by_triangle,
        }
    }
}

fn check(
    shape: &Shape,
    (views, level): (&[View], usize),
    pixels: &Pixels,
    charts: &[Chart],
) -> Result<(), String> {
    let n = pixels.len();
    let lengths = [pixels.gradient.len(), pixels.intensity.len(), pixels.weight.len()];
    if lengths.iter().chain(&pixels.modes.iter().map(Vec::len).collect::<Vec<_>>()).any(|&l| l != n) {
        return Err(format!("columns of different lengths, {n} positions"));
    }
    if charts.len() != shape.triangles() {
        return Err(format!("{} charts for {} triangles", charts.len(), shape.triangles()));
    }
    if let Some(t) =
        charts.iter().position(|c| c.start > c.end || c.end as usize > n || c.view as usize >= views.len())
    {
        return Err(format!("the chart of triangle {t} points outside the template"));
    }
    if let Some(t) =
        charts.iter().position(|c| !c.is_empty() && !is_inside(&views[c.view as usize], level, pixels, c))
    {
        return Err(format!("the chart of triangle {t} reaches beyond the image of its view"));
    }
    let numbers = pixels.intensity.iter().chain(&pixels.weight).chain(pixels.gradient.as_flattened());
    if numbers.chain(pixels.modes.iter().flatten()).any(|v| !v.is_finite()) {
        return Err("a number is not finite".into());
    }
    Ok(())
}

/// Are all pixels of a chart in the image of its view?
fn is_inside(view: &View, level: usize, pixels: &Pixels, chart: &Chart) -> bool {
    let camera = view.camera.at_level(level);
    let [width, height] = [camera.width, camera.height].map(u64::from);
    let [u, v] = chart.origin.map(u64::from);
    pixels.position[chart.range()]
        .iter()
        .all(|position| u + u64::from(position[0]) < width && v + u64::from(position[1]) < height)
}

/// A trained object: what [`crate::track::Tracker`] needs, and what a model file holds.
#[derive(Debug, Clone)]
pub struct Model {
    /// BOP object id.
    pub object_id: u32,
    /// 3D shape.
    pub shape: Shape,
    /// Reference views.
    pub views: Vec<View>,
    /// Template per pyramid level, level 0 first.
    pub levels: Vec<LevelTemplate>,
    /// What the score of a pose is worth; not calibrated unless [`crate::track::calibrate`] has done it.
    pub calibration: Calibration,
}

impl Model {
    /// Number of appearance modes l.
    pub fn modes(&self) -> usize {
        self.levels.first().map_or(0, |l| l.pixels.modes.len())
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::geometry::TriangleMesh;

    /// A file may say anything, and what follows from a chart takes memory for all that lies between its pixels.
    #[test]
    fn charts_beyond_the_image_of_their_view_are_refused() {
        let vertices = vec![Point3::origin(), Point3::new(0.0, 0.1, 0.0), Point3::new(0.1, 0.0, 0.0)];
        let mesh = TriangleMesh { vertices, triangles: vec![[0, 1, 2]] };
        let shape = Shape::from_mesh(&mesh, f64::INFINITY, |a, b| (a - b).norm()).expect("a mesh");
        let camera = Camera::pinhole(100.0, 100.0, 31.5, 23.5, 64, 48);
        let away = Pose::from_params(&nalgebra::Vector6::new(0.0, 0.0, 1.0, 0.0, 0.0, 0.0));
        let views = [View { camera, camera_from_object: away }];
        let level = |level, origin| {
            let pixels = Pixels {
                position: vec![[0, 0], [1, 0]],
                gradient: vec![[1.0, 2.0]; 2],
                intensity: vec![100.0; 2],
                weight: vec![1.0; 2],
                modes: Vec::new(),
            };
            LevelTemplate::new(
                &shape,
                &views,
                level,
                pixels,
                vec![Chart { view: 0, origin, start: 0, end: 2 }],
            )
        };
        assert!(level(0, [62, 47]).is_ok() && level(1, [30, 23]).is_ok(), "the last pixels");
        for (number, origin) in [(0, [63, 0]), (0, [0, 48]), (1, [31, 0]), (0, [u32::MAX, 0])] {
            let refused = level(number, origin).expect_err("outside").to_string();
            assert!(refused.contains("triangle 0 reaches beyond the image"), "{refused}");
        }
    }
}
