//! `EXT_mesh_gpu_instancing`: several instances of the mesh of a node.

use glam::{DQuat, Vec3, Vec4};
use serde_json::Value;

use super::accessor::Selection;
use super::format::{Component, Format};
use super::warnings::Warnings;
use super::{Accessors, Budget, Document, InstancingFault, WarningKind};
use crate::Result;
use crate::graph::Transform;

const EXTENSION: &str = "EXT_mesh_gpu_instancing";

/// The transforms of a node's instances, `node_from_instance`; `None` if the node does not use the extension.
pub(super) fn transforms(
    document: &Document,
    accessors: &Accessors,
    budget: &mut Budget,
    node: usize,
    warnings: &mut Warnings,
) -> Result<Option<Vec<Transform>>> {
    let Some(extension) = document.node_extension(node, EXTENSION) else { return Ok(None) };
    let pointer = format!("/nodes/{node}/extensions/{EXTENSION}");
    let Some(attributes) = extension.get("attributes").and_then(Value::as_object).filter(|a| !a.is_empty()) else {
        return Err(document.error_at(pointer, InstancingFault::NoAttributes));
    };

    // 1. Find the attributes, and check their formats and lengths. The references have been checked before.
    let (mut count, mut translations, mut rotations, mut scales) = (None, None, None, None);
    for (name, index) in attributes {
        let index = index.as_u64().unwrap_or_default() as usize;
        let elements = accessors.get(index);
        // All attributes must have the same number of elements.
        if *count.get_or_insert(elements.count) != elements.count {
            return Err(document.error_at(pointer, InstancingFault::DifferentCounts));
        }
        let vec3: (&'static str, fn(Format) -> bool) =
            ("VEC3 of floats", |f| f.is_vector(3) && f.component == Component::F32);
        let vec4: (&'static str, fn(Format) -> bool) =
            ("VEC4 of floats, or of normalized bytes or shorts", |f| f.is_vector(4) && f.is_float_or_normalized());
        // Find the attribute by its name; others than these three are ignored.
        let (attribute, role, (expected, accepts)) = match name.as_str() {
            "TRANSLATION" => (&mut translations, "TRANSLATION", vec3),
            "ROTATION" => (&mut rotations, "ROTATION", vec4),
            "SCALE" => (&mut scales, "SCALE", vec3),
            _ => {
                let feature = format!("instance attribute {name}");
                warnings.add(document, WarningKind::Feature, feature, &*pointer, "not supported: ignored");
                continue;
            }
        };
        elements.require_format(document, role, expected, accepts)?;
        *attribute = Some(index);
    }

    // 2. Read them.
    let count = count.unwrap_or_default();
    // Charge for the attributes and for the transforms made of them.
    let size = 2 * size_of::<Vec3>() + size_of::<Vec4>() + size_of::<Transform>();
    budget.charge(count, size, document, || pointer.clone())?;
    let read_vec3 =
        |index: Option<usize>| index.map(|i| accessors.get(i).floats::<Vec3, 3>(document, Selection::All)).transpose();
    let (translations, scales) = (read_vec3(translations)?, read_vec3(scales)?);
    let rotations = rotations.map(|i| accessors.get(i).floats::<Vec4, 4>(document, Selection::All)).transpose()?;

    // 3. Make a transform of each instance; an attribute that is missing is the identity.
    let mut transforms = Vec::with_capacity(count);
    for i in 0..count {
        // Normalize rotations: those read from integers have a length of only about 1.
        let rotation = match rotations.as_ref().map(|r| r[i].as_dvec4().try_normalize()) {
            None => DQuat::IDENTITY,
            Some(Some(q)) => DQuat::from_vec4(q),
            Some(None) => return Err(document.error_at(pointer, InstancingFault::ZeroRotation { instance: i })),
        };
        transforms.push(Transform::Trs {
            translation: translations.as_ref().map_or(Vec3::ZERO, |t| t[i]).as_dvec3(),
            rotation,
            scale: scales.as_ref().map_or(Vec3::ONE, |s| s[i]).as_dvec3(),
        });
    }
    Ok(Some(transforms))
}
