//! Small inputs to begin with, made in code.

use ropewalk::Scene;
use ropewalk::graph::ChangeCursor;
use ropewalk_testkit::world::World;
use serde_json::{Value, json};

/// A glTF document with most of what is imported, and the data of its buffer.
pub(crate) fn gltf_parts() -> (Value, Vec<u8>) {
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let mut data = Vec::new();
    let mut views = Vec::new();
    let mut accessors = Vec::new();
    let mut add = |bytes: &[u8], component: u32, shape: &str, count: usize, normalized: bool| {
        data.resize(usize::next_multiple_of(data.len(), 4), 0);
        views.push(json!({"buffer": 0, "byteOffset": data.len(), "byteLength": bytes.len()}));
        data.extend(bytes);
        let view = views.len() - 1;
        accessors.push(json!({
            "bufferView": view, "componentType": component, "type": shape, "count": count, "normalized": normalized,
        }));
    };
    add(&floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0]), 5126, "VEC3", 3, false);
    add(&[0, 1, 2], 5121, "SCALAR", 3, false);
    add(&[7; 12], 5123, "VEC2", 3, true);
    add(&[0; 12], 5121, "VEC4", 3, false);
    add(&floats(&[0.25; 12]), 5126, "VEC4", 3, false);
    add(
        &floats(&[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
        5126,
        "MAT4",
        1,
        false,
    );
    accessors[0]["sparse"] = json!({
        "count": 1, "indices": {"bufferView": 1, "componentType": 5121}, "values": {"bufferView": 0},
    });
    let info = json!({"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}});
    let attributes = json!({"POSITION": 0, "NORMAL": 0, "TEXCOORD_0": 2, "COLOR_0": 4, "JOINTS_0": 3, "WEIGHTS_0": 4});
    let document = json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0], "name": "s"}],
        "nodes": [
            {"mesh": 0, "skin": 0, "children": [1, 2], "name": "a"},
            {"camera": 0, "rotation": [0, 0, 0, 1], "translation": [1, 2, 3], "scale": [1, 1, 1]},
            {"mesh": 1, "extensions": {
                "KHR_lights_punctual": {"light": 0}, "EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}},
            }},
        ],
        "meshes": [
            {"primitives": [{
                "attributes": attributes, "indices": 1, "material": 0, "targets": [{"POSITION": 0, "NORMAL": 0}],
            }], "weights": [0.5]},
            {"primitives": [{"attributes": {"POSITION": 0}, "mode": 5}, {"attributes": {"POSITION": 0}, "mode": 1}]},
        ],
        "skins": [{"joints": [1], "inverseBindMatrices": 5, "skeleton": 1}],
        "materials": [{
            "pbrMetallicRoughness": {"baseColorTexture": info, "metallicFactor": 0.5},
            "normalTexture": info, "alphaMode": "MASK",
            "extensions": {"KHR_materials_ior": {"ior": 1.4}, "KHR_materials_transmission": {"transmissionFactor": 1}},
        }],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071}],
        "images": [{"uri": format!("data:image/png;base64,{PNG}")}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1, "aspectRatio": 1.5}}],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "spot", "spot": {"outerConeAngle": 0.5}, "range": 4, "color": [1, 1, 1], "intensity": 2},
        ]}},
        "animations": [{
            "samplers": [{"input": 1, "output": 0}],
            "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}],
        }],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": data.len()}],
    });
    (document, data)
}

/// One white texel.
const PNG: &str = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8/5+hHgAHggJ/PchI7wAAAABJRU5ErkJggg==";

/// A GLB file of these chunks.
pub(crate) fn glb(json: &[u8], data: &[u8]) -> Vec<u8> {
    let padded = |bytes: &[u8], pad: u8| {
        let mut bytes = bytes.to_owned();
        bytes.resize(bytes.len().next_multiple_of(4), pad);
        bytes
    };
    let (json, data) = (padded(json, b' '), padded(data, 0));
    let mut file = b"glTF\x02\0\0\0".to_vec();
    file.extend((28 + json.len() as u32 + data.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &data)] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(chunk);
    }
    file
}

/// A small scene with objects of each kind.
pub(crate) fn scene() -> Scene {
    let mut world = World::new();
    world.populate();
    world.scene
}

/// Serialised deltas: a snapshot, and the changes after it.
pub(crate) fn deltas() -> Vec<Vec<u8>> {
    let mut world = World::new();
    let mut cursor = ChangeCursor::default();
    let mut deltas = vec![world.scene.delta_since(&mut cursor)];
    world.populate();
    deltas.push(world.scene.delta_since(&mut cursor));
    let node = world.nodes[3];
    world.scene.set_visible(node, false).expect("the node exists");
    world.scene.remove(world.nodes[5]).expect("the node exists");
    deltas.push(world.scene.delta_since(&mut cursor));
    deltas.push(world.scene.snapshot());
    deltas.iter().map(|delta| postcard::to_stdvec(delta).expect("deltas can be serialised")).collect()
}
