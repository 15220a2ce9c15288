//! Checks that every index in a glTF document is in range: one table of where indices are and what they point into.

use std::path::Path;

use serde_json::Value;

use super::{GltfFault, error_at, schema};
use crate::Result;

/// Where indices are, as a JSON pointer in which `*` stands for every element or member, and the array they point into.
const REFERENCES: &[(&str, &str)] = &[
    ("accessors/*/bufferView", "bufferViews"),
    ("accessors/*/sparse/indices/bufferView", "bufferViews"),
    ("accessors/*/sparse/values/bufferView", "bufferViews"),
    ("animations/*/channels/*/target/node", "nodes"),
    ("animations/*/samplers/*/input", "accessors"),
    ("animations/*/samplers/*/output", "accessors"),
    ("bufferViews/*/buffer", "buffers"),
    ("bufferViews/*/extensions/EXT_meshopt_compression/buffer", "buffers"),
    ("images/*/bufferView", "bufferViews"),
    ("meshes/*/primitives/*/attributes/*", "accessors"),
    ("meshes/*/primitives/*/indices", "accessors"),
    ("meshes/*/primitives/*/material", "materials"),
    ("meshes/*/primitives/*/targets/*/*", "accessors"),
    ("meshes/*/primitives/*/extensions/KHR_draco_mesh_compression/bufferView", "bufferViews"),
    ("meshes/*/primitives/*/extensions/KHR_materials_variants/mappings/*/material", "materials"),
    (
        "meshes/*/primitives/*/extensions/KHR_materials_variants/mappings/*/variants/*",
        "extensions/KHR_materials_variants/variants",
    ),
    ("nodes/*/camera", "cameras"),
    ("nodes/*/children/*", "nodes"),
    ("nodes/*/mesh", "meshes"),
    ("nodes/*/skin", "skins"),
    ("nodes/*/extensions/EXT_mesh_gpu_instancing/attributes/*", "accessors"),
    ("nodes/*/extensions/KHR_lights_punctual/light", "extensions/KHR_lights_punctual/lights"),
    ("scene", "scenes"),
    ("scenes/*/nodes/*", "nodes"),
    ("skins/*/inverseBindMatrices", "accessors"),
    ("skins/*/joints/*", "nodes"),
    ("skins/*/skeleton", "nodes"),
    ("textures/*/sampler", "samplers"),
    ("textures/*/source", "images"),
    ("textures/*/extensions/*/source", "images"),
];

/// Where materials and their extensions, supported or not, have members: those called "...Texture" refer to a texture
/// by `index`.
const MATERIAL_MEMBERS: &[&str] =
    &["materials/*/*", "materials/*/pbrMetallicRoughness/*", "materials/*/extensions/*/*"];

/// Checks that every index is a whole number below the length of the array it points into. O(size of the document).
pub(super) fn check(root: &Value, path: &Path) -> Result<()> {
    let visit_all = |pattern: &str, found: &mut dyn FnMut(&str, &Value) -> Result<()>| {
        let parts: Vec<&str> = pattern.split('/').collect();
        visit(root, &parts, &mut String::new(), &mut |pointer, value| found(pointer, value))
    };
    let length_of = |array: &str| root.pointer(&format!("/{array}")).and_then(Value::as_array).map_or(0, Vec::len);

    // 1. The references at fixed places.
    for (pattern, target) in REFERENCES {
        let length = length_of(target);
        visit_all(pattern, &mut |pointer, index| {
            check_range(index, length, target).map_err(|cause| error_at(path, pointer, cause))
        })?;
    }

    // 2. The textures of materials and of their extensions.
    let length = length_of("textures");
    for pattern in MATERIAL_MEMBERS {
        visit_all(pattern, &mut |pointer, member| match member.get("index") {
            Some(index) if pointer.ends_with("Texture") => check_range(index, length, "textures")
                .map_err(|cause| error_at(path, format!("{pointer}/index"), cause)),
            _ => Ok(()),
        })?;
    }

    // 3. The channels of animations, which point into the samplers of the same animation.
    visit_all("animations/*", &mut |pointer, animation| {
        let length = animation.get("samplers").and_then(Value::as_array).map_or(0, Vec::len);
        visit(animation, &["channels", "*", "sampler"], &mut pointer.to_owned(), &mut |pointer, index| {
            check_range(index, length, "samplers of the animation").map_err(|cause| error_at(path, pointer, cause))
        })
    })
}

