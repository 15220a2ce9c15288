//! Which node is which instance: the visible geometry nodes in preorder, their device slots and world boxes.

use std::ops::Range;

use glam::DVec3;
use slotmap::SecondaryMap;

use super::Needs;
use super::geometry_cache::GeometryCache;
use super::material_table::MaterialTable;
use super::pack::Placement;
use crate::accel::Tlas;
use crate::device::DeviceArrays;
use crate::device::layout::{Instance, InstanceFlags, NONE, PrimitiveRange};
use crate::graph::{GeometryKey, Hierarchy, MaterialKey, NodeKey, NodePath};
use crate::math::Aabb;
use crate::{Error, Result};

/// A visible node with a geometry core.
#[derive(Clone, Copy, Debug)]
pub(super) struct Member {
    /// Index in the hierarchy's preorder.
    pub(super) preorder: u32,
    pub(super) node: NodeKey,
    pub(super) geometry: GeometryKey,
    pub(super) material: MaterialKey,
}

/// What an instance shows, and for which node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InstanceSource {
    /// The node with the geometry core.
    pub path: NodePath,
    /// Its geometry.
    pub geometry: GeometryKey,
    /// Its material.
    pub material: MaterialKey,
}

/// The instances, in preorder.
#[derive(Debug, Default)]
pub(super) struct InstanceTable {
    members: Vec<Member>,
    /// Device slot of each member. A node keeps its slot as long as it is a member.
    slots: Vec<u32>,
    /// World box of each member relative to the render origin; empty for one that cannot be hit.
    boxes: Vec<Aabb>,
    slot_of: SecondaryMap<NodeKey, u32>,
    /// Member of each device slot, or [`NONE`].
    member_of: Vec<u32>,
    free_slots: Vec<u32>,
    /// Whether `slots` or `boxes` differ from what the top level was built over.
    tlas_stale: bool,
}

/// What the members are, in numbers.
#[derive(Debug, Default)]
pub(super) struct Totals {
    /// Members that can be hit.
    pub(super) instances: usize,
    /// Members whose matrix keeps their triangles from being hit.
    pub(super) singular_instances: usize,
    /// Triangles of the members that can be hit.
    pub(super) triangles: usize,
}

/// What turns a member into a device record.
pub(super) struct Sources<'a> {
    pub(super) hierarchy: &'a Hierarchy,
    pub(super) geometries: &'a GeometryCache,
    pub(super) materials: &'a MaterialTable,
    pub(super) origin: DVec3,
}

impl InstanceTable {
    /// Replaces the members. Those that were members keep their slots; slots nobody has any more are zeroed.
    ///
    /// # Errors
    /// [`Error::Limit`] beyond 2^28 members: a leaf's instance index has 28 bits.
    pub(super) fn set_members(&mut self, members: Vec<Member>, arrays: &mut DeviceArrays) -> Result<()> {
        let (needed, limit) = (members.len() as u64, u64::from(PrimitiveRange::MAX_FIRST));
        if needed > limit {
            return Err(Error::Limit { what: "the instances array", needed, limit, hint: "" });
        }
        let mut slot_of = SecondaryMap::new();
        for member in &members {
            if let Some(slot) = self.slot_of.remove(member.node) {
                slot_of.insert(member.node, slot);
            }
        }
        for (_, slot) in self.slot_of.drain() {
            arrays.instances.write(slot as usize, &[bytemuck::Zeroable::zeroed()]);
            self.free_slots.push(slot);
        }
        // Lowest first, so that slots do not depend on the order of removal more than they must.
        self.free_slots.sort_unstable_by(|a, b| b.cmp(a));
        let mut end = (slot_of.len() + self.free_slots.len()) as u32;
        let old_slots = std::mem::take(&mut self.slots);
        for member in &members {
            let slot = slot_of.get(member.node).copied().or_else(|| self.free_slots.pop()).unwrap_or_else(|| {
                end += 1;
                end - 1
            });
            slot_of.insert(member.node, slot);
            self.slots.push(slot);
        }
        self.tlas_stale |= self.members.len() != members.len() || self.slots != old_slots;
        self.slot_of = slot_of;
        self.boxes.resize(members.len(), Aabb::EMPTY);
        self.members = members;
        // The array ends with the last slot in use.
        let end = self.slots.iter().max().map_or(0, |&last| last + 1);
        self.free_slots.retain(|&slot| slot < end);
        self.member_of.clear();
        self.member_of.resize(end as usize, NONE);
        for (member, &slot) in (0..).zip(&self.slots) {
            self.member_of[slot as usize] = member;
        }
        arrays.instances.truncate(end as usize);
        Ok(())
    }

