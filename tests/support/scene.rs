//! Seeded synthetic models, frames and requests for the stages.

use aam6d::backend::{ModelId, Request, TriangleWarp};
use aam6d::geometry::mesh::{Faces, TriangleMesh};
use aam6d::imaging::GrayImage;
use aam6d::imaging::sample::bilinear;
use aam6d::model::curvature::{Curvature, MIXED_STEP, STRAIGHT_STEP};
use aam6d::model::{Calibration, Chart, Grouping, Groups, LevelTemplate, Model, Moments, Pixels, Shape};
use nalgebra::{Matrix3, Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Size of the frames: odd, and no multiple of a row alignment.
pub(crate) const SIZE: (u32, u32) = (319, 241);

/// Chart width, pixels.
const CHART_WIDTH: usize = 29;

/// A model of one level, a frame, and poses of the model over it.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    pub(crate) model: Model,
    pub(crate) image: GrayImage,
    pub(crate) items: usize,
    /// Frame of every pose; empty: the first.
    pub(crate) frames: Vec<usize>,
    pub(crate) warps: Vec<TriangleWarp>,
    pub(crate) appearance: Vec<f32>,
}

impl Scene {
    /// `pixels` chart pixels in up to 128 charts, `modes` appearance modes, `items` poses. In pose 0 triangle 0 is
    /// fully inside the image; others may be partly outside, behind the camera, inactive or not a number.
    pub(crate) fn new(seed: u64, pixels: usize, modes: usize, items: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let charts = charts(&mut rng, pixels);
        Self::of_charts(rng, charts, modes, items)
    }

    /// A scene with one pixel per triangle.
    pub(crate) fn of_single_pixels(seed: u64, pixels: u32, modes: usize, items: usize) -> Self {
        let charts = (0..pixels).map(|start| Chart { start, end: start + 1, ..Chart::default() });
        Self::of_charts(ChaCha8Rng::seed_from_u64(seed), charts.collect(), modes, items)
    }

    fn of_charts(mut rng: ChaCha8Rng, charts: Vec<Chart>, modes: usize, items: usize) -> Self {
        let image = image(&mut rng, SIZE.0, SIZE.1);
        let warps: Vec<_> = (0..items)
            .flat_map(|item| (0..charts.len()).map(move |t| (item, t)))
            .map(|(item, t)| warp(&mut rng, item, t))
            .collect();
        let appearance = (0..items * modes).map(|_| rng.random_range(-1.0..1.0)).collect();
        let pixels = template(&mut rng, &charts, modes, &warps, &image).rounded();
        let curvature = curvature(&mut rng, pixels.len());
        Self { model: model(pixels, curvature, charts), image, items, frames: Vec::new(), warps, appearance }
    }

    /// The same in an image of which about a quarter is white, where every pose knows the light.
    pub(crate) fn overexposed(mut self) -> Self {
        self.image.iter_mut().for_each(|value| *value = value.saturating_add(90));
        self.warps.iter_mut().for_each(|warp| warp.light = [0.1, 90.0]);
        self
    }

    /// The same at the right of a wider image, which is grey to the left of it.
    pub(crate) fn widened(mut self, width: u32) -> Self {
        let left = width - self.image.width();
        let mut wide = GrayImage::from_pixel(width, self.image.height(), image::Luma([100]));
        for (x, y, pixel) in self.image.enumerate_pixels() {
            wide.put_pixel(left + x, y, *pixel);
        }
        for warp in &mut self.warps {
            let moved = warp.image_from_chart.row(0) + f64::from(left) * warp.image_from_chart.row(2);
            warp.image_from_chart.set_row(0, &moved);
        }
        self.image = wide;
        self
    }

    /// The request for all poses.
    pub(crate) fn request(&self, model: ModelId) -> Request<'_> {
        Request {
            model,
            level: 0,
            image_level: 0,
            items: self.items,
            frames: &self.frames,
            warps: &self.warps,
            appearance: &self.appearance,
        }
    }

    /// The one level.
    pub(crate) fn level(&self) -> &LevelTemplate {
        &self.model.levels[0]
    }
}

/// Texture with structure at several sizes and slopes of up to some 20 grey levels per pixel.
pub(crate) fn image(rng: &mut ChaCha8Rng, width: u32, height: u32) -> GrayImage {
    let waves: Vec<[f64; 4]> = (0..6)
        .map(|_| [rng.random_range(-0.3..0.3), rng.random_range(-0.3..0.3), rng.random_range(0.0..6.3), 18.0])
        .collect();
    GrayImage::from_fn(width, height, |x, y| {
        let value = waves.iter().fold(128.0, |sum, [a, b, phase, size]| {
            sum + size * (a * f64::from(x) + b * f64::from(y) + phase).sin()
        });
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
        image::Luma([(value + rng.random_range(-8.0..8.0)).round().clamp(0.0, 255.0) as u8])
    })
}

/// Charts of uneven sizes; the last of several is empty.
fn charts(rng: &mut ChaCha8Rng, pixels: usize) -> Vec<Chart> {
    let triangles = (pixels / 100).clamp(1, 128);
    let mut cuts: Vec<u32> = (1..triangles).map(|_| index(rng.random_range(0..pixels))).collect();
    cuts.extend([0, index(pixels)]);
    cuts.sort_unstable();
    let mut charts: Vec<_> =
        cuts.windows(2).map(|c| Chart { start: c[0], end: c[1], ..Chart::default() }).collect();
    if triangles > 1 {
        charts.push(Chart::default());
    }
    charts
}

