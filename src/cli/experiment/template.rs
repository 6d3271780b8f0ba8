//! Pictures of a template: intensities with landmarks and mesh, and the weights of eq. (10).

use std::collections::HashMap;

use anyhow::Context;
use base64::Engine as _;
use image::{ExtendedColorType, ImageEncoder};
use nalgebra::Point2;
use svg::Document;
use svg::node::element::{Circle, Group, Image, Polygon, Rectangle};

use super::plot::{canvas, text};
use crate::geometry::TriangleMesh;
use crate::geometry::raster::{for_each_pixel, visible_shares};
use crate::geometry::warp::{apply, homography};
use crate::model::{Model, View};

/// Space around the template, pixels.
const MARGIN: u32 = 6;
/// Anchors of the colours of weights 0 to 1 (after matplotlib's viridis, CC0).
const COLOURS: [[f64; 3]; 5] =
    [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [253.0, 231.0, 37.0]];

/// The template seen from the reference view that holds most of it.
pub(super) struct Picture<'a> {
    mesh: &'a TriangleMesh,
    view: View,
    /// Upper left pixel and size of the part that is drawn.
    origin: [u32; 2],
    size: [u32; 2],
    /// Image position, intensity, weight.
    pixels: Vec<([u32; 2], f32, f32)>,
}

impl<'a> Picture<'a> {
    /// Looks up every pixel of the view in the charts.
    pub(super) fn new(model: &Model, mesh: &'a TriangleMesh) -> anyhow::Result<Self> {
        let level = model.levels.first().context("the model has no level")?;
        let share = |view: usize| -> usize {
            level.charts.iter().filter(|c| c.view as usize == view).map(|c| c.range().len()).sum()
        };
        let best = (0..model.views.len()).max_by_key(|&v| share(v)).context("the model has no view")?;
        let view = model.views[best];
        let (camera, pose) = (&view.camera, &view.camera_from_object);
        let seen = visible_shares(&model.shape.mesh, camera, pose);
        let mut pixels = Vec::new();
        for ((chart, geometry), seen) in level.charts.iter().zip(&level.geometry).zip(seen) {
            let Some(geometry) = geometry.as_ref().filter(|_| seen > 0.0) else { continue };
            let warp = homography(camera, pose, &geometry.object_from_chart);
            let Some(back) = warp.try_inverse() else { continue };
            let known: HashMap<[u16; 2], usize> =
                chart.range().map(|i| (level.pixels.position[i], i)).collect();
            let corners = geometry.corners.map(|c| apply(&warp, &c).unwrap_or_default());
            for_each_pixel(&corners, camera.width, camera.height, |u, v| {
                let at = apply(&back, &Point2::new(f64::from(u), f64::from(v)));
                if let Some(i) = at.and_then(|p| nearest(&p, &known)) {
                    pixels.push(([u, v], level.pixels.intensity[i], level.pixels.weight[i]));
                }
            });
        }
        let first = pixels.first().context("the template has no pixel in its own view")?.0;
        let (lo, hi) = pixels.iter().fold((first, first), |(lo, hi), (p, ..)| {
            ([0, 1].map(|k| p[k].min(lo[k])), [0, 1].map(|k| p[k].max(hi[k])))
        });
        let origin = lo.map(|c| c.saturating_sub(MARGIN));
        let size = [0, 1].map(|k| hi[k] + 1 + MARGIN - origin[k]);
        Ok(Self { mesh, view, origin, size, pixels })
    }

    /// Grey levels; transparent where the template has no pixel.
    pub(super) fn template_png(&self) -> anyhow::Result<Vec<u8>> {
        self.png(|intensity, _| [channel(f64::from(intensity)); 3])
    }

    /// Weights in colours.
    pub(super) fn weights_png(&self) -> anyhow::Result<Vec<u8>> {
        self.png(|_, weight| colour(f64::from(weight)))
    }

    fn png(&self, paint: impl Fn(f32, f32) -> [u8; 3]) -> anyhow::Result<Vec<u8>> {
        let [w, h] = self.size;
        let mut picture = image::RgbaImage::new(w, h);
        for ([u, v], intensity, weight) in &self.pixels {
            let [r, g, b] = paint(*intensity, *weight);
            picture.put_pixel(u - self.origin[0], v - self.origin[1], image::Rgba([r, g, b, 255]));
        }
        let mut bytes = Vec::new();
        image::codecs::png::PngEncoder::new(&mut bytes).write_image(
            picture.as_raw(),
            w,
            h,
            ExtendedColorType::Rgba8,
        )?;
        Ok(bytes)
    }

