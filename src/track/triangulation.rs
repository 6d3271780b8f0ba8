//! Which triangles the landmarks span, by what the training images say.
//!
//! Delaunay's triangulation knows nothing of the surface: of the two diagonals of four landmarks it takes the shorter
//! one in the image, and between landmarks of the outline it spans what may be air. An image taken from another side
//! tells: where the surface is wrong, the images do not agree.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Point2;

use super::survey::Survey;
use crate::align::{TriangleFit, triangle_fits};
use crate::error::Result;
use crate::geometry::TriangleMesh;
use crate::geometry::warp::double_area;
use crate::train::TrainingImage;

/// The other diagonal must lower the squared residuals of its two triangles by this share.
const LOWER_COST: f64 = 0.01;
/// A triangle of the outline that is believed less than this, on average over the images that show it, is not there.
const LEAST_BELIEF: f64 = 0.75;
/// Triangles narrower than this are not made: twice the area over the square of the longest side.
const NARROWEST: f64 = 0.1;

/// The sums over all images that show a triangle.
#[derive(Debug, Clone, Copy, Default)]
struct Agreement {
    cost: f64,
    weight: f64,
    belief: f64,
    images: f64,
}

impl Agreement {
    fn add(&mut self, fit: &TriangleFit) {
        self.cost += fit.cost;
        self.weight += fit.weight;
        self.belief += fit.belief;
        self.images += 1.0;
    }
}

/// Takes the other diagonal where the images agree better with it, and leaves out triangles that are not there.
/// `reference` is the image in which the triangles were made. Returns how many changed.
///
/// # Errors
/// Those of [`crate::train::train`] and [`triangle_fits`].
pub(super) fn improve(mesh: &mut TriangleMesh, images: &[TrainingImage], reference: usize) -> Result<usize> {
    let view = &images[reference];
    let project = |x| view.camera.project(&view.camera_from_object.transform_point(x));
    let pixels: Vec<Point2<f64>> = mesh.vertices.iter().map(|x| project(x).unwrap_or_default()).collect();
    let before = agreements(mesh, images)?;
    let (mut open, mut better) = (flips(mesh, &pixels), Vec::new());
    while !open.is_empty() {
        let batch = independent(&mut open);
        let mut other = mesh.clone();
        batch.iter().for_each(|flip| flip.apply(&mut other));
        let after = agreements(&other, images)?;
        for flip in batch {
            let [old, new] = [&before, &after].map(|all| flip.mean_cost(all));
            if new < (1.0 - LOWER_COST) * old {
                better.push((old - new, flip));
            }
        }
    }
    // A wrong diagonal makes those beside it look wrong too, but less.
    better.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut better = better.into_iter().map(|(_, flip)| flip).collect();
    let chosen = independent(&mut better);
    chosen.iter().for_each(|flip| flip.apply(mesh));
    Ok(chosen.len() + trim(mesh, &agreements(mesh, images)?))
}

/// Leaves out triangles of the outline that are not there; returns how many.
fn trim(mesh: &mut TriangleMesh, agreements: &[Agreement]) -> usize {
    let sides = edges(mesh).into_values();
    let outline: BTreeSet<usize> = sides.filter(|s| s.len() == 1).map(|s| s[0].0).collect();
    let absent = |t: usize| {
        let Agreement { belief, images, .. } = agreements[t];
        outline.contains(&t) && belief < LEAST_BELIEF * images
    };
    let count = mesh.triangles.len();
    let mut there = (0..count).map(|t| !absent(t));
    mesh.triangles.retain(|_| there.next().unwrap_or(true));
    count - mesh.triangles.len()
}

/// How the images agree about every triangle of the mesh.
fn agreements(mesh: &TriangleMesh, images: &[TrainingImage]) -> Result<Vec<Agreement>> {
    let mut survey = Survey::new(mesh, images, false)?;
    let mut sums = vec![Agreement::default(); mesh.triangles.len()];
    for image in images {
        let fits = survey.look((&image.image, &image.camera), |backend, target| {
            triangle_fits(backend, target, &image.camera_from_object)
        })?;
        for (sum, fit) in sums.iter_mut().zip(fits) {
            fit.iter().for_each(|fit| sum.add(fit));
        }
    }
    Ok(sums)
}

/// Two triangles and the other way to divide their four corners.
#[derive(Debug, Clone)]
struct Flip {
    triangles: [usize; 2],
    after: [[u32; 3]; 2],
}

impl Flip {
    fn apply(&self, mesh: &mut TriangleMesh) {
        for (&t, corners) in self.triangles.iter().zip(self.after) {
            mesh.triangles[t] = corners;
        }
    }

    /// Mean squared residual of its triangles, grey levels squared.
    fn mean_cost(&self, agreements: &[Agreement]) -> f64 {
        let [a, b] = self.triangles.map(|t| agreements[t]);
        (a.cost + b.cost) / (a.weight + b.weight)
    }
}

/// The edges (smaller index first) with the triangles on both sides and their corners opposite.
fn edges(mesh: &TriangleMesh) -> BTreeMap<[u32; 2], Vec<(usize, u32)>> {
    let mut edges: BTreeMap<[u32; 2], Vec<(usize, u32)>> = BTreeMap::new();
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b, opposite) = (triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]);
            edges.entry([a.min(b), a.max(b)]).or_default().push((t, opposite));
        }
    }
    edges
}

