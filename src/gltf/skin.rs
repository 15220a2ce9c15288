//! Joint matrices of a skin as its joints stand in the file.

use glam::{DAffine3, DMat4};

use super::accessor::Selection;
use super::format::{Component, Shape};
use super::warnings::Warnings;
use super::{Accessors, Budget, Document};
use crate::Result;

/// For each joint the matrix from the mesh's bind pose to the space of the skinned node.
///
/// By the specification the transform of a skinned node does not move its mesh: joints place it in the scene. Our mesh is a child of the node all the
/// same, so the node's own transform is taken out of the matrices. `None` (and a note) where it has no inverse.
pub(super) fn palette(
    document: &Document,
    accessors: &Accessors,
    budget: &mut Budget,
    scene_from_node: &[DAffine3],
    (node, skin): (usize, usize),
    notes: &mut Warnings,
) -> Result<Option<Vec<DAffine3>>> {
    let joints = &document.skins[skin].joints;
    let pointer = || format!("/skins/{skin}");
    budget.charge(joints.len(), size_of::<DAffine3>() + size_of::<[f32; 16]>(), document, pointer)?;

    let node_from_scene = scene_from_node[node].inverse();
    if !node_from_scene.is_finite() {
        let effect = "not applied: the node's own transform is singular, and its mesh cannot be seen";
        notes.add(document, "skin", format!("/nodes/{node}"), effect);
        return Ok(None);
    }
    let bind = document.skins[skin].inverse_bind_matrices;
    if bind.is_some_and(|index| !accessors.get(index.value()).has_data()) {
        notes.add(document, "skin", pointer(), "not applied: the file does not hold its inverse bind matrices");
        return Ok(None);
    }
    let inverse_bind = inverse_bind_matrices(document, accessors, skin)?;
    let matrix = |(i, joint): (usize, &::gltf::json::Index<::gltf::json::Node>)| {
        let inverse_bind = inverse_bind.as_ref().map_or(DAffine3::IDENTITY, |matrices| matrices[i]);
        node_from_scene * scene_from_node[joint.value()] * inverse_bind
    };
    Ok(Some(joints.iter().enumerate().map(matrix).collect()))
}

/// One matrix for each joint; `None` if the skin has none, and all are the identity.
fn inverse_bind_matrices(document: &Document, accessors: &Accessors, skin: usize) -> Result<Option<Vec<DAffine3>>> {
    let skin_object = &document.skins[skin];
    let Some(index) = skin_object.inverse_bind_matrices else { return Ok(None) };
    let elements = accessors.get(index.value());
    elements.require_format(document, "inverseBindMatrices", "MAT4 of floats", |format| {
        format.shape == Shape::Matrix(4) && format.component == Component::F32
    })?;
    let joint_count = skin_object.joints.len();
    if elements.count < joint_count {
        let cause = format!("has {joint_count} joints, but only {} inverse bind matrices", elements.count);
        return Err(document.fault(format!("/skins/{skin}"), cause));
    }
    let first: Vec<u32> = (0..joint_count as u32).collect();
    let matrices: Vec<[f32; 16]> = elements.floats(document, Selection::Indices(&first))?;
    let affine = |m: &[f32; 16]| DAffine3::from_mat4(DMat4::from_cols_array(&m.map(f64::from)));
    Ok(Some(matrices.iter().map(affine).collect()))
}
