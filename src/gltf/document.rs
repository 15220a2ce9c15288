//! The JSON of a glTF file as typed objects, with everything checked that can be checked without the binary data.
//!
//! The crate `gltf` provides the types. Its own checks let through node cycles, nodes with two parents and indices out
//! of range (it also cuts indices to 32 bits), so the checks here run on the JSON itself, before anything is typed.

use std::path::Path;

use ::gltf::json;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde::Deserialize;
use serde_json::{Number, Value};

use super::json_cost::json_cost;
use super::warnings::Warnings;
use super::{Budget, GltfFault, NodeForest, TransformFault, error_at, references, schema};
use crate::graph::Transform;
use crate::{Cancel, Error, Result};

/// The extensions that are supported; a file that requires any other is refused.
pub(super) const EXTENSIONS: &[&str] = &[
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
];

/// A checked glTF document: every index in it is in range, and its nodes form trees.
pub(super) struct Document<'a> {
    /// The file, for messages.
    pub(super) path: &'a Path,
    /// The token that stops the import.
    pub(super) cancel: Cancel,
    /// The untyped JSON, for the parts that the crate has no types for.
    pub(super) value: Value,
    pub(super) accessors: Vec<json::Accessor>,
    pub(super) buffers: Vec<json::Buffer>,
    pub(super) views: Vec<json::buffer::View>,
    /// `None` for one that is broken and left out.
    pub(super) cameras: Vec<Option<json::Camera>>,
    pub(super) images: Vec<json::Image>,
    /// `None` for one that is broken and left out.
    pub(super) lights: Vec<Option<json::extensions::scene::khr_lights_punctual::Light>>,
    pub(super) materials: Vec<json::Material>,
    pub(super) meshes: Vec<json::Mesh>,
    pub(super) nodes: Vec<json::Node>,
    pub(super) samplers: Vec<json::texture::Sampler>,
    pub(super) scenes: Vec<json::Scene>,
    pub(super) skins: Vec<json::Skin>,
    pub(super) textures: Vec<json::Texture>,
    /// The local transform of each node, read in f64.
    pub(super) transforms: Vec<Transform>,
    /// The parent of each node, and a topological order.
    pub(super) hierarchy: NodeForest,
}

impl<'a> Document<'a> {
    /// Parses and checks the JSON text. O(size of the text).
    ///
    /// Nesting is limited to 128 levels by `serde_json`, so nothing that walks the tree can overflow the stack.
    pub(super) fn parse(text: &[u8], path: &'a Path, budget: &mut Budget, warnings: &mut Warnings) -> Result<Self> {
        // Charge for all that this function makes of the text, before any of it is made.
        if !budget.try_take(json_cost(text, budget.remaining())) {
            return Err(error_at(path, "", budget.fault()));
        }
        // 1. Parse the text into untyped JSON, and bring it into the form that the crate's types accept.
        let mut value: Value =
            serde_json::from_slice(text).map_err(|e| error_at(path, "", schema::json_fault(text, &e)))?;
        normalize_numbers_and_drop_extras(&mut value);
        add_empty_lists(&mut value);

        // 2. Check what the crate does not: versions, extensions, references.
        check_version(&value, path)?;
        check_required_extensions(&value, path)?;
        references::check(&value, path)?;

        // 3. Convert each array to the crate's types.
        let nodes: Vec<json::Node> = parse_array(&value, "/nodes", path)?;
        let scenes: Vec<json::Scene> = parse_array(&value, "/scenes", path)?;
        let hierarchy = NodeForest::new(&nodes, &scenes, path)?;
        for (pointer, fault) in hierarchy.scene_roots_with_parents(&scenes) {
            let fallback = format!("{fault}: shown as a root, without its parent's transform");
            warnings.forgive(&value, "scene root", fallback, error_at(path, pointer, fault))?;
        }
        // Of these, a broken one is left out, or a broken part of it; the file is imported all the same. Of a material,
        // that is an extension.
        let cameras = parse_parts(&mut value, "/cameras", path, "camera", |_| Some(0), warnings)?;
        let lights = "/extensions/KHR_lights_punctual/lights";
        let lights = parse_parts(&mut value, lights, path, "light", |_| Some(0), warnings)?;
        let images = parse_parts(&mut value, "/images", path, "image", |keys| Some(keys.len().min(1)), warnings)?;
        let extension =
            |keys: &[String]| keys.iter().rposition(|key| key == "extensions").map(|i| (i + 2).min(keys.len()));
        let materials = parse_parts(&mut value, "/materials", path, "material extension", extension, warnings)?;
        // Collecting would grow the vector by doubling.
        let mut whole_materials = Vec::with_capacity(materials.len());
        whole_materials.extend(materials.into_iter().flatten());
        Ok(Self {
            path,
            cancel: Cancel::new(),
            accessors: parse_array(&value, "/accessors", path)?,
            buffers: parse_array(&value, "/buffers", path)?,
            views: parse_array(&value, "/bufferViews", path)?,
            cameras,
            images: images.into_iter().map(|image| image.unwrap_or_else(no_image)).collect(),
            lights,
            materials: whole_materials,
            meshes: parse_array(&value, "/meshes", path)?,
            samplers: parse_array(&value, "/samplers", path)?,
            skins: parse_array(&value, "/skins", path)?,
            textures: parse_array(&value, "/textures", path)?,
            transforms: transforms(&value, path)?,
            hierarchy,
            nodes,
            scenes,
            value,
        })
    }

