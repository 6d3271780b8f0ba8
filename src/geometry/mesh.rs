//! Triangle meshes: Delaunay triangulation of landmarks, smooth faces and their borders, subdivision.

use std::collections::HashMap;

use nalgebra::{Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};
use spade::{DelaunayTriangulation, HasPosition, Triangulation};

use super::warp::double_area;
use crate::error::{Error, Result};

/// A triangle mesh in the object frame, metres; triangles wind counter-clockwise seen from outside.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TriangleMesh {
    /// Vertices, metres.
    pub vertices: Vec<Point3<f64>>,
    /// Indices of three vertices each.
    pub triangles: Vec<[u32; 3]>,
}

/// Smooth faces of a mesh: connected triangles without a crease between them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Faces {
    /// Face of every triangle.
    pub of_triangle: Vec<u32>,
    /// For every face the edges (metres) that separate it from other faces or from nothing.
    pub borders: Vec<Vec<[Point3<f64>; 2]>>,
}

impl TriangleMesh {
    /// Checks indices and numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an index out of range, a coordinate that is not finite, or no area at all.
    pub fn validate(&self) -> Result<()> {
        let n = self.vertices.len();
        if let Some(i) = self.vertices.iter().position(|v| v.iter().any(|c| !c.is_finite())) {
            return Err(Error::invalid("mesh", format!("vertex {i} is not finite"), "repair the mesh"));
        }
        if let Some(i) = self.triangles.iter().position(|t| t.iter().any(|&k| k as usize >= n)) {
            let problem = format!("triangle {i} refers to a vertex beyond the {n} present");
            return Err(Error::invalid("mesh", problem, "repair the mesh"));
        }
        if self.area() <= 0.0 {
            return Err(Error::invalid("mesh", "its area is zero", "give a mesh with faces"));
        }
        Ok(())
    }

    /// Corner points of a triangle, metres.
    pub fn corners(&self, triangle: usize) -> [Point3<f64>; 3] {
        self.triangles[triangle].map(|k| self.vertices[k as usize])
    }

