//! The memory of an import: whatever a file is made of, the budget that is charged bounds what is allocated.

use std::path::Path;

use ropewalk::gltf::{self, GltfFault, ImportOptions};
use ropewalk::{Error, Scene};

use super::{HEAP, alone};

/// What is allocated apart from the files' content: for thread pools, messages, buffers of fixed size.
const SLACK: usize = 1 << 18;
/// Objects in a file that is made of one kind.
const COUNT: usize = 5_000;

/// `count` copies of a JSON value, or of what becomes of it with `$` for the number of the copy, as an array.
fn array(count: usize, element: &str) -> String {
    let copies: Vec<String> = (0..count).map(|i| element.replace('$', &i.to_string())).collect();
    format!("[{}]", copies.join(","))
}

/// A file with these members besides a root node, as JSON.
fn file(members: &[(&str, &str)]) -> String {
    let mut text = r#"{"asset":{"version":"2.0"}"#.to_owned();
    for (key, value) in members {
        text += &format!(",\"{key}\":{value}");
    }
    text + "}"
}

/// Files that consist of one kind of object, many times.
fn amplified() -> Vec<(&'static str, String)> {
    let many = |element: &str| array(COUNT, element);
    let one_node = ("nodes", "[{}]");
    let triangle = r#"[{"componentType":5126,"type":"VEC3","count":3}]"#;
    let member = |key: &'static str, element: &str| (key, file(&[one_node, (key, &*many(element))]));
    vec![
        member("animations", "{}"),
        member("animations", r#"{"name":"$"}"#),
        ("bufferViews", {
            let views = many(r#"{"buffer":0,"byteLength":0}"#);
            file(&[("buffers", r#"[{"byteLength":0}]"#), ("bufferViews", &views)])
        }),
        member("buffers", r#"{"byteLength":0}"#),
        ("buffers with data", file(&[("buffers", &many(r#"{"byteLength":1,"uri":"data:,$"}"#))])),
        member("cameras", r#"{"type":"x"}"#),
        member("images", "{}"),
        member("materials", "{}"),
        member("materials", r#"{"extensions":{"a":{"b":{}}}}"#),
        member("meshes", r#"{"primitives":[]}"#),
        member("samplers", "{}"),
        member("samplers", r#"{"minFilter":9729,"magFilter":9728}"#),
        member("skins", r#"{"joints":[0]}"#),
        member("textures", "{}"),
        member("unknown", "{}"),
        member("unknown", r#"{"":{}}"#),
        member("unknown", r#""""#),
        member("unknown", "[]"),
        member("unknown", "[[[0]]]"),
        member("unknown", "0"),
        member("unknown", "0.5"),
        member("unknown", r#"{"extras":[0]}"#),
        ("accessors", file(&[("accessors", &many(r#"{"componentType":5126,"type":"VEC3","count":0}"#))])),
        ("sparse accessors", {
            let sparse = r#"{"count":1,"indices":{"bufferView":0,"componentType":5121},"values":{"bufferView":0}}"#;
            let accessor = format!(r#"{{"componentType":5126,"type":"VEC3","count":100,"sparse":{sparse}}}"#);
            let buffers = r#"[{"byteLength":12,"uri":"data:,000000000000"}]"#;
            let views = r#"[{"buffer":0,"byteLength":12}]"#;
            file(&[("buffers", buffers), ("bufferViews", views), ("accessors", &many(&accessor))])
        }),
        ("empty scenes", file(&[("nodes", "[{}]"), ("scene", "0"), ("scenes", &many("{}"))])),
        ("scenes", file(&[("nodes", "[{}]"), ("scene", "0"), ("scenes", &many(r#"{"name":"$","nodes":[0]}"#))])),
        ("nodes not in the scene", file(&[("scenes", r#"[{"nodes":[0]}]"#), ("nodes", &many("{}"))])),
        ("nodes", file(&[("nodes", &many("{}"))])),
        ("named nodes", file(&[("nodes", &many(r#"{"name":"a node with a long name, and number $"}"#))])),
        ("nodes with matrices", file(&[("nodes", &many(r#"{"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}"#))])),
        ("nodes with extensions", file(&[("nodes", &many(r#"{"extensions":{"a":{"b":[{}]}}}"#))])),
        ("a chain of nodes", {
            let links: Vec<String> = (1..COUNT).map(|i| format!("{{\"children\":[{i}]}}")).collect();
            file(&[("nodes", &format!("[{},{{}}]", links.join(",")))])
        }),
        ("nodes with cameras", {
            let camera = r#"{"type":"perspective","perspective":{"yfov":1,"znear":1}}"#;
            file(&[("cameras", &many(camera)), ("nodes", &many(r#"{"camera":$}"#))])
        }),
        ("nodes with lights", {
            let lights = format!(r#"{{"KHR_lights_punctual":{{"lights":{}}}}}"#, many(r#"{"type":"point"}"#));
            let node = r#"{"extensions":{"KHR_lights_punctual":{"light":$}}}"#;
            file(&[("extensions", &lights), ("nodes", &many(node))])
        }),
        ("nodes with meshes", {
            let mesh = r#"{"primitives":[{"attributes":{"POSITION":0}}]}"#;
            file(&[("accessors", triangle), ("meshes", &many(mesh)), ("nodes", &many(r#"{"mesh":$}"#))])
        }),
        ("primitives", {
            let mesh = format!(r#"[{{"primitives":{}}}]"#, many(r#"{"attributes":{"POSITION":0}}"#));
            file(&[("accessors", triangle), ("meshes", &mesh), ("nodes", r#"[{"mesh":0}]"#)])
        }),
        ("primitives with geometry", {
            // As many different geometries, from the empty one to one of a hundred triangles.
            let accessors = array(300, r#"{"componentType":5126,"type":"VEC3","count":$}"#);
            let primitives = array(300, r#"{"attributes":{"POSITION":$}}"#);
            let mesh = format!(r#"[{{"primitives":{primitives}}}]"#);
            file(&[("accessors", &accessors), ("meshes", &mesh), ("nodes", r#"[{"mesh":0}]"#)])
        }),
        ("primitives that are not drawn", {
            let mesh = format!(r#"[{{"primitives":{}}}]"#, many(r#"{"attributes":{}}"#));
            file(&[("meshes", &mesh), ("nodes", r#"[{"mesh":0}]"#)])
        }),
        ("morph targets", {
            let targets = many(r#"{"POSITION":0}"#);
            let weights = many("0.5");
            let primitive = format!(r#"{{"attributes":{{"POSITION":0}},"targets":{targets}}}"#);
            let mesh = format!(r#"[{{"primitives":[{primitive}],"weights":{weights}}}]"#);
            file(&[("accessors", triangle), ("meshes", &mesh), ("nodes", r#"[{"mesh":0}]"#)])
        }),
        ("materials with images", {
            let mesh = format!(r#"[{{"primitives":{}}}]"#, many(r#"{"attributes":{"POSITION":0},"material":$}"#));
            let materials = many(r#"{"emissiveTexture":{"index":$}}"#);
            file(&[
                ("accessors", triangle),
                ("meshes", &mesh),
                ("nodes", r#"[{"mesh":0}]"#),
                ("materials", &materials),
                ("textures", &many(r#"{"source":$}"#)),
                ("images", &many(r#"{"uri":"data:,$"}"#)),
            ])
        }),
        ("extensions of many names", {
            let names: Vec<String> = (0..COUNT).map(|i| format!("\"{i}\":{{}}")).collect();
            file(&[("nodes", &format!("[{{\"extensions\":{{{}}}}}]", names.join(",")))])
        }),
        ("a long name", file(&[("nodes", &format!("[{{\"name\":\"{}\"}}]", "n".repeat(20 * COUNT)))])),
        ("instances", {
            let accessors = format!(r#"[{{"componentType":5126,"type":"VEC3","count":{COUNT}}}]"#);
            let node = r#"{"mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":0}}}}"#;
            let meshes = r#"[{"primitives":[{"attributes":{"POSITION":0}}]}]"#;
            file(&[("accessors", &accessors), ("meshes", meshes), ("nodes", &format!("[{node}]"))])
        }),
    ]
}

/// Imports a file under a limit; returns whether it was imported, and the bytes that were allocated at the most.
fn import(text: &str, limit: u64) -> (bool, usize) {
    let mut scene = Scene::new();
    let root = scene.root();
    let options = ImportOptions::default().with_memory_limit(limit);
    HEAP.reset_peak_usage();
    let start = HEAP.current_usage();
    let result = gltf::import_from_slice(text.as_bytes(), Path::new("a.gltf"), &options, &mut scene, root);
    let peak = HEAP.peak_usage() - start;
    match result {
        Ok(_) => (true, peak),
        Err(Error::Gltf { cause: GltfFault::Budget { limit_bytes }, .. }) => {
            assert!(limit_bytes <= limit);
            (false, peak)
        }
        Err(error) => panic!("{error}: {}", &text[..text.len().min(300)]),
    }
}

/// The least limit under which each file can be imported is found by bisection. What is allocated stays below every
/// limit tried, whether or not the import succeeds.
#[test]
fn an_import_stays_below_its_limit_whatever_the_file_is_made_of() {
    let _alone = alone();
    let mut refused = 0;
    for (kind, text) in amplified() {
        // The largest limit tried must suffice: this is not a file that is refused as hostile.
        let (mut too_small, mut enough) = (0_u64, 1_u64 << 31);
        let (mut tight, mut used) = (0, 0);
        while enough - too_small > enough / 50 {
            let limit = if enough == 1 << 31 && tight == 0 { enough } else { too_small.midpoint(enough) };
            tight += 1;
            let (imported, peak) = import(&text, limit);
            let what = if imported { "imported" } else { "refused" };
            assert!(
                peak as u64 <= limit + (text.len() + SLACK) as u64,
                "{kind}: {what} under a limit of {limit} bytes, {peak} were allocated for {} of text",
                text.len()
            );
            if imported {
                (enough, used) = (limit, peak);
            } else {
                assert!(limit < 1 << 31, "{kind} is refused even under {limit} bytes");
                (too_small, refused) = (limit, refused + 1);
            }
        }
        println!("{kind}: {} of text, {enough} bytes charged, {used} allocated", text.len());
    }
    assert!(refused > 100, "only {refused} imports were refused: the limits test nothing");
}

/// 3 bytes of text for an object are not worth a typed object, so such files are refused before they are parsed.
#[test]
fn a_file_of_empty_objects_takes_no_more_than_its_size_justifies() {
    let _alone = alone();
    for key in ["materials", "nodes", "scenes"] {
        let text = file(&[("nodes", "[{}]"), (key, &array(3_000_000, "{}"))]);
        let (imported, peak) = import(&text, u64::MAX);
        assert!(!imported, "{key}");
        assert!(peak < SLACK, "{key}: {peak} bytes for a file that is refused by its text alone");
    }
    let (imported, peak) = import(&file(&[("nodes", "[{}]"), ("animations", &array(1_000_000, "{}"))]), u64::MAX);
    assert!(imported && peak < 90 << 20, "{peak} bytes for a million empty animations");
}