    /// The error about the object of this file at a JSON pointer.
    pub(super) fn error_at(&self, pointer: impl Into<String>, cause: impl Into<GltfFault>) -> Error {
        error_at(self.path, pointer, cause)
    }

    /// A node's extension as untyped JSON, for an extension that the crate has no type for.
    pub(super) fn node_extension(&self, node: usize, extension: &str) -> Option<&Value> {
        self.nodes[node].extensions.as_ref()?.others.get(extension)
    }
}

/// What stands for an image that is broken: it has no data.
fn no_image() -> json::Image {
    let extras = json::Extras::default();
    json::Image { buffer_view: None, mime_type: None, name: None, uri: None, extensions: None, extras }
}

/// The objects of an array of the JSON; none where there is no such array.
fn parse_array<T: for<'de> Deserialize<'de>>(root: &Value, pointer: &str, path: &Path) -> Result<Vec<T>> {
    let elements = elements(root, pointer, path)?;
    // Collecting results would grow the vector by doubling.
    let mut objects = Vec::with_capacity(elements.len());
    for (i, element) in elements.iter().enumerate() {
        objects.push(schema::parse_object(element).map_err(|e| e.error_at(path, &format!("{pointer}/{i}")))?);
    }
    Ok(objects)
}

/// As [`parse_array`], but where an element is not of type `T`, only a part of it is left out, and removed from the
/// JSON. `part_of` gives that part for the keys that lead to the fault: how many of the keys lead to it, so that 0 is
/// the element as a whole; or `None` if the file is to be refused. `what` names such parts in warnings.
fn parse_parts<T: for<'de> Deserialize<'de>>(
    root: &mut Value,
    pointer: &str,
    path: &Path,
    what: &str,
    part_of: impl Fn(&[String]) -> Option<usize>,
    warnings: &mut Warnings,
) -> Result<Vec<Option<T>>> {
    let count = elements(root, pointer, path)?.len();
    let mut parsed = Vec::with_capacity(count);
    for i in 0..count {
        // Remove parts of the element until the rest can be read. It is the document's own: a copy would take memory.
        parsed.push(loop {
            let fault = match schema::parse_object(&elements(root, pointer, path)?[i]) {
                Ok(object) => break Some(object),
                Err(fault) => fault,
            };
            let part = part_of(&fault.keys).and_then(|length| Some(fault.keys.get(..length)?.to_vec()));
            let pointer = format!("{pointer}/{i}");
            let error = fault.error_at(path, &pointer);
            let Some(part) = part else { return Err(error) };
            if part.is_empty() {
                warnings.leave_out(root, what, error)?;
                break None;
            }
            if root.pointer_mut(&pointer).and_then(|element| remove(element, &part)).is_none() {
                return Err(error);
            }
            warnings.leave_out(root, what, error)?;
        });
    }
    Ok(parsed)
}

/// Removes and returns the member to which the keys lead, if there is one.
fn remove(value: &mut Value, keys: &[String]) -> Option<Value> {
    let (last, parents) = keys.split_last()?;
    let parent = parents.iter().try_fold(value, |value, key| match value {
        Value::Array(elements) => elements.get_mut(key.parse::<usize>().ok()?),
        value => value.get_mut(key),
    });
    parent?.as_object_mut()?.remove(last)
}

/// The elements of an array of the JSON; none where there is no such array.
fn elements<'v>(root: &'v Value, pointer: &str, path: &Path) -> Result<&'v [Value]> {
    match root.pointer(pointer) {
        None => Ok(&[]),
        Some(Value::Array(elements)) => Ok(elements),
        Some(_) => Err(error_at(path, pointer, GltfFault::NotAnArray)),
    }
}

