//! The instances of the compiled scene: which hierarchy entry is which element of the `instances` array.

use bytemuck::Zeroable as _;
use rayon::prelude::*;
use slotmap::SecondaryMap;

use super::instance_bounds::InstanceBounds;
use super::users::Users;
use crate::Result;
use crate::device::DeviceBuffer;
use crate::device::layout::{InstanceRecord, NONE, PrimitiveRange};
use crate::error::{Resource, require_within};
use crate::graph::{GeometryKey, MaterialKey, NodeKey};
use crate::math::Aabb;

/// A hierarchy entry that shows a geometry: one instance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Member {
    pub(super) entry: u32,
    pub(super) node: NodeKey,
    pub(super) geometry: GeometryKey,
    pub(super) material: MaterialKey,
}

/// What a member is compiled to.
#[derive(Clone, Copy)]
pub(super) struct CompiledInstance {
    pub(super) record: InstanceRecord,
    /// World box, relative to the render origin; empty if no ray can hit the instance.
    pub(super) bounds: Aabb,
    /// A hash of the matrix in f64.
    pub(super) placement_hash: u64,
    /// How far f32 displaces it, relative to its coordinates.
    pub(super) displacement: f64,
    /// Triangles of the geometry, whether they can be hit or not.
    pub(super) triangle_count: usize,
}

impl CompiledInstance {
    /// A zero record, without a box.
    pub(super) fn unhittable(triangle_count: usize) -> Self {
        Self {
            record: InstanceRecord::zeroed(),
            bounds: Aabb::EMPTY,
            placement_hash: 0,
            displacement: 0.0,
            triangle_count,
        }
    }
}

/// The instances by slot: the index in the `instances` array. A slot is unused, or holds one member.
#[derive(Debug, Default)]
pub(super) struct InstanceTable {
    slots: Vec<InstanceSlot>,
    free_slots: Vec<u32>,
    /// The slot of each entry, or [`NONE`].
    slot_of_entry: Vec<u32>,
    /// Slots that have lost their member since records were last written, in that order. Some may be in use again.
    vacated_slots: Vec<u32>,
    /// Slots whose records must be written.
    stale_slots: Vec<u32>,
    totals: InstanceTotals,
}

#[derive(Clone, Debug, Default)]
struct InstanceSlot {
    member: Option<Member>,
    /// Whether the slot is in `stale_slots`.
    is_stale: bool,
    /// Whether a ray can hit the instance, as counted in the totals.
    is_hittable: bool,
    /// How far f32 displaces the instance, relative to its coordinates.
    displacement: f64,
    /// Triangles of the instance's geometry, as counted in the totals, whether they can be hit or not.
    triangle_count: usize,
}

/// Counts over all instances.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct InstanceTotals {
    /// Instances that can be hit.
    pub(super) instances: usize,
    /// Instances that no ray can hit although they have triangles: their matrix scales two axes to zero or does
    /// not fit f32, or all their triangles are degenerate.
    pub(super) unhittable_instances: usize,
    /// Those that f32 displaces by more than [`MAX_DISPLACEMENT`] of their coordinates.
    pub(super) displaced_instances: usize,
    /// Triangles of the instances that can be hit.
    pub(super) triangles: usize,
}

/// What f32 displaces by more than this, relative to its coordinates, is reported: 2^-20.
const MAX_DISPLACEMENT: f64 = 1.0 / (1 << 20) as f64;

/// Adding, exchanging and removing members.
impl InstanceTable {
    /// Makes room for this many entries; new ones show no instance.
    pub(super) fn set_entry_count(&mut self, count: usize) {
        self.slot_of_entry.resize(count, NONE);
    }

    /// Sets which instance an entry shows: a new one, another one, or none.
    ///
    /// # Errors
    /// [`Error::Limit`](crate::Error::Limit) beyond 2^28 members: a leaf's instance index has 28 bits.
    pub(super) fn set_member(&mut self, entry: usize, member: Option<Member>, users: &mut Users) -> Result<()> {
        let slot = self.slot_of_entry[entry];
        match member {
            None if slot == NONE => {}
            None => self.free(slot, users),
            Some(member) if slot == NONE => {
                let slot = self.allocate()?;
                self.occupy(slot, member, users);
            }
            Some(member) => {
                self.remove_from_users(slot, users);
                self.occupy(slot, member, users);
            }
        }
        Ok(())
    }