fn check_range(value: &Value, count: usize, target: &'static str) -> Result<(), GltfFault> {
    match value.as_u64() {
        Some(index) if index < count as u64 => Ok(()),
        Some(index) => Err(GltfFault::IndexOutOfRange { index, count, target }),
        None => Err(GltfFault::NotAnIndex { found: schema::describe(value), target }),
    }
}

/// Calls `found` with the pointer and the value of each match of a pattern. Recursion is as deep as the pattern is
/// long.
fn visit(
    value: &Value,
    pattern: &[&str],
    pointer: &mut String,
    found: &mut impl FnMut(&str, &Value) -> Result<()>,
) -> Result<()> {
    // At the end of the pattern this is a match.
    let Some((part, rest)) = pattern.split_first() else { return found(pointer, value) };
    // Match the rest of the pattern in a child, whose key is on the pointer meanwhile.
    let mut descend = |key: &str, child: &Value| {
        let length = pointer.len();
        push_key(pointer, key);
        let result = visit(child, rest, pointer, found);
        pointer.truncate(length);
        result
    };
    // `*` leads to every child, any other part to the member of that name, if there is one.
    match (value, *part) {
        (Value::Array(elements), "*") => {
            elements.iter().enumerate().try_for_each(|(i, child)| descend(&i.to_string(), child))
        }
        (Value::Object(members), "*") => members.iter().try_for_each(|(key, child)| descend(key, child)),
        (Value::Object(members), key) => members.get(key).map_or(Ok(()), |child| descend(key, child)),
        _ => Ok(()),
    }
}

/// Appends a key to a JSON pointer (RFC 6901).
pub(super) fn push_key(pointer: &mut String, key: &str) {
    pointer.push('/');
    pointer.push_str(&key.replace('~', "~0").replace('/', "~1"));
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// A document in which every reference of the table is present and is `index`, and every array has one element.
    fn document(pattern: &str, target: &str, index: Value) -> Value {
        let mut value = index;
        for part in pattern.rsplit('/') {
            value = if part == "*" { json!([value]) } else { json!({ part: value }) };
        }
        let mut document = value;
        let mut array = &mut document;
        for part in target.split('/') {
            array = array.as_object_mut().unwrap().entry(part).or_insert(json!({}));
        }
        if !array.is_array() {
            *array = json!([{}]);
        }
        document
    }

    #[test]
    fn every_reference_of_the_table_is_checked() {
        for (pattern, target) in REFERENCES {
            let check = |index| check(&document(pattern, target, index), Path::new("a.gltf"));
            // Where the pattern and the target are the same array, index 0 is the object itself: in range.
            assert!(check(json!(0)).is_ok(), "{pattern}");
            for bad in [json!(1), json!(-1), json!(4_294_967_296_u64), json!(0.5), json!("0"), json!([])] {
                let error = check(bad.clone()).unwrap_err().to_string();
                assert!(error.contains(&pattern.replace('*', "0")), "{pattern} = {bad}: {error}");
            }
        }
    }

    #[test]
    fn textures_of_any_material_extension_are_checked() {
        let document = |index: u32| {
            let extensions = json!({"X": {"glowTexture": {"index": index}}});
            json!({"textures": [{}], "materials": [{"extensions": extensions, "emissiveTexture": {"index": 0}}]})
        };
        assert!(check(&document(0), Path::new("a.gltf")).is_ok());
        let error = check(&document(1), Path::new("a.gltf")).unwrap_err().to_string();
        assert!(error.contains("/materials/0/extensions/X/glowTexture/index"), "{error}");
    }

    #[test]
    fn channels_point_into_their_own_animation() {
        let channel = |i: u32| json!({"animations": [{"samplers": [{}], "channels": [{"sampler": i}]}]});
        assert!(check(&channel(0), Path::new("a.gltf")).is_ok());
        let error = check(&channel(1), Path::new("a.gltf")).unwrap_err().to_string();
        assert!(error.contains("/animations/0/channels/0/sampler"), "{error}");
    }
}