    /// Surface area, square metres.
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|t| self.normal(t).norm() / 2.0).sum()
    }

    /// Outward normal of a triangle; its length is twice the area.
    pub fn normal(&self, triangle: usize) -> Vector3<f64> {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(&(c - a))
    }

    /// Smallest and largest corner of the axis-aligned bounding box, metres.
    pub fn bounds(&self) -> (Point3<f64>, Point3<f64>) {
        let first = self.vertices.first().copied().unwrap_or_default();
        self.vertices.iter().fold((first, first), |(lo, hi), v| (lo.inf(v), hi.sup(v)))
    }

    /// The mesh with vertices at equal positions merged and triangles without area removed.
    pub fn welded(&self) -> Self {
        let mut index = HashMap::new();
        let mut vertices = Vec::new();
        let remap: Vec<u32> = self
            .vertices
            .iter()
            .map(|v| {
                *index.entry([v.x.to_bits(), v.y.to_bits(), v.z.to_bits()]).or_insert_with(|| {
                    vertices.push(*v);
                    index_of(vertices.len() - 1)
                })
            })
            .collect();
        let triangles = self.triangles.iter().map(|t| t.map(|k| remap[k as usize]));
        let mut mesh = Self { vertices, triangles: triangles.collect() };
        let areas: Vec<f64> = (0..mesh.triangles.len()).map(|t| mesh.normal(t).norm()).collect();
        let limit = 1e-12 * areas.iter().copied().fold(0.0, f64::max);
        let mut keep = areas.iter().map(|&a| a > limit);
        mesh.triangles.retain(|_| keep.next().unwrap_or(false));
        mesh
    }

    /// Groups triangles into faces: neighbours belong together where their normals differ by less than
    /// `crease` radians.
    pub fn faces(&self, crease: f64) -> Faces {
        let mut edges: HashMap<[u32; 2], Vec<usize>> = HashMap::new();
        for (t, triangle) in self.triangles.iter().enumerate() {
            for edge in edges_of(triangle) {
                edges.entry(edge).or_default().push(t);
            }
        }
        let mut parent: Vec<usize> = (0..self.triangles.len()).collect();
        let smooth = |a: usize, b: usize| self.normal(a).angle(&self.normal(b)) < crease;
        for pair in edges.values().filter(|o| o.len() == 2 && smooth(o[0], o[1])) {
            let (a, b) = (root(&mut parent, pair[0]), root(&mut parent, pair[1]));
            parent[a.max(b)] = a.min(b);
        }
        let mut number = HashMap::new();
        let of_triangle: Vec<u32> = (0..self.triangles.len())
            .map(|t| {
                let next = index_of(number.len());
                *number.entry(root(&mut parent, t)).or_insert(next)
            })
            .collect();
        let mut borders = vec![Vec::new(); number.len()];
        for (t, triangle) in self.triangles.iter().enumerate() {
            for edge in edges_of(triangle) {
                let inner = edges[&edge].iter().filter(|&&o| of_triangle[o] == of_triangle[t]).count();
                if inner != 2 {
                    borders[of_triangle[t] as usize].push(edge.map(|k| self.vertices[k as usize]));
                }
            }
        }
        Faces { of_triangle, borders }
    }

    /// Splits every triangle by bisecting its longest edge until no edge is longer than `limit` in the measure
    /// `length`. Returns the pieces and the source triangle of each. Pieces stay in the plane of their source.
    pub fn subdivided(
        &self,
        limit: f64,
        length: impl Fn(&Point3<f64>, &Point3<f64>) -> f64,
    ) -> (Self, Vec<usize>) {
        let mut out = Self { vertices: self.vertices.clone(), triangles: Vec::new() };
        let mut source = Vec::new();
        let mut midpoints = HashMap::new();
        for (s, triangle) in self.triangles.iter().enumerate() {
            let mut stack = vec![*triangle];
            while let Some(t) = stack.pop() {
                let p = t.map(|k| out.vertices[k as usize]);
                let lengths = [length(&p[0], &p[1]), length(&p[1], &p[2]), length(&p[2], &p[0])];
                let longest = (0..3).fold(0, |best, e| if lengths[e] > lengths[best] { e } else { best });
                if lengths[longest] <= limit {
                    out.triangles.push(t);
                    source.push(s);
                    continue;
                }
                let (a, b, c) = (t[longest], t[(longest + 1) % 3], t[(longest + 2) % 3]);
                let m = *midpoints.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                    out.vertices.push(nalgebra::center(&out.vertices[a as usize], &out.vertices[b as usize]));
                    index_of(out.vertices.len() - 1)
                });
                stack.push([m, b, c]);
                stack.push([a, m, c]);
            }
        }
        (out, source)
    }
}

/// Delaunay triangulation of image points, all triangles clockwise on screen (positive [`double_area`]),
/// those with an area below `min_area` square pixels dropped.
///
/// # Errors
/// [`Error::Invalid`] for fewer than three points, equal or non-finite points, or points on one line.
pub fn delaunay(points: &[Point2<f64>], min_area: f64) -> Result<Vec<[u32; 3]>> {
    struct Site(spade::Point2<f64>, u32);
    impl HasPosition for Site {
        type Scalar = f64;
        fn position(&self) -> spade::Point2<f64> {
            self.0
        }
    }
    let mut triangulation = DelaunayTriangulation::<Site>::new();
    for (i, p) in points.iter().enumerate() {
        let before = triangulation.num_vertices();
        triangulation.insert(Site(spade::Point2::new(p.x, p.y), index_of(i))).map_err(|e| {
            Error::invalid(format!("landmark {i}"), e.to_string(), "give finite pixel coordinates")
        })?;
        if triangulation.num_vertices() == before {
            let problem = format!("it coincides with another landmark at ({}, {})", p.x, p.y);
            return Err(Error::invalid(format!("landmark {i}"), problem, "remove one of the two"));
        }
    }
    let triangles: Vec<[u32; 3]> = triangulation
        .inner_faces()
        .map(|face| face.vertices().map(|v| v.data().1))
        .map(|[a, b, c]| {
            if double_area(&[points[a as usize], points[b as usize], points[c as usize]]) > 0.0 {
                [a, b, c]
            } else {
                [a, c, b]
            }
        })
        .filter(|t| double_area(&t.map(|k| points[k as usize])) >= 2.0 * min_area)
        .collect();
    if triangles.is_empty() {
        let problem = format!("{} points span no triangle", points.len());
        return Err(Error::invalid("landmarks", problem, "give at least three that are not on one line"));
    }
    Ok(triangles)
}

