//! Which entry of the hierarchy is which instance: the geometry that is shown, with its device slots and world boxes.

use glam::DVec3;
use rayon::prelude::*;
use slotmap::{Key, SecondaryMap};

use super::geometry_table::GeometryTable;
use super::material_table::MaterialTable;
use super::pack::InstanceTransform;
use super::view_dependent::ViewDependentState;
use crate::Result;
use crate::accel::{Tlas, TlasUpdate};
use crate::device::layout::{InstanceFlags, InstanceRecord, NONE, PrimitiveRange};
use crate::device::{DeviceArrays, Needs};
use crate::error::{Resource, require_within};
use crate::graph::{GeometryKey, Hierarchy, KeyMap, MaterialKey, NodeKey, NodePath};
use crate::math::Aabb;

/// An entry of the hierarchy that shows a geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Member {
    pub(super) entry: u32,
    pub(super) node: NodeKey,
    pub(super) geometry: GeometryKey,
    pub(super) material: MaterialKey,
}

/// What an instance shows, and for which appearance of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InstanceSource {
    /// The node with the geometry core.
    pub path: NodePath,
    /// Its geometry.
    pub geometry: GeometryKey,
    /// Its material: its core's, or that of a material group above it.
    pub material: MaterialKey,
}

/// The instances, by device slot.
#[derive(Debug, Default)]
pub(super) struct InstanceTable {
    slots: Vec<InstanceSlot>,
    free_slots: Vec<u32>,
    /// World box of each slot relative to the render origin; empty for one that cannot be hit.
    world_bounds: Vec<Aabb>,
    /// The slot of each entry, or [`NONE`].
    slot_of_entry: Vec<u32>,
    geometry_users: Users<GeometryKey>,
    material_users: Users<MaterialKey>,
    /// Slots whose records must be written.
    stale_slots: Vec<u32>,
    /// Slots whose boxes differ from what the top level holds.
    slots_with_new_bounds: Vec<u32>,
    tlas: Tlas,
    totals: InstanceTotals,
}

#[derive(Clone, Debug, Default)]
struct InstanceSlot {
    member: Option<Member>,
    is_stale: bool,
    /// Triangles that can be hit, or cannot because the matrix is singular.
    triangles: usize,
}

/// What the members are, in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct InstanceTotals {
    /// Members that can be hit.
    pub(super) instances: usize,
    /// Members whose matrix keeps their triangles from being hit.
    pub(super) singular_instances: usize,
    /// Triangles of the members that can be hit.
    pub(super) triangles: usize,
}

/// What turns a member into a device record.
#[derive(Clone, Copy)]
pub(super) struct RecordInputs<'a> {
    pub(super) hierarchy: &'a Hierarchy,
    pub(super) view: &'a ViewDependentState,
    pub(super) geometries: &'a GeometryTable,
    pub(super) materials: &'a MaterialTable,
    pub(super) origin: DVec3,
}

/// Membership.
impl InstanceTable {
    /// Makes room for entries up to a count.
    pub(super) fn set_entry_count(&mut self, count: usize) {
        self.slot_of_entry.resize(count, NONE);
    }

    /// Makes an entry a member, another member, or none.
    ///
    /// # Errors
    /// [`Error::Limit`](crate::Error::Limit) beyond 2^28 members: a leaf's instance index has 28 bits.
    pub(super) fn set_member(&mut self, entry: usize, member: Option<Member>, arrays: &mut DeviceArrays) -> Result<()> {
        let slot = self.slot_of_entry[entry];
        match member {
            None if slot == NONE => {}
            None => self.free(slot, arrays),
            Some(member) if slot == NONE => {
                let slot = self.allocate()?;
                self.occupy(slot, member);
            }
            Some(member) => {
                self.remove_from_users(slot);
                self.occupy(slot, member);
            }
        }
        Ok(())
    }

    /// Gives the members new entries after all of them changed: nodes keep their slots where they can. The table then has
    /// these members. O(members).
    pub(super) fn replace_all_members(
        &mut self,
        members: impl Iterator<Item = Member>,
        entry_count: usize,
        arrays: &mut DeviceArrays,
    ) -> Result<()> {
        // The slots of each node, linked.
        let mut first: SecondaryMap<NodeKey, u32> = SecondaryMap::new();
        let mut next = vec![NONE; self.slots.len()];
        for slot in (0..self.slots.len()).rev() {
            if let Some(member) = self.slots[slot].member {
                next[slot] = first.insert(member.node, slot as u32).unwrap_or(NONE);
            }
        }
        self.slot_of_entry.clear();
        self.set_entry_count(entry_count);
        let mut kept = vec![false; self.slots.len()];
        for member in members {
            let old = first.get(member.node).copied().filter(|&slot| slot != NONE);
            let slot = match old {
                Some(slot) => {
                    first.insert(member.node, next[slot as usize]);
                    kept[slot as usize] = true;
                    self.remove_from_users(slot);
                    slot
                }
                None => self.allocate()?,
            };
            self.occupy(slot, member);
        }
        for slot in (0..kept.len()).filter(|&slot| !kept[slot]) {
            // A slot that was free before may have been taken.
            let entry = self.slots[slot].member.map(|member| member.entry as usize);
            if entry.is_some_and(|entry| self.slot_of_entry.get(entry) != Some(&(slot as u32))) {
                self.free(slot as u32, arrays);
            }
        }
        Ok(())
    }

