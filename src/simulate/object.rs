//! The two standard objects: an open relief of landmarks and a closed box, both with printed surfaces.

use nalgebra::{Point2, Point3, Vector3};

use super::paint::{Style, paint};
use super::random::{Purpose, Stream};
use super::texture::Texture;
use crate::geometry::TriangleMesh;
use crate::geometry::mesh::delaunay;

/// Bitmap resolution of every object, texels per millimetre.
const TEXELS_PER_MM: f64 = 4.0;

/// Width and height of the relief, millimetres.
const RELIEF_MM: [f64; 2] = [220.0, 170.0];

/// Landmarks along the width and the height of the relief; the four corners are missing.
const RELIEF_GRID: [usize; 2] = [10, 8];

/// Largest distance of a landmark from the relief's middle plane, millimetres.
const RELIEF_HEIGHT_MM: f64 = 12.0;

/// Size of the box along x, y and z, millimetres.
const BOX_MM: [f64; 3] = [165.0, 68.0, 80.0];

/// What one triangle shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Index into [`TexturedMesh::textures`].
    pub texture: usize,
    /// Position of the triangle's corners in that bitmap, texels.
    pub corners: [Point2<f64>; 3],
}

/// An object to render: its mesh is exactly what is seen.
#[derive(Debug, Clone, PartialEq)]
pub struct TexturedMesh {
    /// Geometry in the object frame, metres.
    pub mesh: TriangleMesh,
    /// One per triangle.
    pub patches: Vec<Patch>,
    /// The bitmaps.
    pub textures: Vec<Texture>,
}

/// A relief of 76 landmarks over 220 x 170 mm, about 12 mm high and deep, whose front looks along -z of its frame.
///
/// The geometry is the same for every seed, so that its creases (below 45 degrees) are known; the seed
/// changes the print.
pub fn relief(seed: u64) -> TexturedMesh {
    let plan = relief_plan();
    let vertices = plan.iter().zip(relief_heights(&plan)).map(|(p, z)| millimetres(p.x, p.y, z)).collect();
    let triangles = delaunay(&plan, 1.0).expect("a jittered grid can be triangulated");
    // Clockwise on screen is counter-clockwise seen from -z, once turned round.
    let triangles: Vec<[u32; 3]> = triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect();
    let texel = |k: u32| {
        let p = plan[k as usize];
        texel_of(p.x + RELIEF_MM[0] / 2.0, p.y + RELIEF_MM[1] / 2.0)
    };
    let patches = triangles.iter().map(|t| Patch { texture: 0, corners: t.map(texel) }).collect();
    let style = Style {
        size: RELIEF_MM,
        texels_per_unit: TEXELS_PER_MM,
        base: 122.0,
        grain: 22.0,
        panels: 10,
        discs: 14,
        rows: 8,
        letter: 9.0,
        softness: 1.0,
        framed: true,
    };
    let texture = paint(&style, &mut Stream::new(seed, Purpose::Surface, 0));
    TexturedMesh { mesh: TriangleMesh { vertices, triangles }, patches, textures: vec![texture] }
}

/// Landmarks of the relief seen along z, millimetres about the middle.
fn relief_plan() -> Vec<Point2<f64>> {
    let mut random = Stream::new(0, Purpose::Shape, 0);
    let [columns, rows] = RELIEF_GRID;
    let place = |k: usize, count: usize, size: f64| size * (k as f64 / (count - 1) as f64 - 0.5);
    let mut plan = Vec::new();
    for j in 0..rows {
        for i in 0..columns {
            let at_side = [i == 0 || i == columns - 1, j == 0 || j == rows - 1];
            let jitter = [random.range(-5.0, 5.0), random.range(-5.0, 5.0)];
            if at_side == [true, true] {
                continue;
            }
            // Rim points move along the rim only: the outline stays convex and without slivers.
            let [dx, dy] = [0, 1].map(|axis| if at_side[axis] { 0.0 } else { jitter[axis] });
            plan.push(Point2::new(
                on_grid(place(i, columns, RELIEF_MM[0]) + dx),
                on_grid(place(j, rows, RELIEF_MM[1]) + dy),
            ));
        }
    }
    plan
}

/// z of every landmark, millimetres: long waves and a little jitter, scaled to the full height.
fn relief_heights(plan: &[Point2<f64>]) -> Vec<f64> {
    let mut random = Stream::new(0, Purpose::Shape, 1);
    let wave = |p: &Point2<f64>| {
        libm::sin(0.041 * p.x + 0.016 * p.y + 0.6) + 0.9 * libm::sin(0.036 * p.y - 0.02 * p.x + 2.1)
            - 0.5 * libm::cos(0.05 * (p.x - p.y))
    };
    let raw: Vec<f64> = plan.iter().map(|p| wave(p) + random.range(-0.2, 0.2)).collect();
    let (lo, hi) = raw.iter().fold((raw[0], raw[0]), |(lo, hi), &z| (z.min(lo), z.max(hi)));
    let scale = 2.0 * RELIEF_HEIGHT_MM / (hi - lo);
    raw.iter().map(|z| on_grid((z - (lo + hi) / 2.0) * scale)).collect()
}