/// Converts an index to the 32 bits it is stored in.
fn index_of(i: usize) -> u32 {
    u32::try_from(i).expect("meshes have fewer than 2^32 vertices and triangles")
}

fn edges_of(t: &[u32; 3]) -> [[u32; 2]; 3] {
    [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]].map(|[a, b]| [a.min(b), a.max(b)])
}

fn root(parent: &mut [usize], mut i: usize) -> usize {
    while parent[i] != i {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    i
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box of 12 triangles with three vertices of its own per triangle, as many PLY files have.
    fn unwelded_box() -> TriangleMesh {
        let corner =
            |k: usize| Point3::new((k & 1) as f64 * 0.1, (k >> 1 & 1) as f64 * 0.06, (k >> 2) as f64 * 0.08);
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let mut mesh = TriangleMesh::default();
        for q in quads {
            for t in [[q[0], q[1], q[2]], [q[0], q[2], q[3]]] {
                let first = index_of(mesh.vertices.len());
                mesh.vertices.extend(t.map(corner));
                mesh.triangles.push([first, first + 1, first + 2]);
            }
        }
        mesh
    }

    #[test]
    fn a_box_has_six_faces_with_four_border_edges_each() {
        let mesh = unwelded_box().welded();
        assert_eq!(mesh.vertices.len(), 8, "vertices merge");
        let faces = mesh.faces(0.8);
        assert_eq!(faces.borders.len(), 6, "six faces");
        assert!(faces.borders.iter().all(|b| b.len() == 4), "{:?}", faces.borders);
    }

    #[test]
    fn subdivision_keeps_the_area_and_respects_the_limit() {
        let mesh = unwelded_box().welded();
        let (fine, source) = mesh.subdivided(0.02, |a, b| (b - a).norm());
        assert!((fine.area() - mesh.area()).abs() < 1e-12, "{} is not {}", fine.area(), mesh.area());
        assert_eq!(source.len(), fine.triangles.len(), "one source per piece");
        for (t, &source) in source.iter().enumerate() {
            let [a, b, c] = fine.corners(t);
            assert!([b - a, c - b, a - c].iter().all(|e| e.norm() <= 0.02), "triangle {t}");
            assert!(fine.normal(t).angle(&mesh.normal(source)) < 1e-6, "triangle {t} turned");
        }
    }

    #[test]
    fn delaunay_is_oriented_and_drops_slivers() {
        let p = |x, y| Point2::new(x, y);
        let points =
            [p(0.0, 0.0), p(100.0, 0.0), p(100.0, 100.0), p(0.0, 100.0), p(50.0, 50.0), p(50.0, 100.1)];
        let triangles = delaunay(&points, 40.0).expect("a triangulation");
        for t in &triangles {
            assert!(double_area(&t.map(|k| points[k as usize])) >= 80.0, "{t:?}");
        }
        assert_eq!(triangles.len(), 5, "{triangles:?}");
    }

    #[test]
    fn hopeless_landmarks_are_refused() {
        let line: Vec<_> = (0..5).map(|i| Point2::new(f64::from(i), 2.0 * f64::from(i))).collect();
        assert!(delaunay(&line, 0.0).is_err(), "collinear");
        let twice =
            [Point2::new(0.0, 0.0), Point2::new(1.0, 0.0), Point2::new(0.0, 0.0), Point2::new(0.0, 1.0)];
        assert!(delaunay(&twice, 0.0).unwrap_err().to_string().contains("landmark 2"), "coincident");
        assert!(delaunay(&[Point2::new(f64::NAN, 0.0)], 0.0).is_err(), "NaN");
    }

    #[test]
    fn bad_meshes_are_refused() {
        let mut mesh = unwelded_box();
        mesh.triangles[3][1] = 999;
        assert!(mesh.validate().is_err(), "index out of range");
        let mut mesh = unwelded_box();
        mesh.vertices.iter_mut().for_each(|v| v.z = 0.0);
        mesh.vertices.iter_mut().for_each(|v| v.y = 0.0);
        assert!(mesh.validate().is_err(), "no area");
    }
}
