//! What every training image shows at every chart pixel, brought to the light of the reference view.

use std::collections::BTreeMap;

use nalgebra::Point2;

use super::assign::Sight;
use super::canvas::LevelCharts;
use crate::geometry::warp;
use crate::imaging::Pyramid;
use crate::imaging::sample::bilinear;
use crate::model::{ChartGeometry, Shape, View};

/// Template pixels at or above this grey level carry no information and are left out.
pub(super) const SATURATED: f64 = 254.0;

/// Grey levels per image and chart pixel; `None` where the image does not see it.
#[derive(Debug)]
pub(super) struct LevelSamples {
    values: Vec<Vec<Option<f64>>>,
}

/// Gain and bias per (image, reference view, face): value = gain * template + bias.
pub(super) type Photometry = BTreeMap<(usize, u32, u32), (f64, f64)>;

impl LevelSamples {
    /// Warps every chart pixel into every image that sees its triangle. The reference view itself is read without
    /// interpolation.
    pub(super) fn take(
        shape: &Shape,
        views: &[View],
        sight: &Sight,
        charts: &LevelCharts,
        pyramids: &[Pyramid],
        level: usize,
    ) -> Self {
        let mut values = vec![vec![None; charts.pixels.len()]; pyramids.len()];
        for (triangle, members) in charts.by_triangle.iter().enumerate() {
            let Some(reference) = charts.view_of_triangle[triangle] else { continue };
            let view = &views[reference as usize];
            let Some(geometry) = ChartGeometry::new(shape, triangle, view, level, [0, 0]) else { continue };
            for (image, pyramid) in
                pyramids.iter().enumerate().filter(|(i, _)| sight.quality(*i, triangle) > 0.0)
            {
                let camera = views[image].camera.at_level(level);
                let warp =
                    warp::homography(&camera, &views[image].camera_from_object, &geometry.object_from_chart);
                for &p in members {
                    let [u, v] = charts.pixels[p].position;
                    values[image][p] = if image == reference as usize {
                        Some(f64::from(pyramid.level(level).get_pixel(u, v)[0]))
                    } else {
                        warp::apply(&warp, &Point2::new(f64::from(u), f64::from(v)))
                            .and_then(|w| bilinear(pyramid.level(level), w.x, w.y))
                    };
                }
            }
        }
        Self { values }
    }

    /// Least-squares gain and bias of every image against the reference view, per face.
    pub(super) fn photometry(&self, charts: &LevelCharts) -> Photometry {
        let mut sums: BTreeMap<(usize, u32, u32), [f64; 5]> = BTreeMap::new();
        self.for_each_pair(charts, |key, reference, value| {
            let s = sums.entry(key).or_default();
            let terms = [1.0, reference, value, reference * reference, reference * value];
            s.iter_mut().zip(terms).for_each(|(s, t)| *s += t);
        });
        let fit = |[n, x, y, xx, xy]: [f64; 5]| {
            let variance = xx - x * x / n;
            // A flat face says nothing about the gain.
            let gain = if variance > n { (xy - x * y / n) / variance } else { 1.0 };
            (gain, (y - gain * x) / n)
        };
        sums.into_iter().map(|(key, s)| (key, fit(s))).collect()
    }

    /// Removes gain and bias: value becomes (value - bias) / gain. Images whose gain is not believable are dropped
    /// for that face.
    pub(super) fn normalise(&mut self, charts: &LevelCharts, photometry: &Photometry) {
        for (triangle, members) in charts.by_triangle.iter().enumerate() {
            let Some(reference) = charts.view_of_triangle[triangle] else { continue };
            for (image, values) in
                self.values.iter_mut().enumerate().filter(|(i, _)| *i != reference as usize)
            {
                let Some(&(gain, bias)) =
                    photometry.get(&(image, reference, charts.face_of_triangle[triangle]))
                else {
                    continue;
                };
                for &p in members {
                    values[p] = values[p].filter(|_| (0.2..5.0).contains(&gain)).map(|v| (v - bias) / gain);
                }
            }
        }
    }

    /// Mean over the images that see the triangle nearly as well as the best one does.
    pub(super) fn mean(&self, charts: &LevelCharts, sight: &Sight, quality: f64) -> Vec<f64> {
        let mut mean = vec![0.0; charts.pixels.len()];
        for (triangle, members) in charts.by_triangle.iter().enumerate() {
            let Some(reference) = charts.view_of_triangle[triangle] else { continue };
            let limit = quality * sight.quality(reference as usize, triangle);
            let images: Vec<usize> =
                (0..self.values.len()).filter(|&i| sight.quality(i, triangle) >= limit).collect();
            for &p in members {
                let (mut sum, mut n) = (0.0, 0.0);
                for value in images.iter().filter_map(|&i| self.values[i][p]) {
                    sum += value;
                    n += 1.0;
                }
                mean[p] = if n > 0.0 { sum / n } else { 0.0 };
            }
        }
        mean
    }

    /// Value minus mean per image; zero (the mean) where the image does not see the pixel.
    pub(super) fn residuals(&self, mean: &[f64]) -> Vec<Vec<f64>> {
        let image = |values: &Vec<Option<f64>>| {
            values.iter().zip(mean).map(|(v, m)| v.map_or(0.0, |v| v - m)).collect()
        };
        self.values.iter().map(image).collect()
    }

    /// Calls `f((image, view, face), reference value, image value)` for every pixel that both see unsaturated.
    fn for_each_pair(&self, charts: &LevelCharts, mut f: impl FnMut((usize, u32, u32), f64, f64)) {
        for (triangle, members) in charts.by_triangle.iter().enumerate() {
            let Some(reference) = charts.view_of_triangle[triangle] else { continue };
            for &p in members {
                let Some(r) = self.values[reference as usize][p].filter(|r| *r < SATURATED) else { continue };
                for (image, values) in self.values.iter().enumerate() {
                    if let Some(v) = values[p].filter(|v| *v < SATURATED) {
                        f((image, reference, charts.face_of_triangle[triangle]), r, v);
                    }
                }
            }
        }
    }
}