/// A closed box of 165 x 68 x 80 mm about the origin, every face with a print of its own; y is its vertical axis.
pub fn textured_box(seed: u64) -> TexturedMesh {
    let half = BOX_MM.map(|s| s / 2.0);
    let corner = |k: usize| {
        let sign = |bit: usize| if k >> bit & 1 == 1 { 1.0 } else { -1.0 };
        millimetres(sign(0) * half[0], sign(1) * half[1], sign(2) * half[2])
    };
    let mut object = TexturedMesh {
        mesh: TriangleMesh { vertices: (0..8).map(corner).collect(), triangles: Vec::new() },
        patches: Vec::new(),
        textures: Vec::new(),
    };
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    // Outward normal and "down" of the print on it.
    let sides = [(-z, y), (x, y), (-y, -z), (z, y), (-x, y), (y, z)];
    let bases = [150.0, 105.0, 135.0, 120.0, 140.0, 112.0];
    for (((normal, down), base), index) in sides.into_iter().zip(bases).zip(1_u64..) {
        let right = normal.cross(&down);
        let size = [right, down].map(|axis| axis.abs().dot(&Vector3::from(BOX_MM)));
        let quad = [-right - down, -right + down, right + down, right - down].map(|d| normal + d);
        let vertex =
            |d: Vector3<f64>| u32::from(d.x > 0.0) | u32::from(d.y > 0.0) << 1 | u32::from(d.z > 0.0) << 2;
        let texels =
            [(0.0, 0.0), (0.0, size[1]), (size[0], size[1]), (size[0], 0.0)].map(|(a, b)| texel_of(a, b));
        for pick in [[0, 1, 2], [0, 2, 3]] {
            object.mesh.triangles.push(pick.map(|k: usize| vertex(quad[k])));
            object.patches.push(Patch { texture: object.textures.len(), corners: pick.map(|k| texels[k]) });
        }
        object.textures.push(paint(&box_style(size, base), &mut Stream::new(seed, Purpose::Surface, index)));
    }
    object
}

fn box_style(size: [f64; 2], base: f64) -> Style {
    Style {
        size,
        texels_per_unit: TEXELS_PER_MM,
        base,
        grain: 19.0,
        panels: 4,
        discs: 4,
        rows: 4,
        letter: 8.0,
        softness: 1.05,
        framed: true,
    }
}

/// Rounds millimetres to 1/1024, which single-precision files hold exactly.
fn on_grid(mm: f64) -> f64 {
    (mm * 1024.0).round() / 1024.0
}

fn millimetres(x: f64, y: f64, z: f64) -> Point3<f64> {
    Point3::new(x / 1000.0, y / 1000.0, z / 1000.0)
}

/// Texel position of a surface position in millimetres from the bitmap's upper left corner.
fn texel_of(x: f64, y: f64) -> Point2<f64> {
    Point2::new(x * TEXELS_PER_MM - 0.5, y * TEXELS_PER_MM - 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Angles between the normals of neighbouring triangles, degrees.
    fn dihedrals(mesh: &TriangleMesh) -> Vec<f64> {
        let mut angles = Vec::new();
        for (i, a) in mesh.triangles.iter().enumerate() {
            for (j, b) in mesh.triangles.iter().enumerate().skip(i + 1) {
                if a.iter().filter(|k| b.contains(k)).count() == 2 {
                    angles.push(mesh.normal(i).angle(&mesh.normal(j)).to_degrees());
                }
            }
        }
        angles
    }

    #[test]
    fn relief_is_deep_but_without_creases() {
        let object = relief(1);
        let mesh = &object.mesh;
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (76, 122), "landmarks and triangles");
        let (lo, hi) = mesh.bounds();
        assert!((hi.z - lo.z - 0.024).abs() < 1e-5, "{} m deep", hi.z - lo.z);
        assert!((hi.x - lo.x - 0.22).abs() < 1e-9 && (hi.y - lo.y - 0.17).abs() < 1e-9, "{lo} to {hi}");
        let angles = dihedrals(mesh);
        let largest = angles.iter().copied().fold(0.0, f64::max);
        assert!(largest > 15.0 && largest < 45.0, "largest dihedral {largest:.2} degrees");
        assert_eq!(mesh.faces(50_f64.to_radians()).borders.len(), 1, "one smooth face");
        assert!((0..122).all(|t| mesh.normal(t).z < 0.0), "the front looks along -z");
        assert_eq!(object.patches.len(), 122, "one patch per triangle");
    }

    #[test]
    fn box_is_closed_and_outward() {
        let object = textured_box(1);
        let mesh = &object.mesh;
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8, 12), "box");
        for t in 0..12 {
            let [a, b, c] = mesh.corners(t);
            let middle = (a.coords + b.coords + c.coords) / 3.0;
            assert!(mesh.normal(t).dot(&middle) > 0.0, "triangle {t} looks inward");
        }
        let volume: f64 = (0..12).map(|t| mesh.normal(t).dot(&mesh.corners(t)[0].coords) / 6.0).sum();
        assert!((volume - 0.165 * 0.068 * 0.080).abs() < 1e-12, "volume {volume}");
        assert!((1..6).all(|k| object.textures[k] != object.textures[0]), "every face differs");
    }

    #[test]
    fn texture_coordinates_are_metric() {
        for object in [relief(2), textured_box(2)] {
            for (t, patch) in object.patches.iter().enumerate() {
                let [p, q] = [object.mesh.corners(t)[0], object.mesh.corners(t)[1]];
                let texels = (patch.corners[1] - patch.corners[0]).norm();
                let expected = (q - p).norm() * 1000.0 * TEXELS_PER_MM;
                // The relief is printed from the front: slopes stretch its print by up to 1 / cos(slope).
                assert!(texels <= expected + 1e-6 && texels > 0.7 * expected, "triangle {t}: {texels}");
            }
        }
    }
}
