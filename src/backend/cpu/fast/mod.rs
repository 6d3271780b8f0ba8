//! Second implementation of `accumulate` and `linearize`: f32 in vectors as wide as the processor has, for speed.
//!
//! The twins `super::accumulate` and `super::linearize` say what is computed and are what this is tested against. Pixels of a triangle come
//! in blocks; sums over a block are f32, sums over blocks f64. Every row is added up by one thread in a fixed order, so
//! the same input gives the same bytes however many threads there are.

mod accumulate;
mod kernel;
mod linearize;
mod locate;
mod pairs;
mod rendering;
mod scan;
mod template;

use std::ops::Range;

use fearless_simd::{Level, Simd, dispatch};

pub(super) use pairs::PairsPyramid;
pub(in crate::backend) use scan::FastScanner;
pub(super) use template::FastLevel;

use kernel::Scratch;
use linearize::LinearScratch;
use locate::{Place, window};
use pairs::{Pairs, Window};
use template::Triangle;

use super::Instructions;
use crate::backend::local::{LocalWarp, second_to_origin, to_origin};
use crate::backend::{Linearization, Request, Sums};

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

/// A run of triangles of a run of poses; their rows are pose by pose.
#[derive(Debug)]
pub(super) struct Tile {
    pub(super) items: Range<usize>,
    pub(super) triangles: Range<usize>,
}

/// What a request is about.
#[derive(Debug, Clone, Copy)]
pub(super) struct Work<'a> {
    pub(super) level: Level,
    pub(super) template: &'a FastLevel,
    pub(super) request: &'a Request<'a>,
    pub(super) image: Pairs<'a>,
}

/// One triangle at one pose.
struct Call<'a> {
    template: &'a FastLevel,
    triangle: &'a Triangle,
    warp: LocalWarp,
    appearance: &'a [f32],
    image: Pairs<'a>,
}

impl<'a> Call<'a> {
    #[inline(always)]
    fn window(&self) -> Option<Window<'a>> {
        window(&self.warp, self.triangle.reach, &self.image)
    }

    /// The sums of a chart that lies inside the image which do not depend on the pose.
    #[inline(always)]
    fn add_whole(&self, row: &mut [f64]) {
        row[7] += self.triangle.weight;
        row[8] += self.triangle.count();
    }
}

impl<'a> Work<'a> {
    /// Adds up the rows of a tile; all poses of a triangle while its pixels are in the cache.
    pub(super) fn accumulate(&self, tile: &Tile, rows: &mut [f64]) {
        dispatch!(self.level, simd => self.accumulate_by(simd, tile, rows));
    }

    /// The same for the rows of both orders.
    pub(super) fn linearize(&self, tile: &Tile, first: &mut [f64], second: &mut [f64]) {
        dispatch!(self.level, simd => self.linearize_by(simd, tile, first, second));
    }

    // All of a tile in one function: what is done per triangle then has the vector instructions as well.

    #[inline(always)]
    fn accumulate_by<S: Simd>(&self, simd: S, tile: &Tile, rows: &mut [f64]) {
        let mut scratch = Scratch::default();
        let row_len = Sums::row_len(self.template.mode_count);
        for (i, triangle) in tile.triangles.clone().enumerate() {
            for (k, item) in tile.items.clone().enumerate() {
                let Some(call) = self.call(triangle, item) else { continue };
                let k = k * tile.triangles.len() + i;
                let row = &mut rows[k * row_len..][..row_len];
                if let Some(window) = call.window() {
                    add_triangle(simd, &call, window, &mut scratch, row);
                    call.add_whole(row);
                } else {
                    add_triangle(simd, &call, call.image, &mut scratch, row);
                }
                to_origin(&mut row[..6], call.triangle.centre);
            }
        }
    }

    #[inline(always)]
    fn linearize_by<S: Simd>(&self, simd: S, tile: &Tile, first: &mut [f64], second: &mut [f64]) {
        let mut scratch = LinearScratch::default();
        let modes = self.template.mode_count;
        let [first_len, second_len] = [Sums::row_len(modes), Linearization::row_len(modes)];
        for (i, triangle) in tile.triangles.clone().enumerate() {
            for (k, item) in tile.items.clone().enumerate() {
                let Some(call) = self.call(triangle, item) else { continue };
                let k = k * tile.triangles.len() + i;
                let first = &mut first[k * first_len..][..first_len];
                let second = &mut second[k * second_len..][..second_len];
                if let Some(window) = call.window() {
                    linearize_triangle(simd, &call, window, &mut scratch, (&mut *first, &mut *second));
                    call.add_whole(first);
                } else {
                    linearize_triangle(simd, &call, call.image, &mut scratch, (first, second));
                }
                to_origin(&mut first[..6], call.triangle.centre);
                second_to_origin(&mut second[..18], call.triangle.centre);
                to_origin(&mut second[18..], call.triangle.centre);
            }
        }
    }

    /// A triangle at a pose, if it takes part.
    #[inline(always)]
    fn call(&self, triangle: usize, item: usize) -> Option<Call<'a>> {
        let Self { template, request, image, .. } = *self;
        let warp = &request.warps[item * template.triangles.len() + triangle];
        if !warp.active {
            return None;
        }
        let triangle = &template.triangles[triangle];
        let warp = LocalWarp::new(warp, triangle.centre);
        let appearance = &request.appearance[item * template.mode_count..][..template.mode_count];
        Some(Call { template, triangle, warp, appearance, image })
    }
}

#[inline(always)]
fn add_triangle<S: Simd, P: Place>(
    simd: S,
    call: &Call<'_>,
    place: P,
    scratch: &mut Scratch,
    row: &mut [f64],
) {
    let Call { template, triangle, warp, appearance, .. } = call;
    for number in 0..triangle.blocks() {
        let block = template.block(triangle, number);
        accumulate::add_block(simd, &block, warp, appearance, place, scratch, row);
    }
}

#[inline(always)]
fn linearize_triangle<S: Simd, P: Place>(
    simd: S,
    call: &Call<'_>,
    place: P,
    scratch: &mut LinearScratch,
    (first, second): (&mut [f64], &mut [f64]),
) {
    let Call { template, triangle, warp, appearance, .. } = call;
    for number in 0..triangle.blocks() {
        let (block, rows) = (template.block(triangle, number), (&mut *first, &mut *second));
        linearize::add_block(simd, &block, warp, appearance, place, scratch, rows);
    }
}