    /// The template with landmarks and their triangles.
    pub(super) fn landmarks(&self) -> anyhow::Result<Document> {
        let place = |k: u32| {
            let x = self.view.camera_from_object.transform_point(&self.mesh.vertices[k as usize]);
            let p = self.view.camera.project(&x)?;
            // Pixel centres are at integers, but the corner of a pixel is where a picture begins.
            Some([0, 1].map(|i| p[i] + 0.5 - f64::from(self.origin[i])))
        };
        let shares = visible_shares(self.mesh, &self.view.camera, &self.view.camera_from_object);
        let mut lines = Group::new();
        let mut dots = Group::new();
        let mut drawn = vec![false; self.mesh.vertices.len()];
        for (triangle, _) in self.mesh.triangles.iter().zip(shares).filter(|(_, s)| *s > 0.0) {
            let [Some(a), Some(b), Some(c)] = triangle.map(place) else { continue };
            let points = [a, b, c].map(|p| format!("{:.2},{:.2}", p[0], p[1])).join(" ");
            lines = lines.add(Polygon::new().set("points", points).set("class", "mesh"));
            for (&k, p) in triangle.iter().zip([a, b, c]) {
                if !std::mem::replace(&mut drawn[k as usize], true) {
                    let dot = Circle::new().set("cx", round(p[0])).set("cy", round(p[1]));
                    dots = dots.add(dot.set("r", 2.4).set("class", "landmark"));
                }
            }
        }
        let [w, h] = self.size.map(f64::from);
        let about = "Template with landmarks and triangles";
        Ok(canvas(w, h, about).add(embedded(&self.template_png()?, w, h)).add(lines).add(dots))
    }

    /// The weights with their scale.
    pub(super) fn weights(&self) -> anyhow::Result<Document> {
        let [w, h] = self.size.map(f64::from);
        let about = "Weights of equation 10 from 0 to 1";
        let mut document = canvas(w, h + 34.0, about).add(embedded(&self.weights_png()?, w, h));
        let (left, width) = (w * 0.2, w * 0.6);
        for k in 0..48 {
            let share = f64::from(k) / 47.0;
            let [r, g, b] = colour(share);
            let step = Rectangle::new()
                .set("x", round(left + width * f64::from(k) / 48.0))
                .set("y", h + 2.0)
                .set("width", round(width / 48.0 + 0.4))
                .set("height", 9)
                .set("fill", format!("#{r:02x}{g:02x}{b:02x}"));
            document = document.add(step);
        }
        for (share, words) in [(0.0, "q = 0"), (0.5, "0.5"), (1.0, "1")] {
            document = document.add(text(left + width * share, h + 26.0, words, "soft", "middle"));
        }
        Ok(document)
    }
}

/// The chart pixel nearest to a position, among the four around it: another view leaves out single ones.
fn nearest(at: &Point2<f64>, known: &HashMap<[u16; 2], usize>) -> Option<usize> {
    let whole = |x: f64| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range is checked")]
        (x >= 0.0 && x <= f64::from(u16::MAX)).then_some(x as u16)
    };
    let around =
        [at.x.floor(), at.x.ceil()].into_iter().flat_map(|u| [at.y.floor(), at.y.ceil()].map(|v| (u, v)));
    let found = around.filter_map(|(u, v)| {
        let i = *known.get(&[whole(u)?, whole(v)?])?;
        Some(((u - at.x).hypot(v - at.y), i))
    });
    found.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, i)| i)
}

fn round(v: f64) -> f64 {
    (v * 100.0).round() / 100.0
}

fn channel(v: f64) -> u8 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
    let byte = v.round().clamp(0.0, 255.0) as u8;
    byte
}

/// Colour of a weight.
fn colour(weight: f64) -> [u8; 3] {
    let at = weight.clamp(0.0, 1.0) * 4.0;
    let below = (0..4).rev().find(|&k| f64::from(k) <= at).unwrap_or(0);
    let (share, k) = (at - f64::from(below), usize::try_from(below).unwrap_or(0));
    std::array::from_fn(|c| channel(COLOURS[k][c] + share * (COLOURS[k + 1][c] - COLOURS[k][c])))
}

fn embedded(png: &[u8], width: f64, height: f64) -> Image {
    Image::new().set("href", data_uri("image/png", png)).set("width", width).set("height", height)
}

/// A file as part of another.
pub(super) fn data_uri(kind: &str, bytes: &[u8]) -> String {
    format!("data:{kind};base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}
