//! Second implementation of `accumulate`: f32 in vectors as wide as the processor has, for speed.
//!
//! The twin `super::accumulate` says what is computed and is what this is tested against. Pixels of a triangle come
//! in blocks; sums over a block are f32, sums over blocks f64. Every row is added up by one thread in a fixed order, so
//! the same input gives the same bytes however many threads there are.

mod kernel;
mod locate;
mod pairs;
mod scan;
mod template;

use fearless_simd::{Level, Simd, dispatch};

pub(super) use pairs::Pairs;
pub(in crate::backend) use scan::FastScanner;
pub(super) use template::FastLevel;

use kernel::Scratch;
use locate::is_inside;
use template::Triangle;

use super::Instructions;
use crate::backend::local::{LocalWarp, to_origin};
use crate::backend::{Request, Sums};

/// Pixels per block: sums of so few terms lose nothing in f32, and all columns of a block stay in the first-level
/// cache.
const BLOCK: usize = 256;

/// The instructions to use, as the crate below wants them.
pub(super) fn level(instructions: Instructions) -> Level {
    let best = Level::new();
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    {
        let narrower = match instructions {
            Instructions::Best => None,
            Instructions::Avx2 => best.as_avx2().map(|avx2| avx2.level()),
            Instructions::Sse42 => best.as_sse4_2().map(|sse| sse.level()),
        };
        narrower.unwrap_or(best)
    }
    #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
    {
        // There is one set on each of the others.
        let _ = instructions;
        best
    }
}

/// Name of a set of instructions.
pub(super) fn name(level: Level) -> String {
    format!("{level:?}").split('(').next().unwrap_or_default().to_lowercase()
}

/// A run of triangles of a run of poses.
#[derive(Debug)]
pub(super) struct Tile<'a> {
    /// Poses and triangles of the request to add up; rows are pose by pose.
    pub(super) items: std::ops::Range<usize>,
    pub(super) triangles: std::ops::Range<usize>,
    pub(super) rows: &'a mut [f64],
}

/// Adds up the rows of a tile; all poses of a triangle while its pixels are in the cache.
pub(super) fn accumulate(
    level: Level,
    template: &FastLevel,
    request: &Request<'_>,
    image: &Pairs,
    tile: Tile<'_>,
) {
    let mut scratch = Scratch::default();
    let (all, modes, row_len) = (template.triangles.len(), template.modes, Sums::row_len(template.modes));
    for (i, t) in tile.triangles.clone().enumerate() {
        let triangle = &template.triangles[t];
        for (k, item) in tile.items.clone().enumerate() {
            let warp = &request.warps[item * all + t];
            if !warp.active {
                continue;
            }
            let local = LocalWarp::new(warp, triangle.centre);
            let appearance = &request.appearance[item * modes..][..modes];
            let row = &mut tile.rows[(k * tile.triangles.len() + i) * row_len..][..row_len];
            let call = Call { template, triangle, warp: &local, appearance, image };
            if is_inside(&local, triangle.reach, image) {
                dispatch!(level, simd => add_triangle::<_, true>(simd, &call, &mut scratch, row));
                row[7] += triangle.weight;
                row[8] += triangle.count();
            } else {
                dispatch!(level, simd => add_triangle::<_, false>(simd, &call, &mut scratch, row));
            }
            to_origin(&mut row[..6], triangle.centre);
        }
    }
}

/// One triangle at one pose.
struct Call<'a> {
    template: &'a FastLevel,
    triangle: &'a Triangle,
    warp: &'a LocalWarp,
    appearance: &'a [f32],
    image: &'a Pairs,
}

#[inline(always)]
fn add_triangle<S: Simd, const INSIDE: bool>(
    simd: S,
    call: &Call<'_>,
    scratch: &mut Scratch,
    row: &mut [f64],
) {
    let Call { template, triangle, warp, appearance, image } = call;
    for block in template.blocks(triangle) {
        kernel::add_block::<S, INSIDE>(simd, &block, warp, appearance, image, scratch, row);
    }
}
