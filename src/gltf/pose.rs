//! The rest pose: morph targets at their default weights, and skins in the rest pose of their joints.
//!
//! Both are applied to the geometry at import, in the order of the specification (3.7.2.2): first the morph targets,
//! then the skin.

use ::gltf::json;
use glam::{DAffine3, DMat3, Vec3, Vec4};
use json::mesh::Semantic;
use json::validation::Checked::Valid;

use super::accessor::Selection;
use super::format::{Component, Format};
use super::geometry::check_vertex_count;
use super::warnings::{Forgivable, cause_of};
use super::{AccessorFault, Accessors, Budget, Document, GltfFault, normals};
use crate::Result;

/// The deformation of a primitive's vertices, by the accessors that determine it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Pose {
    morphs: Vec<Morph>,
    skin: Option<Skin>,
}

/// A morph target with a weight that is not zero.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Morph {
    /// The bits of an f32, so that poses can be compared and hashed.
    weight: u32,
    positions: Option<usize>,
    normals: Option<usize>,
}

/// Skinning data: joint and weight accessors.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Skin {
    /// The index of the palette of joint matrices, among those of the import.
    palette: usize,
    /// Accessors of four joints and of their four weights, for each set.
    sets: Vec<(usize, usize)>,
}

impl Pose {
    /// The pose of a primitive for morph target weights and the index of a palette of joint matrices.
    /// `canonical_accessor` maps each accessor to the first equal one, `positions` is the accessor of the positions,
    /// whose length the others must have, and `pointer` is the primitive's, for messages.
    pub(super) fn new(
        document: &Document,
        accessors: &Accessors,
        canonical_accessor: &[usize],
        primitive: &json::mesh::Primitive,
        (weights, palette): (&[f32], Option<usize>),
        (positions, pointer): (usize, &str),
    ) -> Result<Self> {
        // 1. The morph targets whose weights are not zero.
        let targets = primitive.targets.as_deref().unwrap_or_default();
        let canonical =
            |index: Option<json::Index<json::Accessor>>| index.map(|index| canonical_accessor[index.value()]);
        if weights.iter().take(targets.len()).any(|weight| !weight.is_finite()) {
            return Err(document.error_at(pointer, GltfFault::NotFinite { what: "a weight of its morph targets" }));
        }
        let morph = |(target, &weight): (&json::mesh::MorphTarget, &f32)| Morph {
            weight: weight.to_bits(),
            positions: canonical(target.positions),
            normals: canonical(target.normals),
        };
        let morphs = targets.iter().zip(weights).filter(|(_, weight)| **weight != 0.0).map(morph).collect();

        // 2. The sets of joints and weights.
        let attribute =
            |semantic| primitive.attributes.get(&Valid(semantic)).map(|index| canonical_accessor[index.value()]);
        // A set has both joints and weights; the first number without both ends the list.
        let set = |n| Some((attribute(Semantic::Joints(n))?, attribute(Semantic::Weights(n))?));
        let sets: Vec<_> = (0..).map_while(set).collect();
        let skin = palette.filter(|_| !sets.is_empty()).map(|palette| Skin { palette, sets });

        // Check the formats and lengths of all these accessors.
        let pose = Self { morphs, skin };
        pose.check(document, accessors, positions, pointer)?;
        Ok(pose)
    }

    /// Whether it is skinned.
    pub(super) fn is_skinned(&self) -> bool {
        self.skin.is_some()
    }

    /// Upper bound of the bytes that [`apply`](Self::apply) allocates for a vertex.
    pub(super) fn bytes_per_vertex(&self) -> usize {
        let sets = self.skin.as_ref().map_or(0, |skin| skin.sets.len());
        self.morphs.len() * 2 * size_of::<Vec3>() + sets * (size_of::<[u32; 4]>() + size_of::<Vec4>())
    }

    /// The most faults that [`apply`](Self::apply) adds.
    pub(super) fn max_faults(&self) -> usize {
        self.skin.as_ref().map_or(0, |skin| skin.sets.len() + 1)
    }

    /// Moves the selected vertices into the rest pose; returns whether all positions are finite there. Adds to `faults`
    /// what is wrong with joints and weights, but has one reading.
    #[expect(clippy::too_many_arguments, reason = "the streams of a primitive, and where they come from")]
    pub(super) fn apply(
        &self,
        document: &Document,
        accessors: &Accessors,
        palettes: &[Vec<DAffine3>],
        selection: Selection,
        positions: &mut [Vec3],
        mut normals: Option<&mut [Vec3]>,
        faults: &mut Vec<Forgivable>,
    ) -> Result<bool> {
        // Add the weighted displacements of the morph targets.
        for morph in &self.morphs {
            let weight = f32::from_bits(morph.weight);
            add_deltas(document, accessors, selection, morph.positions, weight, positions)?;
            if let Some(normals) = normals.as_deref_mut() {
                add_deltas(document, accessors, selection, morph.normals, weight, normals)?;
            }
        }
        // Move the result with the joints.
        if let Some(skin) = &self.skin {
            skin.apply(document, accessors, &palettes[skin.palette], selection, (positions, normals), faults)?;
        }
        // Large weights, displacements and matrices can overflow.
        Ok(positions.iter().all(|p| p.is_finite()))
    }