    /// The members of these geometries and materials must be written again.
    pub(super) fn mark_users_stale(&mut self, geometries: &[GeometryKey], materials: &[MaterialKey]) {
        let of_geometries = geometries.iter().flat_map(|&key| self.geometry_users.slots(key));
        let of_materials = materials.iter().flat_map(|&key| self.material_users.slots(key));
        let slots: Vec<u32> = of_geometries.chain(of_materials).copied().collect();
        slots.into_iter().for_each(|slot| self.mark_stale(slot));
    }

    /// The entry's member, if it has one, must be written again.
    #[inline]
    pub(super) fn mark_entry(&mut self, entry: usize) {
        let slot = self.slot_of_entry[entry];
        if slot != NONE {
            self.mark_stale(slot);
        }
    }

    /// All members must be written again.
    pub(super) fn mark_all(&mut self) {
        for slot in 0..self.slots.len() {
            if self.slots[slot].member.is_some() {
                self.mark_stale(slot as u32);
            }
        }
    }

    fn mark_stale(&mut self, slot: u32) {
        if !std::mem::replace(&mut self.slots[slot as usize].is_stale, true) {
            self.stale_slots.push(slot);
        }
    }

    fn allocate(&mut self) -> Result<u32> {
        if let Some(slot) = self.free_slots.pop() {
            return Ok(slot);
        }
        let (slot, limit) = (self.slots.len() as u32, PrimitiveRange::MAX_FIRST);
        require_within(Resource::Instances, u64::from(slot) + 1, limit.into())?;
        self.slots.push(InstanceSlot::default());
        self.world_bounds.push(Aabb::EMPTY);
        Ok(slot)
    }

    fn occupy(&mut self, slot: u32, member: Member) {
        self.geometry_users.add(member.geometry, slot);
        self.material_users.add(member.material, slot);
        self.slot_of_entry[member.entry as usize] = slot;
        self.slots[slot as usize].member = Some(member);
        self.mark_stale(slot);
    }

    fn remove_from_users(&mut self, slot: u32) {
        if let Some(member) = self.slots[slot as usize].member {
            self.geometry_users.remove(member.geometry, slot);
            self.material_users.remove(member.material, slot);
        }
    }

    fn free(&mut self, slot: u32, arrays: &mut DeviceArrays) {
        self.remove_from_users(slot);
        if let Some(member) = self.slots[slot as usize].member.take()
            && let Some(at) = self.slot_of_entry.get_mut(member.entry as usize).filter(|at| **at == slot)
        {
            *at = NONE;
        }
        self.write_slot(slot, bytemuck::Zeroable::zeroed(), Aabb::EMPTY, 0, arrays);
        self.free_slots.push(slot);
    }
}

/// Records.
impl InstanceTable {
    /// Writes the records of the members that must be; how many.
    pub(super) fn write_stale_records(&mut self, sources: &RecordInputs<'_>, arrays: &mut DeviceArrays) -> usize {
        let mut stale = std::mem::take(&mut self.stale_slots);
        let (mut placed, mut written) = (Vec::new(), 0);
        // As many at a time as stay in a cache.
        for stale in stale.chunks(1 << 12) {
            let members = stale.par_iter().with_min_len(256).map(|&slot| self.slots[slot as usize].member);
            members.map(|member| member.map(|member| instance_record(&member, sources))).collect_into_vec(&mut placed);
            for (&slot, placed) in stale.iter().zip(placed.drain(..)) {
                self.slots[slot as usize].is_stale = false;
                if let Some((record, bounds, triangles)) = placed {
                    self.write_slot(slot, record, bounds, triangles, arrays);
                    written += 1;
                }
            }
        }
        stale.clear();
        self.stale_slots = stale;
        if self.free_slots.len() == self.slots.len() {
            // Nobody is left: start anew, with no more memory than that takes.
            let slot_at = std::mem::take(&mut self.slot_of_entry);
            *self = Self { slot_of_entry: slot_at, ..Self::default() };
            arrays.instances.truncate(0);
            arrays.tlas_nodes.truncate(0);
        }
        written
    }

    fn write_slot(
        &mut self,
        slot: u32,
        record: InstanceRecord,
        bounds: Aabb,
        triangles: usize,
        arrays: &mut DeviceArrays,
    ) {
        let index = slot as usize;
        arrays.instances.write(index, &[record]);
        if self.world_bounds[index] != bounds {
            self.totals.count(self.world_bounds[index], self.slots[index].triangles, false);
            self.totals.count(bounds, triangles, true);
            self.world_bounds[index] = bounds;
            self.slots_with_new_bounds.push(slot);
        } else if self.slots[index].triangles != triangles {
            self.totals.count(bounds, self.slots[index].triangles, false);
            self.totals.count(bounds, triangles, true);
        }
        self.slots[index].triangles = triangles;
    }