    /// Replaces all members after the hierarchy has assigned new entry indices. An instance of the same node keeps its
    /// slot where possible, and so its place in the `instances` array and its leaf of the TLAS. O(members).
    pub(super) fn replace_all_members(
        &mut self,
        members: impl Iterator<Item = Member>,
        entry_count: usize,
        users: &mut Users,
    ) -> Result<()> {
        // 1. A linked list of the slots of each node.
        let mut first: SecondaryMap<NodeKey, u32> = SecondaryMap::new();
        let mut next = vec![NONE; self.slots.len()];
        for slot in (0..self.slots.len()).rev() {
            if let Some(member) = self.slots[slot].member {
                next[slot] = first.insert(member.node, slot as u32).unwrap_or(NONE);
            }
        }
        // 2. Each member gets the next slot of its node, or another one if there is none left.
        self.slot_of_entry.clear();
        self.set_entry_count(entry_count);
        let mut kept = vec![false; self.slots.len()];
        for member in members {
            let old = first.get(member.node).copied().filter(|&slot| slot != NONE);
            let slot = match old {
                Some(slot) => {
                    first.insert(member.node, next[slot as usize]);
                    kept[slot as usize] = true;
                    self.remove_from_users(slot, users);
                    slot
                }
                None => self.allocate()?,
            };
            self.occupy(slot, member, users);
        }
        // 3. Free the old slots that no member got. One that was free before may have been allocated above: then its
        //    entry refers to it.
        for slot in (0..kept.len()).filter(|&slot| !kept[slot]) {
            let entry = self.slots[slot].member.map(|member| member.entry as usize);
            if entry.is_some_and(|entry| self.slot_of_entry.get(entry) != Some(&(slot as u32))) {
                self.free(slot as u32, users);
            }
        }
        Ok(())
    }

    /// Marks the record of the entry's instance as stale, if it shows one.
    #[inline]
    pub(super) fn mark_entry(&mut self, entry: usize) {
        let slot = self.slot_of_entry[entry];
        if slot != NONE {
            self.mark_slot(slot);
        }
    }

    /// Marks the record of a slot in use as stale.
    pub(super) fn mark_slot(&mut self, slot: u32) {
        if !std::mem::replace(&mut self.slots[slot as usize].is_stale, true) {
            self.stale_slots.push(slot);
        }
    }

    /// Marks all records as stale.
    pub(super) fn mark_all(&mut self) {
        for slot in 0..self.slots.len() {
            if self.slots[slot].member.is_some() {
                self.mark_slot(slot as u32);
            }
        }
    }

    fn allocate(&mut self) -> Result<u32> {
        if let Some(slot) = self.free_slots.pop() {
            return Ok(slot);
        }
        let (slot, limit) = (self.slots.len() as u32, PrimitiveRange::MAX_FIRST);
        require_within(Resource::Instances, u64::from(slot) + 1, limit.into())?;
        self.slots.push(InstanceSlot::default());
        Ok(slot)
    }

    fn occupy(&mut self, slot: u32, member: Member, users: &mut Users) {
        users.add(slot, member.geometry, member.material);
        self.slot_of_entry[member.entry as usize] = slot;
        self.slots[slot as usize].member = Some(member);
        self.mark_slot(slot);
    }

    fn remove_from_users(&mut self, slot: u32, users: &mut Users) {
        if let Some(member) = self.slots[slot as usize].member {
            users.remove(slot, member.geometry, member.material);
        }
    }

    fn free(&mut self, slot: u32, users: &mut Users) {
        self.remove_from_users(slot, users);
        if let Some(member) = self.slots[slot as usize].member.take()
            && let Some(at) = self.slot_of_entry.get_mut(member.entry as usize).filter(|at| **at == slot)
        {
            *at = NONE;
        }
        self.vacated_slots.push(slot);
        self.free_slots.push(slot);
    }
}

