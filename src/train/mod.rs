//! From posed images to a [`Model`]: charts from the views that see each triangle best, mean and modes over all
//! images, edge weights.

pub mod annotated;
mod assign;
mod canvas;
mod extend;
mod modes;
mod samples;

use image::GrayImage;

use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose, TriangleMesh};
use crate::imaging::Pyramid;
use crate::model::{Calibration, Chart, LevelTemplate, Model, Pixels, Shape, View};
use canvas::LevelCharts;
use samples::LevelSamples;

pub use extend::extend;

/// A posed training image.
#[derive(Debug, Clone)]
pub struct TrainingImage {
    /// Rectified image.
    pub image: GrayImage,
    /// Pinhole camera of the rectified image.
    pub camera: Camera,
    /// Pose of the object in it.
    pub camera_from_object: Pose,
}

/// Choices of the training.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainOptions {
    /// BOP object id to store.
    pub object_id: u32,
    /// Pyramid levels.
    pub levels: usize,
    /// Number of appearance modes l; at most one less than the number of images.
    pub modes: usize,
    /// Triangles with a longer edge in any image are cut, pixels; infinite: none is.
    pub max_edge_px: f64,
    /// Chart pixels keep this distance from the border of their face, pixels of each level; the last entry also
    /// serves all coarser levels.
    pub border_margin_px: Vec<f64>,
    /// An image takes part in the mean of a triangle if it sees it at least this well compared to the best.
    pub mean_quality: f64,
    /// Weights of eq. (10); off means q = 1.
    pub edge_weights: bool,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            object_id: 1,
            levels: 4,
            modes: 0,
            max_edge_px: 40.0,
            border_margin_px: vec![1.5, 1.5, 0.5],
            mean_quality: 0.7,
            edge_weights: true,
        }
    }
}

impl TrainOptions {
    fn margin(&self, level: usize) -> f64 {
        self.border_margin_px.get(level).or(self.border_margin_px.last()).copied().unwrap_or(0.0)
    }

    fn check(&self, images: usize) -> Result<()> {
        let refuse = |problem: String, remedy: &str| Err(Error::invalid("training", problem, remedy));
        if images == 0 {
            return refuse("there is no image".into(), "name at least one frame");
        }
        if self.levels == 0 || self.levels > 6 {
            return refuse(format!("{} pyramid levels", self.levels), "use 1 to 6");
        }
        if self.modes > 0 && self.modes >= images {
            let problem = format!("{} modes from {images} image(s)", self.modes);
            return refuse(problem, "use fewer modes than images");
        }
        if self.max_edge_px.is_nan() || self.max_edge_px < 4.0 {
            return refuse(format!("edges of at most {} px", self.max_edge_px), "use 4 px or more");
        }
        Ok(())
    }
}

/// Trains a model of `mesh` (object frame, metres) from posed images.
///
/// # Errors
/// [`Error::Invalid`] for an unusable mesh, pose or option, images of another size than their camera, or when no
/// triangle is seen well enough in any image.
pub fn train(mesh: &TriangleMesh, images: &[TrainingImage], options: &TrainOptions) -> Result<Model> {
    options.check(images.len())?;
    for (i, image) in images.iter().enumerate() {
        check_image(i, image)?;
    }
    let shape = Shape::from_mesh(mesh, options.max_edge_px, |a, b| {
        images.iter().filter_map(|i| projected_length(i, a, b)).fold(0.0, f64::max)
    })?;
    let views: Vec<View> =
        images.iter().map(|i| View { camera: i.camera, camera_from_object: i.camera_from_object }).collect();
    let sight = assign::Sight::new(&shape, &views);
    let view_of_triangle = assign::choose_views(&shape, &sight)?;
    let built = build_levels(&shape, &views, &sight, &view_of_triangle, images, options);
    let mut levels = Vec::with_capacity(options.levels);
    for (level, (pixels, charts)) in built.into_iter().enumerate() {
        levels.push(LevelTemplate::new(&shape, &views, level, pixels, charts)?);
    }
    if levels[0].pixels.is_empty() {
        let remedy = "use frames in which the object is larger or better lit";
        return Err(Error::invalid("training", "no usable template pixel", remedy));
    }
    let calibration = Calibration::default();
    Ok(Model { object_id: options.object_id, shape, views, levels, calibration })
}