    fn check(&self, document: &Document, accessors: &Accessors, positions: usize, pointer: &str) -> Result<()> {
        let vertex_count = accessors.get(positions).count;
        let require = |index: usize, role: &'static str, expected: &'static str, accepts: fn(Format) -> bool| {
            accessors.get(index).require_format(document, role, expected, accepts)?;
            check_vertex_count(document, accessors, index, vertex_count, pointer)
        };
        // Check the displacements of the morph targets, which may be quantized.
        for index in self.morphs.iter().flat_map(|morph| [morph.positions, morph.normals]).flatten() {
            require(index, "a morph target", "VEC3 of floats, bytes or shorts", |f| {
                f.is_vector(3) && f.component != Component::U32
            })?;
        }
        // Check the joints and weights of the skin.
        for &(joints, weights) in self.skin.iter().flat_map(|skin| &skin.sets) {
            require(joints, "JOINTS", "VEC4 of unsigned bytes or shorts", is_joints)?;
            require(weights, "WEIGHTS", "VEC4 of floats, or of normalized bytes or shorts", |f| {
                f.is_vector(4) && f.is_float_or_normalized()
            })?;
        }
        Ok(())
    }
}

impl Skin {
    fn apply(
        &self,
        document: &Document,
        accessors: &Accessors,
        palette: &[DAffine3],
        selection: Selection,
        (positions, mut normals): (&mut [Vec3], Option<&mut [Vec3]>),
        faults: &mut Vec<Forgivable>,
    ) -> Result<()> {
        // 1. Read the joints and weights of the selected vertices.
        let mut sets = Vec::new();
        for &(joints, weights) in &self.sets {
            let weights = accessors.get(weights).floats::<Vec4, 4>(document, selection)?;
            let (joints, fault) = read_joints(document, accessors, joints, palette.len(), selection, Some(&weights))?;
            faults.extend(fault);
            sets.push((joints, weights));
        }
        // 2. Transform each vertex by its blended joint matrix, and its normal by the cofactor matrix.
        let (mut weightless, mut weightless_count) = (None, 0_usize);
        for (vertex, position) in positions.iter_mut().enumerate() {
            let influences = sets.iter().flat_map(|(joints, weights)| {
                let influences = joints[vertex].iter().zip(weights[vertex].to_array());
                influences.filter_map(|(&joint, weight)| Some((palette.get(joint as usize)?, weight)))
            });
            // A vertex without a weight above 0 hangs on its first joint alone.
            let matrix = blend_joint_matrices(influences).or_else(|| {
                weightless.get_or_insert(vertex);
                weightless_count += 1;
                palette.get(sets.first()?.0[vertex][0] as usize).copied()
            });
            // A skin without joints moves nothing.
            let Some(matrix) = matrix else { continue };
            *position = matrix.transform_point3(position.as_dvec3()).as_vec3();
            if let Some(normals) = normals.as_deref_mut() {
                let normal = cofactor(&matrix.matrix3) * normals[vertex].as_dvec3();
                // A normal that vanishes stays zero: `normals::normalize` replaces it later.
                normals[vertex] = normals::try_unit_vector(normal).unwrap_or(Vec3::ZERO);
            }
        }

        // 3. Tell of vertices without weights, by the accessor of the first set.
        if let (Some(first), Some(&(_, weights))) = (weightless, self.sets.first()) {
            let fault = AccessorFault::NoWeight { element: selection.element(first) };
            let fallback = match weightless_count - 1 {
                0 => format!("{fault}: the vertex hangs on its first joint"),
                more => format!("{fault}, and of {more} more: these vertices hang on their first joints"),
            };
            let error = accessors.get(weights).error(document, fault);
            faults.push(Forgivable { error, feature: "WEIGHTS_0", fallback });
        }
        Ok(())
    }
}