/// Rewrites whole numbers written as "1.0" or "1e0" as integers, since serde reads an integer from "1" only; and drops
/// the application's own `extras`, which may be of any type, while the crate's types require objects.
fn normalize_numbers_and_drop_extras(root: &mut Value) {
    // Up to 2^53 every whole number is exact in f64.
    const LARGEST_EXACT: f64 = (1_u64 << f64::MANTISSA_DIGITS) as f64;
    let mut pending = vec![root];
    while let Some(value) = pending.pop() {
        match value {
            Value::Array(elements) => pending.extend(elements),
            Value::Object(members) => {
                members.remove("extras");
                pending.extend(members.values_mut());
            }
            // Rewrite a number that was not written as an integer but has a whole value.
            Value::Number(number) if number.is_f64() => {
                if let Some(x) = number.as_f64().filter(|x| x.fract() == 0.0 && x.abs() <= LARGEST_EXACT) {
                    *number = if x < 0.0 { Number::from(x as i64) } else { Number::from(x as u64) };
                }
            }
            _ => {}
        }
    }
}

/// Adds the `nodes` array of an empty scene, which glTF makes optional and the crate's types require.
fn add_empty_lists(root: &mut Value) {
    let scenes = root.get_mut("scenes").and_then(Value::as_array_mut);
    for scene in scenes.into_iter().flatten().filter_map(Value::as_object_mut) {
        scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
    }
}

/// Only the major version matters, since minor versions are backward compatible, unless `minVersion` requires a newer
/// one.
fn check_version(root: &Value, path: &Path) -> Result<()> {
    // The version must be 2.x.
    let Some(Value::String(version)) = root.pointer("/asset/version") else {
        return Err(error_at(path, "/asset", GltfFault::NoVersion));
    };
    if !matches!(parse_version(version), Some((2, _))) {
        return Err(error_at(path, "/asset/version", GltfFault::Version { found: version.clone() }));
    }
    // The least version that can read the file, if it is given, must be 2.0 or lower.
    match root.pointer("/asset/minVersion") {
        None => Ok(()),
        Some(least) if least.as_str().and_then(parse_version).is_some_and(|least| least <= (2, 0)) => Ok(()),
        Some(least) => {
            Err(error_at(path, "/asset/minVersion", GltfFault::MinVersion { found: schema::describe(least) }))
        }
    }
}

/// The major and the minor number of a version: "2.0".
fn parse_version(version: &str) -> Option<(u32, u32)> {
    let (major, minor) = version.split_once('.')?;
    Some((major.parse().ok()?, minor.parse().ok()?))
}

fn check_required_extensions(root: &Value, path: &Path) -> Result<()> {
    let Some(required) = root.get("extensionsRequired") else { return Ok(()) };
    let names: Vec<String> = schema::parse(required).map_err(|e| e.error_at(path, "/extensionsRequired"))?;
    match names.into_iter().find(|name| !EXTENSIONS.contains(&name.as_str())) {
        None => Ok(()),
        Some(extension) => Err(Error::UnsupportedExtension { path: path.into(), extension }),
    }
}

/// The local transform of every node, in f64: the crate's types are f32, which would round positions on a globe to half
/// a metre.
fn transforms(root: &Value, path: &Path) -> Result<Vec<Transform>> {
    let nodes = root.get("nodes").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let mut transforms = Vec::with_capacity(nodes.len());
    for (i, node) in nodes.iter().enumerate() {
        transforms.push(transform(node).map_err(|e| error_at(path, format!("/nodes/{i}"), e))?);
    }
    Ok(transforms)
}

fn transform(node: &Value) -> Result<Transform, TransformFault> {
    let translation = numbers::<3>(node, "translation")?;
    let rotation = numbers::<4>(node, "rotation")?;
    let scale = numbers::<3>(node, "scale")?;

    // Without a matrix, the node has translation, rotation and scale, each with the identity as default.
    let Some(matrix) = numbers::<16>(node, "matrix")? else {
        let rotation = match rotation {
            None => DQuat::IDENTITY,
            Some(q) => unit_quaternion(q).ok_or(TransformFault::ZeroRotation)?,
        };
        return Ok(Transform::Trs {
            translation: translation.map_or(DVec3::ZERO, DVec3::from),
            rotation,
            scale: scale.map_or(DVec3::ONE, DVec3::from),
        });
    };
    // A node with a matrix must not have any of the three.
    if translation.is_some() || rotation.is_some() || scale.is_some() {
        return Err(TransformFault::MatrixAndTrs);
    }
    // Read the matrix, column by column. Its last row must be that of an affine map.
    let column = |i: usize| DVec3::new(matrix[4 * i], matrix[4 * i + 1], matrix[4 * i + 2]);
    if [matrix[3], matrix[7], matrix[11], matrix[15]] != [0.0, 0.0, 0.0, 1.0] {
        return Err(TransformFault::NotAffine);
    }
    let matrix3 = DMat3::from_cols(column(0), column(1), column(2));
    Ok(Transform::Matrix(DAffine3 { matrix3, translation: column(3) }))
}

