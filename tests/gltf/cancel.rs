//! Imports that are cancelled.

use std::path::Path;

use ropewalk::gltf::{self, ImportOptions};
use ropewalk::{Cancel, Error, Scene};
use serde_json::json;

use crate::gltf::fixture::{Fixture, TRIANGLE, U16};

/// Two meshes with indices and texture coordinates, an image and an external buffer that is never read.
fn file() -> Fixture {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let tex_coords = fixture.floats("VEC2", &[0.0; 6]);
    let indices = fixture.accessor(U16, "SCALAR", 3, &[0, 0, 1, 0, 2, 0]);
    let attributes = json!({"POSITION": positions, "TEXCOORD_0": tex_coords});
    let primitive = json!({"attributes": attributes, "indices": indices, "material": 0});
    fixture.json["meshes"] = json!([{"primitives": [primitive]}, {"primitives": [{"attributes": {"POSITION": 0}}]}]);
    fixture.json["nodes"] = json!([{"mesh": 0, "children": [1]}, {"mesh": 1}]);
    fixture.json["images"] = json!([{"uri": "data:image/png;base64,AAAA"}]);
    fixture.json["textures"] = json!([{"source": 0}]);
    fixture.json["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]);
    fixture
}

#[test]
fn an_import_that_is_cancelled_anywhere_leaves_the_scene_as_it_was() {
    let bytes = file().glb();
    let counts =
        |s: &Scene| (s.node_count(), s.core_count(), s.geometry_count(), s.material_count(), s.texture_count());
    let mut scene = Scene::new();
    let (root, empty) = (scene.root(), counts(&scene));
    for checks in 0.. {
        let options = ImportOptions::default().with_cancel(Cancel::after_checks(checks));
        match gltf::import_from_slice(&bytes, Path::new("fixture.glb"), &options, &mut scene, root) {
            Err(error) => {
                assert_eq!((error, counts(&scene)), (Error::Cancelled, empty), "after {checks} checks");
                scene.validate().unwrap();
            }
            Ok(report) => {
                assert!(checks > 10, "only {checks} places to cancel");
                let expected = file().import();
                assert_eq!(report.counts, expected.report.counts);
                assert_eq!(counts(&scene), counts(&expected.scene));
                break;
            }
        }
    }
}

#[test]
fn options_with_the_same_token_are_equal() {
    let token = Cancel::new();
    let [a, b] = [token.clone(), token].map(|token| ImportOptions::default().with_cancel(token));
    assert_eq!(a, b);
    assert_ne!(a, ImportOptions::default().with_cancel(Cancel::new()));
    assert_eq!(a.with_cancel(None), ImportOptions::default());
}
