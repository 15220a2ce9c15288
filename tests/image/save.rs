//! Image files: their content as the crates `image` and `exr` decode it, and what remains of a file when writing fails.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::fs;
use std::path::Path;

use exr::prelude::{FlatSamples, ReadChannels as _, ReadLayers as _};
use ropewalk::Error;
use ropewalk::graph::NodeKey;
use ropewalk::image::{Aovs, Image};
use slotmap::{Key as _, KeyData};

/// An image of 3 by 2 different pixels.
fn gradient() -> Image {
    let color = (0..6).map(|i| [i as f32 * 0.1, 0.5, 3.0 - i as f32 * 0.7, 1.0]).collect();
    Image::new(3, 2, color)
}

fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn png_holds_the_tone_mapped_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("Räume & mehr.PNG");
    gradient().save(&path).unwrap();

    let decoded = image::ImageReader::open(&path).unwrap().decode().unwrap();
    assert_eq!(decoded.color(), image::ColorType::Rgba8);
    assert_eq!((decoded.width(), decoded.height()), (3, 2));
    assert_eq!(decoded.as_bytes(), gradient().to_rgba8().as_flattened());
    assert_eq!(names_in(folder.path()), ["Räume & mehr.PNG"]);
}

#[test]
fn exr_holds_the_linear_pixels_and_the_aovs_bit_for_bit() {
    let mut image = gradient();
    image.aovs = Some(Aovs::new(
        vec![0.5, 1.5, f32::INFINITY, 1e-20, 1e20, 3.0],
        (0..6).map(|i| [0.0, i as f32 / 6.0, -1.0]).collect(),
        (0..6).map(|i| NodeKey::from(KeyData::from_ffi(i << 32 | 0x1_0000_0007))).collect(),
        vec![0, 1, 2, 16_777_217, u32::MAX - 1, u32::MAX],
    ));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.exr");
    image.save(&path).unwrap();

    let read = exr::prelude::read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
    let layer = exr::prelude::ReadImage::from_file(read.all_attributes(), &path).unwrap().layer_data;
    assert_eq!((layer.size.width(), layer.size.height()), (3, 2));
    let channel = |name: &str| {
        let found = layer.channel_data.list.iter().find(|c| c.name.eq(name));
        &found.unwrap_or_else(|| panic!("no channel {name}")).sample_data
    };
    let floats = |name: &str| match channel(name) {
        FlatSamples::F32(samples) => samples.clone(),
        other => panic!("{name} is {other:?}"),
    };
    let integers = |name: &str| match channel(name) {
        FlatSamples::U32(samples) => samples.clone(),
        other => panic!("{name} is {other:?}"),
    };

    let aovs = image.aovs.as_ref().unwrap();
    for (i, name) in ["R", "G", "B", "A"].iter().enumerate() {
        assert_eq!(floats(name), image.color.iter().map(|c| c[i]).collect::<Vec<_>>());
    }
    assert_eq!(floats("Z"), aovs.depth);
    for (i, name) in ["N.X", "N.Y", "N.Z"].iter().enumerate() {
        assert_eq!(floats(name), aovs.normal.iter().map(|n| n[i]).collect::<Vec<_>>());
    }
    assert_eq!(integers("id.triangle"), aovs.triangle);
    let ids = integers("id.node").into_iter().zip(integers("id.node_version"));
    let keys: Vec<_> = ids.map(|(slot, version)| u64::from(slot) | u64::from(version) << 32).collect();
    assert_eq!(keys, aovs.node.iter().map(|key| key.data().as_ffi()).collect::<Vec<_>>());
}

#[test]
fn exr_without_aovs_has_colour_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.exr");
    gradient().save(&path).unwrap();
    let read = exr::prelude::read_first_flat_layer_from_file(&path).unwrap();
    let names: Vec<_> = read.layer_data.channel_data.list.iter().map(|c| c.name.to_string()).collect();
    assert_eq!(names, ["A", "B", "G", "R"]);
}

#[test]
fn a_new_file_replaces_an_old_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.png");
    fs::write(&path, "old").unwrap();
    gradient().save(&path).unwrap();
    assert!(fs::read(&path).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(names_in(folder.path()), ["out.png"]);
}

#[test]
fn an_old_file_is_replaced_at_once_and_not_overwritten_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (path, other_name) = (folder.path().join("out.png"), folder.path().join("same file"));
    fs::write(&path, "old").unwrap();
    fs::hard_link(&path, &other_name).unwrap();
    gradient().save(&path).unwrap();
    assert_eq!(fs::read(&other_name).unwrap(), b"old");
    assert!(fs::read(&path).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn other_endings_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["out.jpg", "out", "png", ".exr", "out.png.bak"] {
        let error = gradient().save(folder.path().join(name)).unwrap_err();
        assert!(matches!(error, Error::ImageFormat { .. }), "{name}: {error}");
        let message = error.to_string();
        assert!(message.contains(name) && message.contains(".png") && message.contains(".exr"), "{message}");
    }
    assert_eq!(names_in(folder.path()), [""; 0]);
}

#[test]
fn a_failed_write_leaves_the_old_file_and_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.png");
    fs::write(&path, "old").unwrap();

    let mut short = gradient();
    short.color.pop();
    assert!(matches!(short.save(&path).unwrap_err(), Error::OutOfRange { .. }));

    for name in ["out.png", "out.exr"] {
        let empty = Image::new(0, 0, Vec::new());
        let error = empty.save(folder.path().join(name)).unwrap_err();
        assert!(matches!(error, Error::Image { .. }), "{name}: {error}");
    }

    assert_eq!(fs::read(&path).unwrap(), b"old");
    assert_eq!(names_in(folder.path()), ["out.png"]);
}

#[test]
fn a_folder_in_the_way_or_missing_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("taken.png")).unwrap();
    for name in ["taken.png", "missing/out.png"] {
        let error = gradient().save(folder.path().join(name)).unwrap_err();
        assert!(matches!(error, Error::Io { .. }), "{error}");
        assert!(error.to_string().contains(name), "{error}");
    }
    assert_eq!(names_in(folder.path()), ["taken.png"]);
    assert_eq!(names_in(&folder.path().join("taken.png")), [""; 0]);
}
