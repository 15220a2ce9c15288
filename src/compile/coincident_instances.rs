//! Instances that coincide: of each group one has a leaf of the TLAS and stands for all (decision record 0016).

use std::collections::{BTreeSet, HashMap};
use std::hash::{BuildHasher, Hasher, RandomState};

use slotmap::{DefaultKey, SlotMap};

use crate::device::layout::InstanceRecord;
use crate::math::Aabb;

/// The groups of instances that coincide: they show the same geometry with the same matrix, material, mask and flags,
/// and so have one box. The instance in the lowest slot stands for its group, since at equal distance it is the one
/// that is hit.
#[derive(Debug, Default)]
pub(super) struct CoincidentInstances {
    groups: SlotMap<DefaultKey, Group>,
    /// The group of each slot that is in one.
    group_of_slot: HashMap<u32, DefaultKey>,
}

#[derive(Debug)]
struct Group {
    /// Two or more.
    slots: BTreeSet<u32>,
    bounds: Aabb,
}

/// A slot that has the box of its group from now on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Promoted {
    pub(super) slot: u32,
    pub(super) bounds: Aabb,
}

impl CoincidentInstances {
    /// The box of the group that an instance is in, if it is in one.
    pub(super) fn group_bounds(&self, slot: u32) -> Option<Aabb> {
        self.group_of_slot.get(&slot).map(|&group| self.groups[group].bounds)
    }

    /// The instances of a slot's group; only the slot itself if it is in none. Ascending.
    pub(super) fn group(&self, slot: u32) -> impl Iterator<Item = u32> {
        let group = self.group_of_slot.get(&slot).map(|&group| &self.groups[group]);
        group.into_iter().flat_map(|group| group.slots.iter().copied()).chain(group.is_none().then_some(slot))
    }

    /// How many instances others stand for.
    pub(super) fn left_out_count(&self) -> usize {
        self.group_of_slot.len() - self.groups.len()
    }

    /// Removes an instance from its group, if it is in one. Returns the instance that stands for the group from now on,
    /// if that has changed. O(log n).
    pub(super) fn remove(&mut self, slot: u32) -> Option<Promoted> {
        let key = self.group_of_slot.remove(&slot)?;
        let group = &mut self.groups[key];
        let stood_for_all = group.slots.first() == Some(&slot);
        group.slots.remove(&slot);
        let first = *group.slots.first()?;
        let promoted = stood_for_all.then_some(Promoted { slot: first, bounds: group.bounds });
        // The last one is no group.
        if group.slots.len() == 1 {
            self.group_of_slot.remove(&first);
            self.groups.remove(key);
        }
        promoted
    }

    /// Finds the instances that coincide, among those with a box, and empties the boxes of those that others stand for.
    /// Returns how many these are. O(n): every box is read twice, in order, and for few more than those that coincide a
    /// record is read and hashed. `placement_hashes` are of the matrices in f64.
    pub(super) fn find(&mut self, boxes: &mut [Aabb], records: &[InstanceRecord], placement_hashes: &[u64]) -> usize {
        let mut first_of_content: HashMap<InstanceContent, u32> = HashMap::new();
        let mut left_out = 0;
        for slot in slots_with_equal_boxes(boxes) {
            let content = InstanceContent::of(&records[slot as usize], placement_hashes[slot as usize]);
            let first = *first_of_content.entry(content).or_insert(slot);
            if first != slot {
                self.join(first, slot, boxes[slot as usize]);
                boxes[slot as usize] = Aabb::EMPTY;
                left_out += 1;
            }
        }
        left_out
    }

    /// Adds to the group of `first` another slot, with all of its group if it stands for one.
    fn join(&mut self, first: u32, slot: u32, bounds: Aabb) {
        let key = *self.group_of_slot.entry(first).or_insert_with(|| {
            let slots = BTreeSet::from([first]);
            self.groups.insert(Group { slots, bounds })
        });
        let joined = self.group_of_slot.get(&slot).and_then(|&other| self.groups.remove(other));
        for slot in joined.map_or_else(|| BTreeSet::from([slot]), |group| group.slots) {
            self.group_of_slot.insert(slot, key);
            self.groups[key].slots.insert(slot);
        }
    }
}

/// What instances that coincide have in common: the record, and in place of the node the hash of the matrix in f64.
/// Compared bit by bit.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct InstanceContent([u64; size_of::<InstanceRecord>() / 8]);

impl InstanceContent {
    fn of(record: &InstanceRecord, placement_hash: u64) -> Self {
        Self(bytemuck::cast(InstanceRecord { node_key: bytemuck::cast(placement_hash), ..*record }))
    }
}