/// Writing records.
impl InstanceTable {
    /// Clears the records of vacated slots and writes the stale ones, as `compile` computes them from a member. Returns
    /// how many members were written.
    pub(super) fn write_stale_records(
        &mut self,
        compile: impl Fn(&Member) -> CompiledInstance + Sync,
        records: &mut DeviceBuffer<InstanceRecord>,
        bounds: &mut InstanceBounds,
    ) -> usize {
        // 1. Clear vacated slots first: some are in use again, and are then written below.
        let mut vacated = std::mem::take(&mut self.vacated_slots);
        vacated.drain(..).for_each(|slot| self.write_slot(slot, &CompiledInstance::unhittable(0), records, bounds));
        self.vacated_slots = vacated;
        // 2. Compile the members of stale slots in parallel, and write them in order. In chunks that fit a cache.
        let mut stale = std::mem::take(&mut self.stale_slots);
        let (mut compiled, mut written) = (Vec::new(), 0);
        for chunk in stale.chunks(1 << 12) {
            let members = chunk.par_iter().with_min_len(256).map(|&slot| self.slots[slot as usize].member);
            members.map(|member| member.as_ref().map(&compile)).collect_into_vec(&mut compiled);
            for (&slot, instance) in chunk.iter().zip(compiled.drain(..)) {
                self.slots[slot as usize].is_stale = false;
                if let Some(instance) = instance {
                    self.write_slot(slot, &instance, records, bounds);
                    written += 1;
                }
            }
        }
        stale.clear();
        self.stale_slots = stale;
        written
    }

    fn write_slot(
        &mut self,
        slot: u32,
        instance: &CompiledInstance,
        records: &mut DeviceBuffer<InstanceRecord>,
        bounds: &mut InstanceBounds,
    ) {
        let record_changed = records.get(slot as usize) != Some(&instance.record);
        records.write(slot as usize, &[instance.record]);
        bounds.set(slot, instance.bounds, instance.placement_hash, record_changed);
        let state = &mut self.slots[slot as usize];
        self.totals.remove(state);
        (state.is_hittable, state.triangle_count) = (!instance.bounds.is_empty(), instance.triangle_count);
        state.displacement = instance.displacement;
        self.totals.add(state);
    }

    /// Whether there is no member.
    pub(super) fn is_empty(&self) -> bool {
        self.free_slots.len() == self.slots.len()
    }

    /// Releases the slots of a table without members.
    pub(super) fn clear_slots(&mut self) {
        let slot_of_entry = std::mem::take(&mut self.slot_of_entry);
        *self = Self { slot_of_entry, ..Self::default() };
    }

    /// Counts over all members.
    pub(super) fn totals(&self) -> InstanceTotals {
        self.totals
    }

    /// How far f32 displaces an instance at most, relative to its coordinates; 0 if that is not worth a report. O(1),
    /// O(slots) if there are such instances.
    pub(super) fn greatest_displacement(&self) -> f64 {
        if self.totals.displaced_instances == 0 {
            return 0.0;
        }
        self.slots.iter().filter(|slot| slot.is_hittable).map(|slot| slot.displacement).fold(0.0, f64::max)
    }

    /// The member of a slot; `None` for an unused one.
    pub(super) fn member(&self, slot: u32) -> Option<&Member> {
        self.slots.get(slot as usize)?.member.as_ref()
    }
}

impl InstanceTotals {
    fn add(&mut self, slot: &InstanceSlot) {
        if slot.is_hittable {
            self.instances += 1;
            self.displaced_instances += usize::from(slot.displacement > MAX_DISPLACEMENT);
            self.triangles += slot.triangle_count;
        } else if slot.triangle_count > 0 {
            self.unhittable_instances += 1;
        }
    }

    fn remove(&mut self, slot: &InstanceSlot) {
        if slot.is_hittable {
            self.instances -= 1;
            self.displaced_instances -= usize::from(slot.displacement > MAX_DISPLACEMENT);
            self.triangles -= slot.triangle_count;
        } else if slot.triangle_count > 0 {
            self.unhittable_instances -= 1;
        }
    }
}