/// Pixels and charts of every level for the triangles that have a view; views and images correspond.
fn build_levels(
    shape: &Shape,
    views: &[View],
    sight: &assign::Sight,
    view_of_triangle: &[Option<u32>],
    images: &[TrainingImage],
    options: &TrainOptions,
) -> Vec<(Pixels, Vec<Chart>)> {
    let pyramids: Vec<Pyramid> =
        images.iter().map(|i| Pyramid::new(i.image.clone(), options.levels)).collect();
    let mut photometry = None;
    let mut basis = None;
    let build = |level: usize| {
        let charts = LevelCharts::rasterise(shape, views, view_of_triangle, level, options.margin(level));
        let mut samples = LevelSamples::take(shape, views, sight, &charts, &pyramids, level);
        let photometry = photometry.get_or_insert_with(|| samples.photometry(&charts));
        samples.normalise(&charts, photometry);
        let mean = samples.mean(&charts, sight, options.mean_quality);
        let residuals = samples.residuals(&mean);
        let basis = basis.get_or_insert_with(|| modes::principal_combinations(&residuals, options.modes));
        finish(&charts, &mean, &modes::combine(&residuals, basis), options)
    };
    (0..options.levels).map(build).collect()
}

fn check_image(index: usize, image: &TrainingImage) -> Result<()> {
    let what = || format!("training image {index}");
    image.camera.validate()?;
    if !image.camera.distortion.is_none() {
        return Err(Error::invalid(what(), "its camera still has lens distortion", "rectify it first"));
    }
    if !image.camera_from_object.is_finite() {
        return Err(Error::invalid(what(), "its pose is not finite", "give a valid pose"));
    }
    if image.image.dimensions() != (image.camera.width, image.camera.height) {
        let (w, h) = image.image.dimensions();
        let problem = format!("{w}x{h}, but its camera has {}x{}", image.camera.width, image.camera.height);
        return Err(Error::invalid(what(), problem, "give image and calibration of the same camera"));
    }
    Ok(())
}

fn projected_length(
    image: &TrainingImage,
    a: &nalgebra::Point3<f64>,
    b: &nalgebra::Point3<f64>,
) -> Option<f64> {
    let project = |x| image.camera.project(&image.camera_from_object.transform_point(x));
    Some((project(a)? - project(b)?).norm())
}

/// Joins mean, gradient, weight and modes of the pixels that have a gradient and are not saturated, sorted by
/// triangle.
fn finish(
    charts: &LevelCharts,
    mean: &[f64],
    modes: &[Vec<f64>],
    options: &TrainOptions,
) -> (Pixels, Vec<Chart>) {
    let gradient = charts.gradients(mean);
    let mut pixels = Pixels { modes: vec![Vec::new(); modes.len()], ..Pixels::default() };
    let mut out = Vec::with_capacity(charts.by_triangle.len());
    for (triangle, members) in charts.by_triangle.iter().enumerate() {
        let usable = members.iter().filter(|&&p| charts.pixels[p].inner && mean[p] < samples::SATURATED);
        let usable: Vec<(usize, [f64; 2])> = usable.filter_map(|&p| gradient[p].map(|g| (p, g))).collect();
        let at = |p: usize| charts.pixels[p].position;
        let origin = [0, 1].map(|k| usable.iter().map(|&(p, _)| at(p)[k]).min().unwrap_or(0));
        let start = index(pixels.len());
        for (p, g) in usable {
            let offset = |k: usize| u16::try_from(at(p)[k] - origin[k]).unwrap_or(u16::MAX);
            pixels.position.push([offset(0), offset(1)]);
            pixels.gradient.push(g.map(narrow));
            pixels.intensity.push(narrow(mean[p]));
            for (column, mode) in pixels.modes.iter_mut().zip(modes) {
                column.push(narrow(mode[p]));
            }
        }
        out.push(Chart {
            view: charts.view_of_triangle[triangle].unwrap_or(0),
            origin,
            start,
            end: index(pixels.len()),
        });
    }
    pixels.weight = if options.edge_weights {
        crate::model::weights::edge_weights(&pixels.gradient)
    } else {
        vec![1.0; pixels.len()]
    };
    (pixels, out)
}

#[expect(clippy::cast_possible_truncation, reason = "the template is stored in f32")]
fn narrow(x: f64) -> f32 {
    x as f32
}

fn index(i: usize) -> u32 {
    u32::try_from(i).expect("templates have fewer than 2^32 pixels")
}