    /// Writes the device records of the members in the given range of [`members`](Self::members).
    pub(super) fn write(&mut self, range: Range<usize>, sources: &Sources<'_>, arrays: &mut DeviceArrays) {
        for i in range {
            let (record, bounds) = place(&self.members[i], sources);
            self.tlas_stale |= self.boxes[i] != bounds;
            self.boxes[i] = bounds;
            arrays.instances.write(self.slots[i] as usize, &[record]);
        }
    }

    /// Builds the top level over the members that can be hit, if any of them changed; whether it did.
    pub(super) fn update_tlas(&mut self, arrays: &mut DeviceArrays) -> bool {
        if !std::mem::take(&mut self.tlas_stale) {
            return false;
        }
        arrays.tlas_nodes.replace(&Tlas::build(&self.boxes, &self.slots).nodes);
        true
    }

    /// What stands at a device slot.
    pub(super) fn source(&self, slot: u32) -> Option<InstanceSource> {
        let member = *self.member_of.get(slot as usize)?;
        let &Member { node, geometry, material, .. } = self.members.get(member as usize)?;
        Some(InstanceSource { path: node.into(), geometry, material })
    }

    /// The members, in preorder.
    pub(super) fn members(&self) -> &[Member] {
        &self.members
    }

    /// The members whose preorder index lies in `subtree`, as a range of [`members`](Self::members). O(log members).
    pub(super) fn members_in(&self, subtree: Range<usize>) -> Range<usize> {
        let first_from = |end: usize| self.members.partition_point(|m| (m.preorder as usize) < end);
        first_from(subtree.start)..first_from(subtree.end)
    }

    /// Counts what can be hit. O(members).
    pub(super) fn totals(&self, geometries: &GeometryCache) -> Totals {
        let mut totals = Totals::default();
        for (member, bounds) in self.members.iter().zip(&self.boxes) {
            let triangles = geometries.get(member.geometry).map_or(0, |entry| entry.triangle_count);
            match (bounds.is_empty(), triangles) {
                (false, _) => {
                    totals.instances += 1;
                    totals.triangles += triangles;
                }
                (true, 0) => {}
                (true, _) => totals.singular_instances += 1,
            }
        }
        totals
    }
}

/// The device record and the world box of a member; zeros and an empty box if it cannot be hit.
fn place(member: &Member, sources: &Sources<'_>) -> (Instance, Aabb) {
    let nothing = (bytemuck::Zeroable::zeroed(), Aabb::EMPTY);
    let (Some(geometry), Some(material)) =
        (sources.geometries.get(member.geometry), sources.materials.get(member.material))
    else {
        return nothing;
    };
    let preorder = member.preorder as usize;
    let world_from_local = &sources.hierarchy.worlds()[preorder];
    if geometry.nodes.is_empty() {
        return nothing;
    }
    let Some(placement) = Placement::new(world_from_local, sources.origin, &geometry.bounds) else { return nothing };
    let indices = [geometry.nodes.start, geometry.triangles.start, geometry.streams.start, material.record.start];
    let mask = sources.hierarchy.masks()[preorder];
    let mut flags = material.instance_flags;
    flags.set(InstanceFlags::THIN, material.needs.contains(Needs::REFRACTION) && !geometry.encloses());
    (placement.instance(indices, mask, flags, member.node), placement.bounds)
}