/// The warp of a triangle: at rest, and with what the numbers of pose and triangle do to it.
fn warp(rng: &mut ChaCha8Rng, item: usize, triangle: usize) -> TriangleWarp {
    let (sin, cos) = rng.random_range(-0.5..0.5_f64).sin_cos();
    let scale = rng.random_range(0.7..1.1);
    let mut offset = [rng.random_range(40.0..240.0), rng.random_range(40.0..180.0)];
    let kind = (item + triangle) % 16;
    match kind {
        // Across the right, the left and the lower border.
        3 => offset[0] = 305.0,
        5 => offset[0] = -8.0,
        7 => offset[1] = 225.0,
        _ => {}
    }
    let tilt = [rng.random_range(-1e-3..1e-3), rng.random_range(-1e-3..1e-3), 1.0];
    // The horizon runs through the chart: its left part is behind the camera.
    let [p, q, w] = if kind == 11 { [1.0, 0.0, -8.5] } else { tilt };
    let mut h = Matrix3::new(scale * cos, -scale * sin, 0.0, scale * sin, scale * cos, 0.0, p, q, w);
    for (row, shift) in offset.into_iter().enumerate() {
        let moved = h.row(row) + shift * h.row(2);
        h.set_row(row, &moved);
    }
    h *= 0.6;
    match kind {
        9 => h *= -1.0,
        13 => h[(1, 1)] = f64::NAN,
        _ => {}
    }
    let mut blur = [[0.0; 3]; 2];
    if kind % 4 != 1 {
        blur.as_flattened_mut().fill_with(|| rng.random_range(-0.5..0.5));
    }
    TriangleWarp { blur, active: kind != 15, ..TriangleWarp::plain(h) }
}

/// Pixels that look like the image at pose 0, give or take a few grey levels.
fn template(
    rng: &mut ChaCha8Rng,
    charts: &[Chart],
    modes: usize,
    warps: &[TriangleWarp],
    image: &GrayImage,
) -> Pixels {
    let mut pixels = Pixels { modes: vec![Vec::new(); modes], ..Pixels::default() };
    for (chart, warp) in charts.iter().zip(warps) {
        for i in 0..chart.range().len() {
            let position = [i % CHART_WIDTH, i / CHART_WIDTH].map(|x| u16::try_from(x).unwrap_or(u16::MAX));
            let w = warp.image_from_chart * Vector3::from([position[0].into(), position[1].into(), 1.0]);
            let seen = bilinear(image, w.x / w.z, w.y / w.z).unwrap_or(128.0);
            #[expect(clippy::cast_possible_truncation, reason = "templates are f32")]
            pixels.intensity.push((seen + rng.random_range(-5.0..5.0)) as f32);
            pixels.position.push(position);
            pixels.gradient.push([rng.random_range(-20.0..20.0), rng.random_range(-20.0..20.0)]);
            pixels.weight.push(rng.random_range(0.1..1.0));
            for mode in &mut pixels.modes {
                mode.push(rng.random_range(-10.0..10.0));
            }
        }
    }
    pixels
}

/// Second differences of any sign, whole numbers of their steps.
fn curvature(rng: &mut ChaCha8Rng, pixels: usize) -> Vec<Curvature> {
    let steps = [STRAIGHT_STEP, MIXED_STEP, STRAIGHT_STEP];
    (0..pixels).map(|_| steps.map(|step| step * f32::from(rng.random_range(-20..20_i8)))).collect()
}

/// A model around a template; its shape is a placeholder that no stage looks at.
fn model(pixels: Pixels, curvature: Vec<Curvature>, charts: Vec<Chart>) -> Model {
    let mesh = TriangleMesh {
        vertices: vec![Point3::origin(), Point3::new(0.1, 0.0, 0.0), Point3::new(0.0, 0.1, 0.0)],
        triangles: vec![[0, 1, 2]; charts.len()],
    };
    let shape =
        Shape { mesh, faces: Faces::default(), corners: [Point3::origin(); 8], centre: Point3::origin() };
    let moments = vec![Moments::zero(pixels.modes.len()); charts.len()];
    let geometry = vec![None; charts.len()];
    let groups = Groups::new(Grouping::Triangle, &shape, &charts, &moments);
    let level = LevelTemplate {
        pixels,
        curvature,
        charts,
        geometry,
        moments,
        by_face: groups.clone(),
        by_triangle: groups,
    };
    let calibration = Calibration::default();
    Model { object_id: 1, shape, views: Vec::new(), levels: vec![level], calibration }
}

fn index(n: usize) -> u32 {
    u32::try_from(n).expect("small")
}

/// Lists the pixels in which two images differ.
pub(crate) fn compare_images(a: &GrayImage, b: &GrayImage) -> Result<(), String> {
    if a.dimensions() != b.dimensions() {
        return Err(format!("sizes {:?} and {:?}", a.dimensions(), b.dimensions()));
    }
    let differences: Vec<_> = a
        .enumerate_pixels()
        .zip(b.pixels())
        .filter(|((_, _, p), q)| p != q)
        .map(|((x, y, p), q)| format!("({x}, {y}): {} and {}", p[0], q[0]))
        .collect();
    if differences.is_empty() { Ok(()) } else { Err(differences.join(", ")) }
}
