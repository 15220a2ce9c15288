//! Mutated files: whatever bytes they have, an import ends in an error or in a valid scene.

use std::path::Path;

use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use ropewalk::gltf::{self, ImportOptions};
use ropewalk::{Error, Scene};
use serde_json::{Value, json};

use super::fixture::*;

/// A small file with every feature that is imported, so that mutations reach all code.
fn everything() -> Fixture {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &[TRIANGLE, TRIANGLE].concat());
    let normals = fixture.floats("VEC3", &[[0.0, 0.0, 1.0]; 6].concat());
    let uv = fixture.accessor(U16, "VEC2", 6, &[128; 24]);
    fixture.json["accessors"][uv]["normalized"] = json!(true);
    let colors = fixture.accessor(U8, "VEC4", 6, &[200; 24]);
    fixture.json["accessors"][colors]["normalized"] = json!(true);
    let joints = fixture.accessor(U8, "VEC4", 6, &[0; 24]);
    let weights = fixture.floats("VEC4", &[0.25; 24]);
    let indices = fixture.accessor(U8, "SCALAR", 6, &[0, 1, 2, 5, 4, 3]);
    let place = fixture.view(&[1, 4]);
    let values = fixture.view(&[0; 24]);
    fixture.json["accessors"][positions]["sparse"] =
        json!({"count": 2, "indices": {"bufferView": place, "componentType": U8}, "values": {"bufferView": values}});
    let matrices = fixture.floats("MAT4", &glam::Mat4::IDENTITY.to_cols_array());
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbaImage::new(2, 2).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let image = fixture.view(&png.into_inner());

    let attributes = json!({"POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uv, "COLOR_0": colors, "JOINTS_0": joints, "WEIGHTS_0": weights});
    let primitive = json!({"attributes": attributes, "indices": indices, "material": 0, "targets": [{"POSITION": normals, "NORMAL": normals}]});
    fixture.json["meshes"] = json!([
        {"primitives": [primitive], "weights": [0.5]},
        {"primitives": [{"attributes": {"POSITION": positions}, "mode": 5}, {"attributes": {"POSITION": positions}, "mode": 1}]},
    ]);
    fixture.json["skins"] = json!([{"joints": [1], "inverseBindMatrices": matrices, "skeleton": 1}]);
    let info = json!({"index": 0, "extensions": {"KHR_texture_transform": {"rotation": 1, "scale": [2, 2]}}});
    fixture.json["materials"] = json!([{
        "pbrMetallicRoughness": {"baseColorTexture": info, "metallicFactor": 0.5}, "normalTexture": info, "alphaMode": "MASK",
        "extensions": {"KHR_materials_ior": {"ior": 1.4}, "KHR_materials_transmission": {"transmissionTexture": info}},
    }]);
    fixture.json["textures"] = json!([{"source": 0, "sampler": 0}]);
    fixture.json["samplers"] = json!([{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071}]);
    fixture.json["images"] = json!([{"bufferView": image, "mimeType": "image/png"}]);
    fixture.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}]);
    let lights = json!([{"type": "spot", "spot": {"outerConeAngle": 0.5}, "range": 4}]);
    fixture.json["extensions"] = json!({"KHR_lights_punctual": {"lights": lights}});
    fixture.json["nodes"] = json!([
        {"mesh": 0, "skin": 0, "children": [1, 2], "name": "a"},
        {"rotation": [0, 0, 0, 1], "camera": 0},
        {"mesh": 1, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "extensions": {
            "KHR_lights_punctual": {"light": 0}, "EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": normals}},
        }},
    ]);
    fixture.json["animations"] = json!([{"samplers": [{"input": indices, "output": positions}], "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}]}]);
    fixture.json["scenes"] = json!([{"nodes": [0]}]);
    fixture.json["scene"] = json!(0);
    fixture.json["buffers"] = json!([{"byteLength": fixture.bin.len()}]);
    fixture
}

/// Imports the bytes and checks what must hold whatever they are. Returns whether the import succeeded.
fn import(bytes: &[u8]) -> bool {
    let mut scene = Scene::new();
    let (root, revision) = (scene.root(), scene.revision());
    match gltf::import_from_slice(bytes, Path::new("mutant.glb"), &ImportOptions::default(), &mut scene, root) {
        Ok(report) => {
            scene.validate().unwrap();
            assert!(scene.world_bounds(root).is_ok());
            scene.remove(report.root).unwrap();
            assert_eq!((scene.node_count(), scene.geometry_count(), scene.texture_count()), (1, 0, 0));
            true
        }
        Err(Error::Gltf { .. } | Error::UnsupportedExtension { .. }) => {
            assert_eq!(scene.revision(), revision, "a failed import changed the scene");
            false
        }
        Err(error) => panic!("unexpected kind of error: {error:?}"),
    }
}

/// Runs a fixed series of mutations; both outcomes must occur, or the series tests nothing.
fn run<S: Strategy>(cases: u32, strategy: &S, mutant: impl Fn(S::Value) -> Vec<u8>) {
    let config = Config { cases, failure_persistence: None, ..Config::default() };
    let rng = TestRng::from_seed(RngAlgorithm::ChaCha, b"a ropewalk is a long narrow lane");
    let outcomes = std::cell::Cell::new([0_u32; 2]);
    let result = TestRunner::new_with_rng(config, rng).run(strategy, |value| {
        let mut counts = outcomes.get();
        counts[usize::from(import(&mutant(value)))] += 1;
        outcomes.set(counts);
        Ok(())
    });
    if let Err(error) = result {
        panic!("{error}");
    }
    let [failed, imported] = outcomes.get();
    assert!(failed > 20 && imported > 20, "{failed} errors, {imported} scenes");
}

#[test]
fn the_file_itself_imports_without_a_fault() {
    let imported = everything().import();
    assert_eq!(imported.report.counts.file_nodes, 3);
    assert_eq!((imported.report.cameras.len(), imported.report.lights.len()), (1, 1));
    assert_eq!(imported.scene.texture_count(), 1);
}

#[test]
fn random_bytes_in_the_json() {
    let fixture = everything();
    let text_length = fixture.json.to_string().len();
    let bytes = fixture.glb();
    let mutations =
        prop::collection::vec((20..20 + text_length, prop::sample::select(b"0123456789-.,:{}[]\"eE ".to_vec())), 1..3);
    run(3000, &mutations, |mutations| {
        let mut bytes = bytes.clone();
        mutations.into_iter().for_each(|(at, byte)| bytes[at] = byte);
        bytes
    });
}

#[test]
fn random_bytes_in_the_data() {
    let fixture = everything();
    let bytes = fixture.glb();
    let start = bytes.len() - fixture.bin.len();
    let mutations = prop::collection::vec((start..bytes.len(), any::<u8>()), 1..6);
    run(3000, &mutations, |mutations| {
        let mut bytes = bytes.clone();
        mutations.into_iter().for_each(|(at, byte)| bytes[at] = byte);
        bytes
    });
}

#[test]
fn random_values_in_the_json() {
    let fixture = everything();
    let places = pointers(&fixture.json);
    assert!(places.len() > 200);
    let values = prop::sample::select(vec![
        json!(0),
        json!(1),
        json!(2),
        json!(7),
        json!(-1),
        json!(0.5),
        json!(1e30),
        json!(-1e300),
        json!(u32::MAX),
        json!(u64::MAX),
        json!(255),
        json!(5121),
        json!(5125),
        json!("x"),
        json!(""),
        json!([]),
        json!({}),
        json!(null),
        json!(true),
        json!([0, 0, 0]),
        json!("MAT3"),
        json!("VEC2"),
        json!("data:;base64,AAAA"),
    ]);
    let mutations = prop::collection::vec((prop::sample::select(places), values), 1..3);
    run(6000, &mutations, |mutations| {
        let mut mutant = Fixture { json: fixture.json.clone(), bin: fixture.bin.clone() };
        for (place, value) in mutations {
            // An earlier mutation may have removed the value.
            if let Some(target) = mutant.json.pointer_mut(&place) {
                *target = value;
            }
        }
        mutant.glb()
    });
}

#[test]
fn every_member_left_out() {
    let fixture = everything();
    let places = pointers(&fixture.json);
    let mut outcomes = [0; 2];
    for place in &places {
        let (parent, key) = place.rsplit_once('/').unwrap();
        let mut json = fixture.json.clone();
        match json.pointer_mut(parent).unwrap() {
            Value::Object(members) => drop(members.remove(key)),
            Value::Array(elements) => drop(elements.remove(key.parse().unwrap())),
            _ => unreachable!(),
        }
        outcomes[usize::from(import(&Fixture { json, bin: fixture.bin.clone() }.glb()))] += 1;
    }
    assert!(outcomes[0] > 20 && outcomes[1] > 20, "{outcomes:?}");
}

#[test]
fn every_truncation() {
    let bytes = everything().glb();
    for length in 0..bytes.len() {
        assert!(!import(&bytes[..length]), "{length} of {} bytes import", bytes.len());
    }
}

/// The JSON pointers of all values within a value, without itself.
fn pointers(root: &Value) -> Vec<String> {
    let mut found = Vec::new();
    let mut pending = vec![(String::new(), root)];
    while let Some((pointer, value)) = pending.pop() {
        let children: Vec<(String, &Value)> = match value {
            Value::Array(elements) => elements.iter().enumerate().map(|(i, v)| (format!("{pointer}/{i}"), v)).collect(),
            Value::Object(members) => members.iter().map(|(key, v)| (format!("{pointer}/{key}"), v)).collect(),
            _ => Vec::new(),
        };
        found.extend(children.iter().map(|(pointer, _)| pointer.clone()));
        pending.extend(children);
    }
    found.sort();
    found
}
