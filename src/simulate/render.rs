//! Renders one view: supersampled object over clutter, light, occluder, noise.

use image::GrayImage;
use nalgebra::Point3;
use rayon::prelude::*;

use super::blur;
use super::light::Light;
use super::object::TexturedMesh;
use super::occluder::Occluder;
use super::paint::{Style, paint};
use super::random::{Purpose, Stream, for_each_gaussian};
use super::raster::{Facet, SampleRow};
use super::texture::Texture;
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose};

/// Grey level behind the object without clutter.
const PLAIN_BACKGROUND: f64 = 128.0;

/// Gaussian noise of one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Standard deviation, grey levels of 255.
    pub sigma: f64,
    /// Seed; frames of one sequence differ by `frame`.
    pub seed: u64,
    /// Which of the seed's noise images.
    pub frame: u64,
}

/// Everything that changes from frame to frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct View {
    /// `camera_from_object`.
    pub pose: Pose,
    /// Exposure and lamp.
    pub light: Light,
    /// Hides a part of the object.
    pub occluder: Option<Occluder>,
    /// Standard deviation of the optical blur, pixels.
    pub blur: f64,
    /// Noise on the image.
    pub noise: Option<Noise>,
}

/// The object as seen: per pixel the grey value times the coverage, and the coverage 0..1.
struct Layer {
    value: Vec<f64>,
    coverage: Vec<f64>,
}

/// Bitmaps of the size of the image.
#[derive(Debug, Clone)]
struct Clutter {
    background: Texture,
    occluder: Texture,
}

/// Renders an object with one camera. The same bytes on every machine.
#[derive(Debug, Clone)]
pub struct Renderer {
    object: TexturedMesh,
    camera: Camera,
    supersampling: usize,
    clutter: Option<Clutter>,
}

impl Renderer {
    /// A renderer with 3x3 samples per pixel and a plain background.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a camera that is none or has lens distortion, and for a broken mesh.
    pub fn new(object: TexturedMesh, camera: Camera) -> Result<Self> {
        camera.validate()?;
        object.mesh.validate()?;
        if !camera.distortion.is_none() {
            let problem = "the renderer knows no lens distortion";
            return Err(Error::invalid("camera", problem, "render with Camera::rectified"));
        }
        if object.patches.len() != object.mesh.triangles.len()
            || object.patches.iter().any(|p| p.texture >= object.textures.len())
        {
            let problem = "not every triangle has a patch with a texture";
            return Err(Error::invalid("object", problem, "give one patch per triangle"));
        }
        Ok(Self { object, camera, supersampling: 3, clutter: None })
    }

    /// Takes `samples` x `samples` samples per pixel (1 to 8).
    ///
    /// # Errors
    /// [`Error::Invalid`] outside 1..=8.
    pub fn with_supersampling(mut self, samples: usize) -> Result<Self> {
        if !(1..=8).contains(&samples) {
            let problem = format!("{samples} samples per pixel and axis");
            return Err(Error::invalid("supersampling", problem, "give 1 to 8"));
        }
        self.supersampling = samples;
        Ok(self)
    }

