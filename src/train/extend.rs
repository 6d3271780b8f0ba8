//! More views for a trained model, from frames that were tracked with it.
//!
//! What the model knows already stays as it is, so poses that came from it cannot drag it along: new charts are added for
//! triangles without one, and replace old ones only where they see the triangle much better.

use super::assign::{self, Sight};
use super::{TrainOptions, TrainingImage, build_levels, check_image, index};
use crate::error::{Error, Result};
use crate::model::weights::edge_weights;
use crate::model::{Chart, LevelTemplate, Model, Pixels, View};

/// A new chart replaces an old one if its view sees the triangle this much better.
const MUCH_BETTER: f64 = 1.5;

/// Adds charts from more posed images. The shape stays; new charts know no appearance modes.
///
/// # Errors
/// [`Error::Invalid`] for unusable images, or when they add nothing.
pub fn extend(model: &Model, images: &[TrainingImage], options: &TrainOptions) -> Result<Model> {
    let options = TrainOptions { levels: model.levels.len(), modes: 0, ..options.clone() };
    options.check(images.len())?;
    for (i, image) in images.iter().enumerate() {
        check_image(i, image)?;
    }
    let shape = &model.shape;
    let new_views: Vec<View> =
        images.iter().map(|i| View { camera: i.camera, camera_from_object: i.camera_from_object }).collect();
    let sight = Sight::new(shape, &new_views);
    let known = known_quality(model);
    let chosen = assign::choose_views_where(shape, &sight, |t, quality| quality > MUCH_BETTER * known[t]);
    if chosen.iter().all(Option::is_none) {
        let problem = "the images show nothing that the model does not know as well";
        return Err(Error::invalid("extension", problem, "give frames from other sides or from nearer"));
    }
    let built = build_levels(shape, &new_views, &sight, &chosen, images, &options);
    let views: Vec<View> = model.views.iter().chain(&new_views).copied().collect();
    let first_new = index(model.views.len());
    let mut levels = Vec::with_capacity(built.len());
    for (level, (old, (pixels, charts))) in model.levels.iter().zip(built).enumerate() {
        let (pixels, charts) = join(old, &pixels, &charts, first_new, options.edge_weights);
        levels.push(LevelTemplate::new(shape, &views, level, pixels, charts)?);
    }
    let (object_id, calibration) = (model.object_id, model.calibration);
    Ok(Model { object_id, shape: shape.clone(), views, levels, calibration })
}

/// How well the model's own reference views see their triangles; 0 without a chart.
fn known_quality(model: &Model) -> Vec<f64> {
    let by_view: Vec<Vec<f64>> = model.views.iter().map(|v| assign::qualities(&model.shape, v)).collect();
    let quality =
        |(t, chart): (usize, &Chart)| if chart.is_empty() { 0.0 } else { by_view[chart.view as usize][t] };
    model.levels[0].charts.iter().enumerate().map(quality).collect()
}

/// The new charts where there are any, the old ones elsewhere.
fn join(
    old: &LevelTemplate,
    new: &Pixels,
    new_charts: &[Chart],
    first_new: u32,
    weighted: bool,
) -> (Pixels, Vec<Chart>) {
    let mut pixels = Pixels { modes: vec![Vec::new(); old.pixels.modes.len()], ..Pixels::default() };
    let mut charts = Vec::with_capacity(new_charts.len());
    for (old_chart, new_chart) in old.charts.iter().zip(new_charts) {
        let start = index(pixels.len());
        let (chart, source) = if new_chart.is_empty() {
            (*old_chart, &old.pixels)
        } else {
            (Chart { view: new_chart.view + first_new, ..*new_chart }, new)
        };
        append(&mut pixels, source, chart.range());
        charts.push(Chart { start, end: index(pixels.len()), ..chart });
    }
    pixels.weight = if weighted { edge_weights(&pixels.gradient) } else { vec![1.0; pixels.len()] };
    (pixels, charts)
}

fn append(to: &mut Pixels, from: &Pixels, range: std::ops::Range<usize>) {
    to.position.extend_from_slice(&from.position[range.clone()]);
    to.gradient.extend_from_slice(&from.gradient[range.clone()]);
    to.intensity.extend_from_slice(&from.intensity[range.clone()]);
    for (k, column) in to.modes.iter_mut().enumerate() {
        match from.modes.get(k) {
            Some(mode) => column.extend_from_slice(&mode[range.clone()]),
            None => column.extend(std::iter::repeat_n(0.0, range.len())),
        }
    }
}
