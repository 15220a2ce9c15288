//! The joint matrices of a skin, for the rest pose of its joints.

use glam::{DAffine3, DMat4};

use super::accessor::Selection;
use super::format::{Component, Shape};
use super::warnings::Warnings;
use super::{Accessors, Budget, Document, SkinFault, WarningKind};
use crate::Result;
use crate::math::MappedSpace;

/// The matrix from the scene to a node's space; `None` for a node that flattens what is below it.
pub(super) fn node_from_scene(scene_from_node: &DAffine3) -> Option<DAffine3> {
    let is_invertible = MappedSpace::of(&scene_from_node.matrix3) == MappedSpace::Space;
    is_invertible.then(|| scene_from_node.inverse()).filter(DAffine3::is_finite)
}

/// For each joint the matrix from the mesh's bind pose to the space of the skinned node; to that of the scene, if the
/// node flattens what is below it ([`node_from_scene`]). `None`, with a warning, if the file does not hold the inverse
/// bind matrices.
///
/// By the specification the transform of a skinned node is ignored: its joints define the position. Here the mesh is a
/// child of that node, so the node's transform is divided out of the joint matrices; where it cannot be, the mesh is a
/// child of the import's root instead.
pub(super) fn palette(
    document: &Document,
    accessors: &Accessors,
    budget: &mut Budget,
    scene_from_node: &[DAffine3],
    (node, skin): (usize, usize),
    warnings: &mut Warnings,
) -> Result<Option<Vec<DAffine3>>> {
    let joints = &document.skins[skin].joints;
    let pointer = || format!("/skins/{skin}");
    budget.charge(joints.len(), size_of::<DAffine3>() + size_of::<[f32; 16]>(), document, pointer)?;

    // 1. The inverse of the node's own transform.
    let node_from_scene = node_from_scene(&scene_from_node[node]).unwrap_or(DAffine3::IDENTITY);

    // 2. The inverse bind matrices.
    let bind = document.skins[skin].inverse_bind_matrices;
    if bind.is_some_and(|index| !accessors.get(index.value()).has_data()) {
        let fallback = "not applied: the file does not hold its inverse bind matrices";
        warnings.add(document, WarningKind::Data, "skin", pointer(), fallback);
        return Ok(None);
    }
    let inverse_bind = inverse_bind_matrices(document, accessors, skin)?;

    // 3. Their products: bind pose to joint, joint to scene, scene to node.
    let matrix = |(i, joint): (usize, &::gltf::json::Index<::gltf::json::Node>)| {
        let inverse_bind = inverse_bind.as_ref().map_or(DAffine3::IDENTITY, |matrices| matrices[i]);
        node_from_scene * scene_from_node[joint.value()] * inverse_bind
    };
    Ok(Some(joints.iter().enumerate().map(matrix).collect()))
}

/// One matrix for each joint; `None` if the skin has none, which stands for identity matrices.
fn inverse_bind_matrices(document: &Document, accessors: &Accessors, skin: usize) -> Result<Option<Vec<DAffine3>>> {
    let skin_object = &document.skins[skin];
    let Some(index) = skin_object.inverse_bind_matrices else { return Ok(None) };
    // Check the format, and that there is a matrix for each joint.
    let elements = accessors.get(index.value());
    elements.require_format(document, "inverseBindMatrices", "MAT4 of floats", |format| {
        format.shape == Shape::Matrix(4) && format.component == Component::F32
    })?;
    let joint_count = skin_object.joints.len();
    if elements.count < joint_count {
        let fault = SkinFault::TooFewMatrices { joints: joint_count, matrices: elements.count };
        return Err(document.error_at(format!("/skins/{skin}"), fault));
    }
    // Read only as many as there are joints: an accessor may have more.
    let first: Vec<u32> = (0..joint_count as u32).collect();
    let matrices: Vec<[f32; 16]> = elements.floats(document, Selection::Indices(&first))?;
    let affine = |m: &[f32; 16]| DAffine3::from_mat4(DMat4::from_cols_array(&m.map(f64::from)));
    Ok(Some(matrices.iter().map(affine).collect()))
}
