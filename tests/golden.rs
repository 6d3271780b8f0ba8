//! Do the rendered scenes look as stored? `AAM6D_UPDATE=1` rewrites the stored images; look at them before committing.

use std::fs;
use std::path::PathBuf;

use aam6d::imaging::{GrayImage, Pyramid};
use aam6d::simulate::{SceneKind, Sequence, SequenceOptions};

/// Largest stored image, bytes.
const SIZE_LIMIT: u64 = 4096;

/// Compares every pixel with the stored image, or stores it.
fn check(name: &str, image: &GrayImage) {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let path = folder.join(format!("{name}.png"));
    if std::env::var_os("AAM6D_UPDATE").is_some() {
        fs::create_dir_all(&folder).expect("a folder for golden images");
        image.save(&path).expect("a golden image");
        let size = fs::metadata(&path).expect("just written").len();
        assert!(size <= SIZE_LIMIT, "{name}.png has {size} bytes, more than {SIZE_LIMIT}");
        return;
    }
    let stored = aam6d::imaging::gray::read(&path)
        .unwrap_or_else(|e| panic!("{e}; store it with AAM6D_UPDATE=1 cargo test --test golden"));
    assert_eq!(stored.dimensions(), image.dimensions(), "size of {name}");
    let differing: Vec<String> = stored
        .enumerate_pixels()
        .zip(image.pixels())
        .filter(|((_, _, a), b)| a != b)
        .map(|((u, v, a), b)| format!("({u}, {v}): {} stored, {} now", a[0], b[0]))
        .collect();
    let first: Vec<_> = differing.iter().take(10).collect();
    assert!(differing.is_empty(), "{name}: {} pixels differ, first {first:?}", differing.len());
}

fn sequence(scene: SceneKind, change: impl FnOnce(&mut SequenceOptions)) -> Sequence {
    let mut options = SequenceOptions { scene, noise: 0.0, ..SequenceOptions::default() };
    change(&mut options);
    Sequence::new(options).expect("good options")
}

/// An eighth of the size, 80x60.
fn thumbnail(image: GrayImage) -> GrayImage {
    Pyramid::new(image, 4).level(3).clone()
}

fn crop(image: &GrayImage) -> GrayImage {
    image::imageops::crop_imm(image, 300, 210, 64, 48).to_image()
}

#[test]
fn relief_thumbnail() {
    check("relief", &thumbnail(sequence(SceneKind::Relief, |_| ()).image(30)));
}

#[test]
fn box_thumbnail() {
    check("box", &thumbnail(sequence(SceneKind::Box, |_| ()).image(30)));
}

#[test]
fn relief_with_noise_at_full_size() {
    check("relief_crop", &crop(&sequence(SceneKind::Relief, |o| o.noise = 2.0).image(60)));
}

#[test]
fn box_behind_the_occluder_in_changing_light() {
    let lit = sequence(SceneKind::Box, |o| (o.sequence, o.light, o.occlusion) = (2, true, 0.3));
    check("box_occluded", &thumbnail(lit.image(60)));
}
