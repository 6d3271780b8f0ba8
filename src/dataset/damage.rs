//! Test support: damaged copies of a good file, to show that no reader panics on any input.

use std::path::Path;

use proptest::prelude::*;

/// Copies of `sample` cut short at any place, with up to eight bytes overwritten.
pub(super) fn damaged(sample: &'static [u8]) -> impl Strategy<Value = Vec<u8>> {
    let patches = prop::collection::vec((0..sample.len(), any::<u8>()), 0..8);
    (0..=sample.len(), any::<bool>(), patches).prop_map(move |(cut, whole, patches)| {
        let mut bytes = sample.to_vec();
        for (at, byte) in patches {
            bytes[at] = byte;
        }
        bytes.truncate(if whole { sample.len() } else { cut });
        bytes
    })
}

/// Writes `bytes` to a file of this name in a fresh folder and hands its path to `read`.
pub(super) fn with_file<T>(name: &str, bytes: &[u8], read: impl FnOnce(&Path) -> T) -> T {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("written");
    read(&path)
}