/// All edges that have another diagonal beside them; four corners that are not convex in the image have none.
fn flips(mesh: &TriangleMesh, pixels: &[Point2<f64>]) -> Vec<Flip> {
    let flip = |sides: Vec<(usize, u32)>| {
        let [(t, c), (s, d)] = sides[..] else { return None };
        // The first triangle has the edge as a, b in its own sense.
        let k = mesh.triangles[t].iter().position(|v| *v == c)?;
        let (a, b) = (mesh.triangles[t][(k + 1) % 3], mesh.triangles[t][(k + 2) % 3]);
        let after = [[c, a, d], [d, b, c]];
        let sense = area(&mesh.triangles[t], pixels).signum();
        let wide = |t: &[u32; 3]| sense * area(t, pixels) > NARROWEST * longest(t, pixels).powi(2);
        after.iter().all(wide).then_some(Flip { triangles: [t, s], after })
    };
    edges(mesh).into_values().filter_map(flip).collect()
}

fn area(triangle: &[u32; 3], pixels: &[Point2<f64>]) -> f64 {
    double_area(&triangle.map(|k| pixels[k as usize]))
}

fn longest(triangle: &[u32; 3], pixels: &[Point2<f64>]) -> f64 {
    let [a, b, c] = triangle.map(|k| pixels[k as usize]);
    (a - b).norm().max((b - c).norm()).max((c - a).norm())
}

/// Takes flips out of `open` that share no triangle, the first ones first.
fn independent(open: &mut Vec<Flip>) -> Vec<Flip> {
    let mut taken = BTreeSet::new();
    open.extract_if(.., |flip| {
        let free = flip.triangles.iter().all(|t| !taken.contains(t));
        if free {
            taken.extend(flip.triangles);
        }
        free
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Camera, Pose};
    use crate::simulate::{Renderer, View, relief};
    use nalgebra::{Rotation3, Vector3, center};

    fn images() -> Vec<TrainingImage> {
        let camera = Camera::pinhole(400.0, 400.0, 159.5, 119.5, 320, 240);
        let renderer = Renderer::new(relief(1), camera).unwrap();
        let image = |k: u32| {
            let a = f64::from(k) * 2.4;
            let turn = Rotation3::new(Vector3::new(0.4 * a.cos(), 0.4 * a.sin(), 0.1));
            let camera_from_object = Pose::new(turn, Vector3::new(0.0, 0.0, 0.5));
            let image = renderer.render_view(&View { pose: camera_from_object, ..View::default() });
            TrainingImage { image, camera, camera_from_object }
        };
        (0..5).map(image).collect()
    }

    /// Of all diagonals the one whose change moves the surface most.
    fn most(mesh: &TriangleMesh, flips: Vec<Flip>) -> Flip {
        let gap = |flip: &Flip| {
            let [[c, a, d], [_, b, _]] = flip.after;
            let [a, b, c, d] = [a, b, c, d].map(|k| mesh.vertices[k as usize]);
            (center(&a, &b) - center(&c, &d)).z.abs()
        };
        flips.into_iter().max_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap()
    }

    #[test]
    fn a_wrong_diagonal_is_put_right() {
        let (images, truth) = (images(), relief(1).mesh);
        let view = &images[0];
        let pixel = |x| view.camera.project(&view.camera_from_object.transform_point(x)).unwrap();
        let pixels: Vec<Point2<f64>> = truth.vertices.iter().map(pixel).collect();
        let mut mesh = truth.clone();
        most(&truth, flips(&truth, &pixels)).apply(&mut mesh);
        let keys = |mesh: &TriangleMesh| edges(mesh).into_keys().collect::<BTreeSet<_>>();
        let wrong: Vec<[u32; 2]> = keys(&mesh).difference(&keys(&truth)).copied().collect();
        let right: Vec<[u32; 2]> = keys(&truth).difference(&keys(&mesh)).copied().collect();
        assert_eq!((wrong.len(), right.len()), (1, 1), "one is wrong");
        assert!(improve(&mut mesh, &images, 0).unwrap() >= 1, "changed");
        let found = keys(&mesh);
        assert!(!found.contains(&wrong[0]) && found.contains(&right[0]), "{wrong:?} instead of {right:?}");
        // Where the surface is flat it makes no difference.
        assert!(found.difference(&keys(&truth)).count() < 8, "the others stay, nearly all");
    }

    #[test]
    fn only_the_outline_is_trimmed() {
        let mut mesh = relief(1).mesh;
        let mut all =
            vec![Agreement { belief: 5.0, images: 5.0, ..Agreement::default() }; mesh.triangles.len()];
        let outer: BTreeSet<usize> = edges(&mesh).values().filter(|s| s.len() == 1).map(|s| s[0].0).collect();
        let inner = (0..all.len()).find(|t| !outer.contains(t)).unwrap();
        let rim = *outer.first().unwrap();
        (all[inner].belief, all[rim].belief) = (0.5, 3.0);
        let gone = mesh.triangles[rim];
        assert_eq!(trim(&mut mesh, &all), 1, "one triangle");
        assert!(!mesh.triangles.contains(&gone), "that of the outline");
    }
}