/// The slots, ascending, of boxes of which there are several, and of a few that are alone: a bit for each of 16 times
/// as many hashes says which boxes there are, so that the others, nearly all in most scenes, cost one bit each.
fn slots_with_equal_boxes(boxes: &[Aabb]) -> Vec<u32> {
    let mask = (boxes.len() * 16).next_power_of_two() as u64 - 1;
    let hashes = RandomState::new();
    let place = |bounds: &Aabb| {
        let mut hasher = hashes.build_hasher();
        hasher.write(bytemuck::bytes_of(&[bounds.min, bounds.max]));
        let bit = hasher.finish() & mask;
        ((bit / 64) as usize, 1 << (bit % 64))
    };
    let mut words = [(); 2].map(|()| vec![0_u64; mask as usize / 64 + 1]);
    for bounds in boxes.iter().filter(|bounds| !bounds.is_empty()) {
        let (word, bit) = place(bounds);
        words[1][word] |= words[0][word] & bit;
        words[0][word] |= bit;
    }
    let is_there_again = |bounds: &Aabb| {
        let (word, bit) = place(bounds);
        words[1][word] & bit != 0
    };
    let slots = (0..).zip(boxes).filter(|(_, bounds)| !bounds.is_empty() && is_there_again(bounds));
    slots.map(|(slot, _)| slot).collect()
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;
    use glam::Vec3;

    use super::*;

    /// Boxes of places on a line, and records of these places.
    fn line(places: &[u32]) -> (Vec<Aabb>, Vec<InstanceRecord>) {
        let bounds = |&place: &u32| Aabb { min: Vec3::splat(place as f32), max: Vec3::splat(place as f32 + 0.5) };
        let record = |(slot, &place): (usize, &u32)| InstanceRecord {
            local_from_world: [[1.0, 0.0, 0.0, -(place as f32)]; 3],
            node_key: [slot as u32, 1],
            ..InstanceRecord::zeroed()
        };
        (places.iter().map(bounds).collect(), places.iter().enumerate().map(record).collect())
    }

    #[test]
    fn the_lowest_slot_stands_for_its_group_until_it_leaves() {
        let (mut boxes, records) = line(&[3, 1, 2, 1, 3, 1]);
        let all = boxes.clone();
        let mut coincident = CoincidentInstances::default();
        assert_eq!(coincident.find(&mut boxes, &records, &[0; 6]), 3);
        let kept: Vec<usize> = (0..6).filter(|&slot| !boxes[slot].is_empty()).collect();
        assert_eq!((kept, coincident.left_out_count()), (vec![0, 1, 2], 3));
        let groups = [5, 0, 2].map(|slot| coincident.group(slot).collect::<Vec<u32>>());
        assert_eq!(groups, [vec![1, 3, 5], vec![0, 4], vec![2]]);
        // One that is left out leaves; then the one that stands for all; then one of the last two.
        assert_eq!(coincident.remove(3), None);
        assert_eq!(coincident.remove(1), Some(Promoted { slot: 5, bounds: all[1] }));
        assert_eq!((coincident.group_bounds(5), coincident.group_bounds(4)), (None, Some(all[0])));
        assert_eq!(coincident.remove(4), None);
        assert_eq!(coincident.left_out_count(), 0);
    }

    #[test]
    fn a_later_search_joins_groups() {
        let (mut boxes, records) = line(&[7, 7, 7, 7]);
        let all = boxes.clone();
        boxes[..2].fill(Aabb::EMPTY);
        let mut coincident = CoincidentInstances::default();
        assert_eq!(coincident.find(&mut boxes, &records, &[0; 4]), 1);
        boxes[..2].copy_from_slice(&all[..2]);
        assert_eq!(coincident.find(&mut boxes, &records, &[0; 4]), 2);
        assert!(coincident.group(3).eq(0..4) && coincident.left_out_count() == 3);
        assert!(boxes[1..].iter().all(Aabb::is_empty) && !boxes[0].is_empty());
    }

    #[test]
    fn everything_but_the_node_must_be_equal() {
        let (boxes, records) = line(&[5; 2]);
        let differing: [fn(&mut InstanceRecord); 5] = [
            |record| record.material = 1,
            |record| record.mask = 1,
            |record| record.flags = 1,
            |record| record.geometry = 1,
            |record| record.world_from_local[2][1] = -0.0,
        ];
        for change in differing {
            let mut records = records.clone();
            change(&mut records[1]);
            assert_eq!(CoincidentInstances::default().find(&mut boxes.clone(), &records, &[0; 2]), 0);
        }
        assert_eq!(CoincidentInstances::default().find(&mut boxes.clone(), &records, &[0, 1]), 0);
    }

    #[test]
    fn few_records_are_read_where_no_boxes_are_equal() {
        let (boxes, _) = line(&(0..10_000).collect::<Vec<u32>>());
        let alone = slots_with_equal_boxes(&boxes).len();
        assert!(alone < 1500, "{alone}");
    }
}