/// The quaternion scaled to length 1, for any length but zero.
fn unit_quaternion(components: [f64; 4]) -> Option<DQuat> {
    // Scaled by the largest component first, so that the square of the length neither overflows nor vanishes.
    let q = DQuat::from_array(components);
    let largest = components.iter().fold(0.0, |a: f64, c| a.max(c.abs()));
    (largest > 0.0).then(|| (q / largest).normalize())
}

/// A member that is an array of exactly `N` numbers; JSON numbers are finite.
fn numbers<const N: usize>(object: &Value, member: &'static str) -> Result<Option<[f64; N]>, TransformFault> {
    let Some(value) = object.get(member) else { return Ok(None) };
    let numbers: Option<Vec<f64>> = value.as_array().and_then(|a| a.iter().map(Value::as_f64).collect());
    match numbers.and_then(|n| <[f64; N]>::try_from(n).ok()) {
        Some(numbers) => Ok(Some(numbers)),
        None => Err(TransformFault::NotNumbers { member, count: N }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn whole_numbers_are_integers_however_written() {
        let mut value = serde_json::from_str(r#"{"a": [1.0, 2e0, 30e-1, -4.0, 0.5, 1e300], "extras": 42}"#).unwrap();
        normalize_numbers_and_drop_extras(&mut value);
        assert_eq!(value.to_string(), r#"{"a":[1,2,3,-4,0.5,1e+300]}"#);
    }

    #[test]
    fn transforms_keep_f64_and_their_form() {
        let node = json!({"translation": [6378137.123456, 0, 0], "rotation": [0, 0, 0, 2e200], "scale": [1, -2, 3]});
        let expected = Transform::Trs {
            translation: DVec3::new(6378137.123456, 0.0, 0.0),
            rotation: DQuat::IDENTITY,
            scale: DVec3::new(1.0, -2.0, 3.0),
        };
        assert_eq!(transform(&node).unwrap(), expected);

        let node = json!({"matrix": [1, 2, 3, 0, 4, 5, 6, 0, 7, 8, 9, 0, 10, 11, 12, 1]});
        let Transform::Matrix(matrix) = transform(&node).unwrap() else { panic!("not a matrix") };
        assert_eq!(matrix.transform_point3(DVec3::new(1.0, 0.0, 0.0)), DVec3::new(11.0, 13.0, 15.0));
        assert_eq!(matrix.transform_point3(DVec3::new(0.0, 1.0, 0.0)), DVec3::new(14.0, 16.0, 18.0));
    }

    #[test]
    fn versions_that_are_known() {
        let check = |asset| check_version(&json!({ "asset": asset }), Path::new("a.gltf")).map_err(|e| e.to_string());
        for asset in [
            json!({"version": "2.0"}),
            json!({"version": "2.1"}),
            json!({"version": "2.0", "minVersion": "2.0"}),
            json!({"version": "2.7", "minVersion": "2.0"}),
        ] {
            assert_eq!(check(asset.clone()), Ok(()), "{asset}");
        }
        for (asset, pointer) in [
            (json!({}), "/asset:"),
            (json!({"version": "1.0"}), "/asset/version"),
            (json!({"version": "2"}), "/asset/version"),
            (json!({"version": "2.1", "minVersion": "2.1"}), "/asset/minVersion"),
            (json!({"version": "2.0", "minVersion": "3.0"}), "/asset/minVersion"),
            (json!({"version": "2.0", "minVersion": "two"}), "/asset/minVersion"),
            (json!({"version": "2.0", "minVersion": 2}), "/asset/minVersion"),
        ] {
            let error = check(asset.clone()).expect_err(&asset.to_string());
            assert!(error.contains(pointer), "{asset}: {error}");
        }
    }

    #[test]
    fn bad_transforms_are_errors() {
        let not_numbers = |member, count| TransformFault::NotNumbers { member, count };
        for (node, fault) in [
            (json!({"rotation": [0, 0, 0, 0]}), TransformFault::ZeroRotation),
            (json!({"translation": [1, 2]}), not_numbers("translation", 3)),
            (json!({"scale": [1, 2, "x"]}), not_numbers("scale", 3)),
            (json!({"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2]}), TransformFault::NotAffine),
            (
                json!({"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "scale": [1, 1, 1]}),
                TransformFault::MatrixAndTrs,
            ),
        ] {
            assert_eq!(transform(&node), Err(fault), "{node}");
        }
    }

    /// The documentation of the module and the table of the code list the same extensions.
    #[test]
    fn the_supported_extensions_are_documented() {
        let documentation: String = include_str!("mod.rs").lines().take_while(|line| line.starts_with("//!")).collect();
        let list = documentation.split("Extensions supported:").nth(1).unwrap().split(". ").next().unwrap();
        let names: Vec<&str> = list.split('`').skip(1).step_by(2).collect();
        assert_eq!(names, EXTENSIONS);
    }
}