/// The joints of the selected vertices, each below `joint_count`. A joint that is not is an error, unless its weight is
/// not above 0: then it becomes the first joint, and the fault is returned. Without `weights`, all joints count.
fn read_joints(
    document: &Document,
    accessors: &Accessors,
    index: usize,
    joint_count: usize,
    selection: Selection,
    weights: Option<&[Vec4]>,
) -> Result<(Vec<[u32; 4]>, Option<Forgivable>)> {
    let mut joints: Vec<[u32; 4]> = accessors.get(index).integers(document, selection)?;
    let (mut unused, mut unused_count) = (None, 0);
    for (vertex, joint) in joints
        .iter_mut()
        .enumerate()
        .flat_map(|(vertex, four)| four.iter_mut().enumerate().map(move |(slot, joint)| ((vertex, slot), joint)))
    {
        if (*joint as usize) < joint_count {
            continue;
        }
        let error = accessors.get(index).error(document, AccessorFault::JointOutOfRange { joint: *joint, joint_count });
        let (vertex, slot) = vertex;
        if weights.is_none_or(|weights| weights[vertex][slot] > 0.0) {
            return Err(error);
        }
        unused_count += 1;
        unused.get_or_insert(error);
        *joint = 0;
    }
    let fault = unused.map(|error| {
        let more = if unused_count == 1 { String::new() } else { format!(", and {} more", unused_count - 1) };
        let fallback = format!("{}{more}: ignored, since the weight is zero", cause_of(&error));
        Forgivable { error, feature: "JOINTS", fallback }
    });
    Ok((joints, fault))
}

/// Checks that a JOINTS accessor stays below the number of joints, whether or not a node uses it; except where the
/// accessor of the weights, if there is one, says that a joint has none.
pub(super) fn check_joints(
    document: &Document,
    accessors: &Accessors,
    (index, weights): (usize, Option<usize>),
    joint_count: usize,
    budget: &mut Budget,
) -> Result<()> {
    let elements = accessors.get(index);
    elements.require_format(document, "JOINTS", "VEC4 of unsigned bytes or shorts", is_joints)?;
    if !elements.has_data() {
        return Ok(());
    }
    let size = size_of::<[u32; 4]>() + size_of::<Vec4>();
    budget.charge(elements.count, size, document, || format!("/accessors/{index}"))?;
    // Weights that cannot be read excuse nothing.
    let weights = weights.map(|weights| accessors.get(weights)).filter(|weights| weights.count == elements.count);
    let weights = weights.and_then(|weights| weights.floats::<Vec4, 4>(document, Selection::All).ok());
    read_joints(document, accessors, index, joint_count, Selection::All, weights.as_deref()).map(drop)
}

fn is_joints(format: Format) -> bool {
    format.is_vector(4) && matches!(format.component, Component::U8 | Component::U16)
}

fn add_deltas(
    document: &Document,
    accessors: &Accessors,
    selection: Selection,
    deltas: Option<usize>,
    weight: f32,
    values: &mut [Vec3],
) -> Result<()> {
    let Some(deltas) = deltas else { return Ok(()) };
    let deltas: Vec<Vec3> = accessors.get(deltas).floats(document, selection)?;
    values.iter_mut().zip(deltas).for_each(|(value, delta)| *value += weight * delta);
    Ok(())
}

/// The weighted average of joint matrices. The weights are normalized, and those that are not above 0 ignored; `None`
/// if none is above 0.
fn blend_joint_matrices<'a>(influences: impl Iterator<Item = (&'a DAffine3, f32)>) -> Option<DAffine3> {
    let (mut matrix, mut total) = (DAffine3::ZERO, 0.0);
    for (joint, weight) in influences.filter(|(_, weight)| *weight > 0.0) {
        let weight = f64::from(weight);
        matrix.matrix3 += joint.matrix3 * weight;
        matrix.translation += joint.translation * weight;
        total += weight;
    }
    (total > 0.0).then(|| DAffine3 { matrix3: matrix.matrix3 * (1.0 / total), translation: matrix.translation / total })
}

/// The cofactor matrix, which transforms normals: the inverse transpose times the determinant, but defined for singular
/// matrices too.
fn cofactor(m: &DMat3) -> DMat3 {
    let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
    DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn weights_need_not_sum_to_one() {
        let matrices = [DAffine3::from_translation(DVec3::X), DAffine3::from_translation(DVec3::Y * 3.0)];
        let blended = blend_joint_matrices(matrices.iter().zip([0.5, 1.5])).unwrap();
        assert_eq!(blended.translation, DVec3::new(0.25, 2.25, 0.0));
        assert_eq!(blended.matrix3, DMat3::IDENTITY);
        assert!(blend_joint_matrices(matrices.iter().zip([0.0, -1.0])).is_none());
    }

    #[test]
    fn the_cofactor_turns_normals_as_the_inverse_transpose_does() {
        let m = DMat3::from_cols(DVec3::new(2.0, 0.5, 0.0), DVec3::new(0.0, 3.0, 1.0), DVec3::new(1.0, 0.0, 4.0));
        let expected = m.inverse().transpose() * m.determinant();
        assert!((cofactor(&m) - expected).abs_diff_eq(DMat3::ZERO, 1e-12));
    }
}
