//! From the planes of chunks that come back to the rows of triangles: added in f64, positions moved from the chart's
//! centre, where f32 is best, to its origin.

use std::ops::Range;

use rayon::prelude::*;

use super::buffers::DeviceLevel;
use crate::backend::local::{second_to_origin, to_origin};
use crate::backend::{Linearization, Sums};

/// From so many poses on the host's part of a call is divided among threads, which then get this many at least: waking
/// one for less costs more than it saves.
pub(super) const MANY: usize = 16;
pub(super) const PER_THREAD: usize = MANY / 2;
/// Numbers of a row of [`Sums`] before the modes, on the host and, padded, on the device.
const HEAD: usize = Sums::row_len(0);
const DEVICE_HEAD: usize = 12;
/// Numbers of a second-order row before the modes, on the host and, padded, on the device.
const SECOND: usize = Linearization::row_len(0);
const DEVICE_SECOND: usize = 32;

/// Adds what `accumulate` wrote for some poses to their rows.
pub(super) fn add_sums(level: &DeviceLevel, items: Range<usize>, chunk_rows: &[f32], rows: &mut [f64]) {
    let (row_len, triangles) = (Sums::row_len(level.modes), level.centres.len());
    let rows = &mut rows[items.start * triangles * row_len..items.end * triangles * row_len];
    let device_len = DEVICE_HEAD + level.modes.next_multiple_of(4);
    let of_chunk = device_len * level.partition.rows_per_chunk();
    let device_item = of_chunk * level.chunks.len();
    let add = |(item, rows): (&[f32], &mut [f64])| {
        for (chunk, partials) in level.chunks.iter().zip(item.chunks_exact(of_chunk)) {
            let row = &mut rows[chunk.triangle as usize * row_len..][..row_len];
            partials.chunks_exact(device_len).for_each(|partial| add_first(row, partial));
        }
        for (row, centre) in rows.chunks_exact_mut(row_len).zip(&level.centres) {
            to_origin(&mut row[..6], *centre);
        }
    };
    if items.len() < MANY {
        chunk_rows.chunks_exact(device_item).zip(rows.chunks_exact_mut(row_len * triangles)).for_each(add);
    } else {
        let rows = rows.par_chunks_exact_mut(row_len * triangles);
        chunk_rows.par_chunks_exact(device_item).zip(rows).with_min_len(PER_THREAD).for_each(add);
    }
}

/// Adds what `linearize` wrote for some poses to their first- and second-order rows.
pub(super) fn add_linearization(
    level: &DeviceLevel,
    items: Range<usize>,
    chunk_rows: &[f32],
    (first, second): (&mut [f64], &mut [f64]),
) {
    let (modes, triangles) = (level.modes, level.centres.len());
    let [first_len, second_len] = [Sums::row_len(modes), Linearization::row_len(modes)];
    let padded = modes.next_multiple_of(4);
    let first_planes = DEVICE_HEAD + padded;
    let device_len = first_planes + DEVICE_SECOND + 6 * padded;
    let of_chunk = device_len * level.partition.rows_per_chunk();
    let of_items = chunk_rows.chunks_exact(of_chunk * level.chunks.len());
    for (item, of_chunks) in items.zip(of_items) {
        let first = &mut first[item * triangles * first_len..][..triangles * first_len];
        let second = &mut second[item * triangles * second_len..][..triangles * second_len];
        for (chunk, partials) in level.chunks.iter().zip(of_chunks.chunks_exact(of_chunk)) {
            let t = chunk.triangle as usize;
            for partial in partials.chunks_exact(device_len) {
                add_first(&mut first[t * first_len..][..first_len], &partial[..first_planes]);
                add_second(&mut second[t * second_len..][..second_len], &partial[first_planes..]);
            }
        }
        let rows = first.chunks_exact_mut(first_len).zip(second.chunks_exact_mut(second_len));
        for ((first, second), centre) in rows.zip(&level.centres) {
            to_origin(&mut first[..6], *centre);
            second_to_origin(&mut second[..18], *centre);
            to_origin(&mut second[18..], *centre);
        }
    }
}

fn add_first(row: &mut [f64], partial: &[f32]) {
    let parts = partial[..HEAD].iter().chain(&partial[DEVICE_HEAD..]);
    for (sum, part) in row.iter_mut().zip(parts) {
        *sum += f64::from(*part);
    }
}

/// The device has four modes side by side, the host one mode after the other.
fn add_second(row: &mut [f64], partial: &[f32]) {
    let (head, of_modes) = row.split_at_mut(SECOND);
    for (sum, part) in head.iter_mut().zip(partial) {
        *sum += f64::from(*part);
    }
    for (mode, sums) in of_modes.chunks_exact_mut(6).enumerate() {
        let planes = partial[DEVICE_SECOND + 24 * (mode / 4)..].chunks_exact(4);
        for (sum, plane) in sums.iter_mut().zip(planes) {
            *sum += f64::from(plane[mode % 4]);
        }
    }
}
