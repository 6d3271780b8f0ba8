//! Texture corners (Shi and Tomasi, "Good features to track", CVPR 1994) and their partners in a stereo image: clicks
//! without a person.

use image::GrayImage;
use nalgebra::{Point2, Point3, Vector2, Vector4};

use super::sample::bilinear;
use crate::geometry::StereoRig;

/// Half the side of the window of the structure tensor, pixels.
const TENSOR_RADIUS: i64 = 3;
/// Half the side of the patches that are compared, pixels.
const PATCH_RADIUS: i64 = 8;
/// Partners must correlate at least this well.
const MIN_CORRELATION: f64 = 0.9;
/// Step along the epipolar line, pixels.
const SEARCH_STEP_PX: f64 = 0.5;

/// The strongest corners, at most `count`, at least `spacing` pixels apart, strongest first; `accept` says where.
pub fn corners(
    image: &GrayImage,
    count: usize,
    spacing: f64,
    accept: impl Fn(&Point2<f64>) -> bool,
) -> Vec<Point2<f64>> {
    let (w, h) = (i64::from(image.width()), i64::from(image.height()));
    let border = PATCH_RADIUS + TENSOR_RADIUS + 2;
    let mut found: Vec<(f64, Point2<f64>)> = Vec::new();
    for v in border..h - border {
        for u in border..w - border {
            #[expect(clippy::cast_precision_loss, reason = "pixel numbers are small")]
            let p = Point2::new(u as f64, v as f64);
            if accept(&p) {
                found.push((strength(image, u, v), p));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<Point2<f64>> = Vec::new();
    for (strength, p) in found {
        if kept.len() == count || strength <= 0.0 {
            break;
        }
        if kept.iter().all(|k| (k - p).norm() >= spacing) {
            kept.push(p);
        }
    }
    kept
}

/// Smaller eigenvalue of the structure tensor.
fn strength(image: &GrayImage, u: i64, v: i64) -> f64 {
    let grey = |u: i64, v: i64| match (u32::try_from(u), u32::try_from(v)) {
        (Ok(u), Ok(v)) => f64::from(image.get_pixel(u, v)[0]),
        _ => 0.0,
    };
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for j in v - TENSOR_RADIUS..=v + TENSOR_RADIUS {
        for i in u - TENSOR_RADIUS..=u + TENSOR_RADIUS {
            let (x, y) = (grey(i + 1, j) - grey(i - 1, j), grey(i, j + 1) - grey(i, j - 1));
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        }
    }
    let middle = (xx + yy) / 2.0;
    middle - ((xx - yy) * (xx - yy) / 4.0 + xy * xy).sqrt()
}

/// The pixel of the right image that shows what the left one shows around `left`: best correlation along the epipolar
/// line between two depths (metres), then to a fraction of a pixel in both directions, the surface's slope included. `None` if nothing correlates
/// well or the best place is at the end of the search.
pub fn partner(
    rig: &StereoRig,
    images: [&GrayImage; 2],
    left: &Point2<f64>,
    depths: [f64; 2],
) -> Option<Point2<f64>> {
    let at = |pixel: &Point2<f64>, depth: f64| {
        let x = Point3::from(rig.left.ray(pixel)? * depth);
        rig.right.project(&rig.right_from_left.transform_point(&x))
    };
    let length = (at(left, depths[0])? - at(left, depths[1])?).norm();
    let steps = (1..).take_while(|k| f64::from(*k) * SEARCH_STEP_PX < length);
    // Shift along u and v (pixels) and slope of the surface along u and v (change of inverse depth per pixel).
    let shown = |p: &Point2<f64>, depth: f64, by: &Vector4<f64>| {
        let inverse = 1.0 / depth + (p.x - left.x) * by.z + (p.y - left.y) * by.w;
        Some(at(p, 1.0 / inverse)? + Vector2::new(by.x, by.y))
    };
    let score = |depth: f64, by: &Vector4<f64>| correlation(images, left, |p| shown(p, depth, by));
    let mut best: Option<(f64, f64)> = None;
    for k in steps {
        let share = f64::from(k) * SEARCH_STEP_PX / length;
        let depth = 1.0 / ((1.0 - share) / depths[0] + share / depths[1]);
        let here = score(depth, &Vector4::zeros());
        if let Some(here) = here.filter(|s| best.is_none_or(|(b, _)| *s > b)) {
            best = Some((here, depth));
        }
    }
    let (_, depth) = best.filter(|(score, _)| *score > MIN_CORRELATION - 0.1)?;
    // A step moves the patch, or its border, by half a pixel.
    #[expect(clippy::cast_precision_loss, reason = "a small number")]
    let slope = 0.5 / PATCH_RADIUS as f64 * (1.0 / depths[0] - 1.0 / depths[1]).abs() / length;
    let steps = Vector4::new(0.5, 0.5, slope, slope);
    let mut by = Vector4::zeros();
    for _ in 0..8 {
        for axis in 0..4 {
            let mut step = Vector4::zeros();
            step[axis] = steps[axis];
            let (before, here, after) =
                (score(depth, &(by - step))?, score(depth, &by)?, score(depth, &(by + step))?);
            let bend = before - 2.0 * here + after;
            if bend < 0.0 {
                by += step * (0.5 * (before - after) / bend).clamp(-1.0, 1.0);
            }
        }
    }
    let shift = Vector2::new(by.x, by.y).norm();
    (score(depth, &by)? > MIN_CORRELATION && shift < 3.0).then(|| shown(left, depth, &by)).flatten()
}

/// Normalised correlation of the patch around `left` with its image under `warp`.
fn correlation(
    images: [&GrayImage; 2],
    left: &Point2<f64>,
    warp: impl Fn(&Point2<f64>) -> Option<Point2<f64>>,
) -> Option<f64> {
    let mut sums = [0.0; 6];
    for j in -PATCH_RADIUS..=PATCH_RADIUS {
        for i in -PATCH_RADIUS..=PATCH_RADIUS {
            #[expect(clippy::cast_precision_loss, reason = "pixel numbers are small")]
            let p = left + Vector2::new(i as f64, j as f64);
            let q = warp(&p)?;
            let (a, b) = (bilinear(images[0], p.x, p.y)?, bilinear(images[1], q.x, q.y)?);
            let terms = [1.0, a, b, a * a, b * b, a * b];
            sums.iter_mut().zip(terms).for_each(|(s, t)| *s += t);
        }
    }
    let [n, a, b, aa, bb, ab] = sums;
    let (va, vb) = (aa - a * a / n, bb - b * b / n);
    (va > 0.0 && vb > 0.0).then(|| (ab - a * b / n) / (va * vb).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Camera, Pose};
    use nalgebra::{Rotation3, Vector3};

    fn texture(u: f64, v: f64) -> u8 {
        let value = 128.0 + 50.0 * (0.21 * u).sin() * (0.17 * v).cos() + 40.0 * (0.13 * u + 0.19 * v).sin();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "38..218")]
        let byte = value as u8;
        byte
    }

    /// A plane at 0.5 m seen by two cameras.
    #[test]
    fn partners_agree_with_the_geometry() {
        let camera = Camera::pinhole(300.0, 300.0, 79.5, 59.5, 160, 120);
        let pose = Pose::new(Rotation3::new(Vector3::new(0.0, 0.1, 0.05)), Vector3::new(-0.05, 0.0, 0.0));
        let rig = StereoRig::new(camera, camera, pose).unwrap();
        let left = GrayImage::from_fn(160, 120, |u, v| image::Luma([texture(f64::from(u), f64::from(v))]));
        let right = GrayImage::from_fn(160, 120, |u, v| {
            let ray = camera.ray(&Point2::new(f64::from(u), f64::from(v))).unwrap();
            let (ray, from) = (pose.inverse().rotate(&ray), pose.inverse().translation());
            let x = from + ray * ((0.5 - from.z) / ray.z);
            let p = camera.project(&Point3::from(x)).unwrap();
            image::Luma([texture(p.x, p.y)])
        });
        let found = corners(&left, 30, 10.0, |p| p.x > 50.0);
        assert_eq!(found.len(), 30, "corners");
        assert!(found.iter().all(|p| p.x > 50.0), "only where accepted");
        let mut matched = 0;
        for p in &found {
            let Some(q) = partner(&rig, [&left, &right], p, [0.3, 0.9]) else { continue };
            let x = Point3::from(camera.ray(p).unwrap() * 0.5);
            let expected = camera.project(&pose.transform_point(&x)).unwrap();
            assert!((q - expected).norm() < 0.15, "{p}: {q} is not {expected}");
            matched += 1;
        }
        assert!(matched > 15, "{matched} partners");
    }
}
