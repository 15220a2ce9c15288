//! From a member to its device record: the one place that reads several tables.

use glam::{DAffine3, DVec3};

use super::geometry_table::{GeometryEntry, GeometryTable};
use super::instance_table::{CompiledInstance, Member};
use super::material_table::{MaterialEntry, MaterialTable};
use super::pack::InstanceTransform;
use super::view_dependent::ViewDependentState;
use crate::device::Needs;
use crate::device::layout::InstanceFlags;
use crate::graph::{Hierarchy, WallKind};

/// Everything that an instance record is computed from.
#[derive(Clone, Copy)]
pub(super) struct RecordInputs<'a> {
    pub(super) hierarchy: &'a Hierarchy,
    pub(super) view: &'a ViewDependentState,
    pub(super) geometries: &'a GeometryTable,
    pub(super) materials: &'a MaterialTable,
    /// The render origin.
    pub(super) origin: DVec3,
}

/// The record, world box and triangle count of an instance; a zero record and an empty box if no ray can hit it.
pub(super) fn instance_record(member: &Member, inputs: &RecordInputs<'_>) -> CompiledInstance {
    // 1. The assets. All that members use were stored before records are written.
    let (Some(geometry), Some(material)) =
        (inputs.geometries.get(member.geometry), inputs.materials.get(member.material))
    else {
        return CompiledInstance::unhittable(0);
    };
    // 2. No triangle can be hit: there are none, or all are degenerate.
    if geometry.nodes.is_empty() {
        return CompiledInstance::unhittable(geometry.triangle_count());
    }
    // 3. The transform and the world box; a matrix that leaves a line or a point, or is beyond f32, has none.
    let entry = member.entry as usize;
    let world_from_local = inputs.view.world_from_local(inputs.hierarchy, entry);
    let Some(transform) = InstanceTransform::new(&world_from_local, inputs.origin, &geometry.support) else {
        return CompiledInstance::unhittable(geometry.triangle_count());
    };
    // 4. Offsets into the device arrays, flags, and the record.
    let indices =
        [geometry.nodes.start, geometry.triangles.start, geometry.streams.record.start, material.record.start];
    let mask = inputs.hierarchy.resolved()[entry].mask;
    let mut flags = material.instance_flags;
    flags.set(InstanceFlags::THIN, material.needs.contains(Needs::REFRACTION) && is_thin(geometry, material));
    flags.set(InstanceFlags::HAS_DUPLICATES, geometry.has_duplicates);
    CompiledInstance {
        record: transform.instance_record(indices, mask, flags, member.node),
        bounds: transform.bounds,
        placement_hash: hash(&world_from_local),
        displacement: transform.displacement,
        triangle_count: geometry.triangle_count(),
    }
}

/// A hash of a matrix, bit by bit.
fn hash(matrix: &DAffine3) -> u64 {
    matrix
        .to_cols_array()
        .iter()
        .fold(0, |hash: u64, number| (hash.rotate_left(5) ^ number.to_bits()).wrapping_mul(0x517c_c1b7_2722_0a95))
}

/// Whether a transmissive surface is a thin wall: as its material says, else as its geometry looks.
fn is_thin(geometry: &GeometryEntry, material: &MaterialEntry) -> bool {
    match material.wall() {
        WallKind::Auto => !geometry.is_solid(),
        WallKind::Thin => true,
        WallKind::Solid => false,
    }
}
