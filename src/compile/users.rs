//! Which instances use each geometry, and each material.

use slotmap::Key;

use crate::graph::{GeometryKey, KeyMap, MaterialKey};

/// The instances that use each geometry and each material. An instance is named by its slot, its index in the
/// `instances` array.
#[derive(Debug, Default)]
pub(super) struct Users {
    pub(super) geometries: SlotsByKey<GeometryKey>,
    pub(super) materials: SlotsByKey<MaterialKey>,
}

impl Users {
    /// Adds an instance. O(1).
    pub(super) fn add(&mut self, slot: u32, geometry: GeometryKey, material: MaterialKey) {
        self.geometries.add(slot, geometry);
        self.materials.add(slot, material);
    }

    /// Removes an instance that was added with these keys. O(1).
    pub(super) fn remove(&mut self, slot: u32, geometry: GeometryKey, material: MaterialKey) {
        self.geometries.remove(slot, geometry);
        self.materials.remove(slot, material);
    }
}

/// For each key in use, the slots of the instances that use it.
#[derive(Debug)]
pub(super) struct SlotsByKey<K: Key> {
    /// A [`KeyMap`] holds one generation per slotmap index. If an old and a new key of one index are both in use while
    /// instances are exchanged, the list of the key that was inserted last is kept, and removing the other one's
    /// users does nothing.
    slots: KeyMap<K, Vec<u32>>,
    /// The position of each slot in the list of its key.
    positions_in_list: Vec<u32>,
    /// Whether the set of keys has changed since [`take_keys_changed`](Self::take_keys_changed).
    keys_changed: bool,
}

impl<K: Key> Default for SlotsByKey<K> {
    fn default() -> Self {
        Self { slots: KeyMap::new(), positions_in_list: Vec::new(), keys_changed: false }
    }
}

impl<K: Key> SlotsByKey<K> {
    /// The keys that are in use.
    pub(super) fn keys(&self) -> impl Iterator<Item = K> + '_ {
        self.slots.iter().map(|(key, _)| key)
    }

    /// Whether some instance uses the key.
    pub(super) fn has(&self, key: K) -> bool {
        self.slots.contains_key(key)
    }

    /// The slots of the instances that use the key, in no particular order.
    pub(super) fn slots(&self, key: K) -> &[u32] {
        self.slots.get(key).map_or(&[], Vec::as_slice)
    }

    /// Whether some key has gained its first user or lost its last one since the last call.
    pub(super) fn take_keys_changed(&mut self) -> bool {
        std::mem::take(&mut self.keys_changed)
    }

    fn add(&mut self, slot: u32, key: K) {
        if !self.slots.contains_key(key) {
            self.slots.insert(key, Vec::new());
            self.keys_changed = true;
        }
        if self.positions_in_list.len() <= slot as usize {
            self.positions_in_list.resize(slot as usize + 1, 0);
        }
        let slots = &mut self.slots[key];
        self.positions_in_list[slot as usize] = slots.len() as u32;
        slots.push(slot);
    }

    fn remove(&mut self, slot: u32, key: K) {
        let Some(slots) = self.slots.get_mut(key) else { return };
        // The last slot of the list takes the position of the removed one.
        let position = self.positions_in_list[slot as usize];
        slots.swap_remove(position as usize);
        if let Some(&moved) = slots.get(position as usize) {
            self.positions_in_list[moved as usize] = position;
        }
        if slots.is_empty() {
            self.slots.remove(key);
            self.keys_changed = true;
        }
    }
}