    /// Brings the top level up to date.
    pub(super) fn update_tlas(&mut self, arrays: &mut DeviceArrays) -> TlasUpdate {
        let moved = std::mem::take(&mut self.slots_with_new_bounds);
        self.tlas.update(&mut arrays.tlas_nodes, &self.world_bounds, &moved)
    }

    /// What the members are.
    pub(super) fn totals(&self) -> InstanceTotals {
        self.totals
    }

    /// The member in a device slot.
    pub(super) fn member(&self, slot: u32) -> Option<&Member> {
        self.slots.get(slot as usize)?.member.as_ref()
    }

    /// The geometries that members have.
    pub(super) fn geometries(&self) -> &Users<GeometryKey> {
        &self.geometry_users
    }

    pub(super) fn geometries_mut(&mut self) -> &mut Users<GeometryKey> {
        &mut self.geometry_users
    }

    pub(super) fn materials_mut(&mut self) -> &mut Users<MaterialKey> {
        &mut self.material_users
    }

    /// The materials that members have.
    pub(super) fn materials(&self) -> &Users<MaterialKey> {
        &self.material_users
    }
}

impl InstanceTotals {
    /// Counts a member in or out.
    fn count(&mut self, bounds: Aabb, triangles: usize, enters: bool) {
        let add = |total: &mut usize, n| *total = if enters { *total + n } else { *total - n };
        match (bounds.is_empty(), triangles) {
            (false, _) => {
                add(&mut self.instances, 1);
                add(&mut self.triangles, triangles);
            }
            (true, 0) => {}
            (true, _) => add(&mut self.singular_instances, 1),
        }
    }
}

/// The slots that use each geometry, or each material.
#[derive(Debug)]
pub(super) struct Users<K: Key> {
    /// Of two generations of one slot, while members are exchanged, the one that comes.
    slots: KeyMap<K, Vec<u32>>,
    /// Where each slot stands in its list.
    positions_in_list: Vec<u32>,
    /// Whether some key got its first user or lost its last.
    changed: bool,
}

impl<K: Key> Default for Users<K> {
    fn default() -> Self {
        Self { slots: KeyMap::new(), positions_in_list: Vec::new(), changed: false }
    }
}

impl<K: Key> Users<K> {
    /// The keys that have users.
    pub(super) fn keys(&self) -> impl Iterator<Item = K> + '_ {
        self.slots.iter().map(|(key, _)| key)
    }

    pub(super) fn has(&self, key: K) -> bool {
        self.slots.contains_key(key)
    }

    /// Whether some key got its first user or lost its last since [`forget_changes`](Self::forget_changes).
    pub(super) fn changed(&self) -> bool {
        self.changed
    }

    pub(super) fn forget_changes(&mut self) {
        self.changed = false;
    }

    fn slots(&self, key: K) -> &[u32] {
        self.slots.get(key).map_or(&[], Vec::as_slice)
    }

    fn add(&mut self, key: K, slot: u32) {
        if !self.slots.contains_key(key) {
            self.slots.insert(key, Vec::new());
        }
        let slots = &mut self.slots[key];
        if slots.is_empty() {
            self.changed = true;
        }
        if self.positions_in_list.len() <= slot as usize {
            self.positions_in_list.resize(slot as usize + 1, 0);
        }
        self.positions_in_list[slot as usize] = slots.len() as u32;
        slots.push(slot);
    }

    fn remove(&mut self, key: K, slot: u32) {
        let Some(slots) = self.slots.get_mut(key) else { return };
        let place = self.positions_in_list[slot as usize];
        slots.swap_remove(place as usize);
        if let Some(&other) = slots.get(place as usize) {
            self.positions_in_list[other as usize] = place;
        }
        if slots.is_empty() {
            self.slots.remove(key);
            self.changed = true;
        }
    }
}

/// The device record, the world box and the triangles of a member; zeros and an empty box if it cannot be hit.
fn instance_record(member: &Member, sources: &RecordInputs<'_>) -> (InstanceRecord, Aabb, usize) {
    let nothing = |triangles| (bytemuck::Zeroable::zeroed(), Aabb::EMPTY, triangles);
    let (Some(geometry), Some(material)) =
        (sources.geometries.get(member.geometry), sources.materials.get(member.material))
    else {
        return nothing(0);
    };
    let entry = member.entry as usize;
    let world_from_local = sources.view.world_from_local(sources.hierarchy, entry);
    if geometry.nodes.is_empty() {
        return nothing(geometry.triangle_count());
    }
    let Some(placement) = InstanceTransform::new(&world_from_local, sources.origin, &geometry.support) else {
        return nothing(geometry.triangle_count());
    };
    let indices =
        [geometry.nodes.start, geometry.triangles.start, geometry.streams.record.start, material.record.start];
    let mask = sources.hierarchy.resolved()[entry].mask;
    let mut flags = material.instance_flags;
    flags.set(InstanceFlags::THIN, material.needs.contains(Needs::REFRACTION) && !geometry.encloses());
    flags.set(InstanceFlags::HAS_DUPLICATES, geometry.has_duplicates);
    (placement.instance(indices, mask, flags, member.node), placement.bounds, geometry.triangle_count())
}