    /// Paints clutter behind the object and on the occluder; `index` tells sequences of one seed apart.
    #[must_use]
    pub fn with_clutter(mut self, seed: u64, index: u64) -> Self {
        let bitmap = |purpose, base, softness| {
            let style = Style {
                // Clutter is painted at 2 px per unit: out of focus and larger than the object's print.
                size: [f64::from(self.camera.width) / 2.0, f64::from(self.camera.height) / 2.0],
                texels_per_unit: 2.0,
                base,
                grain: 13.0,
                panels: 30,
                discs: 9,
                rows: 0,
                letter: 12.0,
                softness,
                framed: false,
            };
            paint(&style, &mut Stream::new(seed, purpose, index))
        };
        let background = bitmap(Purpose::Background, 125.0, 1.6);
        self.clutter = Some(Clutter { background, occluder: bitmap(Purpose::Occluder, 95.0, 0.7) });
        self
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The object.
    pub fn object(&self) -> &TexturedMesh {
        &self.object
    }

    /// The object at a pose (`camera_from_object`) without light, occluder and noise.
    pub fn render(&self, pose: &Pose) -> GrayImage {
        self.render_view(&View { pose: *pose, ..View::default() })
    }

    /// One frame.
    pub fn render_view(&self, view: &View) -> GrayImage {
        let layer = self.object_layer(&view.pose, &view.light);
        let mut values = self.composite(&layer, view);
        if view.blur > 0.0 {
            blur::gaussian(&mut values, self.camera.width as usize, view.blur);
        }
        if let Some(noise) = view.noise.filter(|n| n.sigma > 0.0) {
            let mut stream = Stream::new(noise.seed, Purpose::Noise, noise.frame);
            for_each_gaussian(&mut stream, &mut values, |value, z| *value += noise.sigma * z);
        }
        #[expect(clippy::cast_possible_truncation, reason = "clamped to bytes")]
        let bytes = values.iter().map(|v| v.round().clamp(0.0, 255.0) as u8).collect();
        GrayImage::from_raw(self.camera.width, self.camera.height, bytes).expect("one byte per pixel")
    }

    /// The share of every pixel that the object covers, 0..1, row by row.
    pub fn coverage(&self, pose: &Pose) -> Vec<f64> {
        self.object_layer(pose, &Light::default()).coverage
    }

    fn facets(&self, pose: &Pose, light: &Light) -> Vec<Facet<'_>> {
        let mesh = &self.object.mesh;
        let seen: Vec<Point3<f64>> = mesh.vertices.iter().map(|v| pose.transform_point(v)).collect();
        let prepare = |(t, patch): (usize, &super::object::Patch)| {
            let corners = mesh.triangles[t].map(|k| seen[k as usize]);
            let shade = light.shade(&pose.rotate(&mesh.normal(t).normalize()));
            let texture = &self.object.textures[patch.texture];
            Facet::new(&corners, texture, &patch.corners, shade, &self.camera, self.supersampling)
        };
        self.object.patches.iter().enumerate().filter_map(prepare).collect()
    }

    fn object_layer(&self, pose: &Pose, light: &Light) -> Layer {
        let facets = self.facets(pose, light);
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let density = self.supersampling;
        let share = 1.0 / (density * density) as f64;
        let mut layer = Layer { value: vec![0.0; width * height], coverage: vec![0.0; width * height] };
        let rows = layer.value.par_chunks_mut(width).zip(layer.coverage.par_chunks_mut(width));
        rows.enumerate().for_each_init(
            || SampleRow::new(width * density),
            |samples, (v, (value, coverage))| {
                for y in v * density..(v + 1) * density {
                    samples.clear();
                    facets.iter().for_each(|facet| facet.fill(y, samples));
                    for (k, &grey) in samples.value.iter().enumerate() {
                        if samples.inverse_depth[k] > 0.0 {
                            value[k / density] += share * grey;
                            coverage[k / density] += share;
                        }
                    }
                }
            },
        );
        layer
    }

    /// Object over background, occluder over both, exposure over all.
    fn composite(&self, layer: &Layer, view: &View) -> Vec<f64> {
        let width = self.camera.width as usize;
        let edge = view.occluder.filter(|o| o.fraction > 0.0).map(|o| o.place(&layer.coverage, width));
        let mut values = vec![0.0; layer.value.len()];
        values.par_chunks_mut(width).enumerate().for_each(|(j, row)| {
            for (i, value) in row.iter_mut().enumerate() {
                let k = j * width + i;
                let (u, v) = (i as f64, j as f64);
                let behind =
                    self.clutter.as_ref().map_or(PLAIN_BACKGROUND, |c| f64::from(c.background.texels()[k]));
                let mut grey = layer.value[k] + (1.0 - layer.coverage[k]) * behind;
                if let Some(edge) = &edge {
                    let alpha = edge.alpha(u, v);
                    let front = |c: &Clutter| edge.value(&c.occluder, u, v);
                    if alpha > 0.0 {
                        grey += alpha * (self.clutter.as_ref().map_or(PLAIN_BACKGROUND, front) - grey);
                    }
                }
                *value = view.light.gain * grey + view.light.bias;
            }
        });
        values
    }
}

#[cfg(test)]
mod tests;
