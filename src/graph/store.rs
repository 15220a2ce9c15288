//! Slot map with generation-checked keys that can restore a removed object under its old key (undo, deltas).

use std::ops::{Index, IndexMut};

use slotmap::{Key, KeyData};

use super::ObjectKey;
use super::key_map::{KeyMap, generation, slot};
use crate::{Error, Result};

/// As [`slotmap::SlotMap`], with [`insert_at`](Self::insert_at). No key is ever issued twice.
#[derive(Debug)]
pub(super) struct Store<K, V> {
    values: KeyMap<K, V>,
    /// By slot: the highest generation of any key that had it, 0 for none. Slot 0 is never used.
    generations: Vec<u32>,
    /// Free list. May contain slots that were filled by [`insert_at`](Self::insert_at) meanwhile; they are skipped when
    /// popped.
    free: Vec<u32>,
    /// By slot: whether `free` contains it.
    is_in_free_list: Vec<bool>,
}

/// Generations are odd. A slot whose generation reached the maximum is retired.
const LAST_GENERATION: u32 = u32::MAX;

impl<K: Key, V> Store<K, V> {
    pub(super) fn new() -> Self {
        Self { values: KeyMap::new(), generations: vec![0], free: Vec::new(), is_in_free_list: vec![false] }
    }

    /// Stores a new object. O(1) amortised.
    pub(super) fn insert(&mut self, value: V) -> K {
        let slot = self.take_free_slot();
        // Odd generations only, each higher than any before: no key is issued twice.
        let generation = match self.generations[slot] {
            0 => 1,
            highest => highest + 2,
        };
        let key = KeyData::from_ffi(u64::from(generation) << 32 | slot as u64).into();
        self.insert_at(key, value);
        key
    }

    /// Stores an object under a key whose slot is vacant. O(1), or O(slots added).
    pub(super) fn insert_at(&mut self, key: K, value: V) {
        let slot = slot(key);
        debug_assert!(self.values.key_at(slot).is_none(), "slot {slot} is in use");
        self.add_slots(slot + 1);
        self.generations[slot] = self.generations[slot].max(generation(key));
        self.values.insert(key, value);
    }

    pub(super) fn remove(&mut self, key: K) -> Option<V> {
        let value = self.values.remove(key)?;
        self.push_free_slot(slot(key));
        Some(value)
    }

    pub(super) fn get(&self, key: K) -> Option<&V> {
        self.values.get(key)
    }

    /// As [`get`](Self::get), with [`Error::StaleKey`] where the key is stale.
    pub(super) fn require(&self, key: K) -> Result<&V>
    where
        K: Into<ObjectKey>,
    {
        self.get(key).ok_or_else(|| Error::StaleKey { object: key.into() })
    }

    pub(super) fn contains_key(&self, key: K) -> bool {
        self.values.contains_key(key)
    }

    /// The key of the object in this slot.
    pub(super) fn key_at(&self, slot: usize) -> Option<K> {
        self.values.key_at(slot)
    }

    pub(super) fn len(&self) -> usize {
        self.values.len()
    }

    /// All objects, by rising slot. O(slots).
    pub(super) fn iter(&self) -> impl DoubleEndedIterator<Item = (K, &V)> + Clone {
        self.values.iter()
    }

    pub(super) fn keys(&self) -> impl DoubleEndedIterator<Item = K> {
        self.iter().map(|(key, _)| key)
    }

    pub(super) fn values(&self) -> impl Iterator<Item = &V> + Clone {
        self.iter().map(|(_, value)| value)
    }

    /// By slot: the highest generation of any key that had it, 0 for none.
    pub(super) fn generations(&self) -> &[u32] {
        &self.generations
    }

    /// Raises the generations to at least those of another store, so that its keys are never issued here. O(slots).
    pub(super) fn raise_generations(&mut self, generations: &[u32]) {
        self.add_slots(generations.len());
        for (own, &other) in self.generations.iter_mut().zip(generations) {
            // 0, or odd as all are.
            *own = (*own).max(if other == 0 { 0 } else { other | 1 });
        }
    }

    /// A slot that is vacant and not retired: one of the free list, else a new one.
    fn take_free_slot(&mut self) -> usize {
        // Pop free slots, skipping those that were filled meanwhile and those whose generations are used up.
        while let Some(slot) = self.free.pop() {
            let slot = slot as usize;
            self.is_in_free_list[slot] = false;
            if self.values.key_at(slot).is_none() && self.generations[slot] != LAST_GENERATION {
                return slot;
            }
        }
        self.generations.push(0);
        self.is_in_free_list.push(false);
        self.generations.len() - 1
    }

    /// Extends the slots to `count`. The new ones are free; the lowest is used first.
    fn add_slots(&mut self, count: usize) {
        let old_count = self.generations.len();
        if count > old_count {
            self.generations.resize(count, 0);
            self.is_in_free_list.resize(count, false);
            // Pushed in descending order, since the free list pops from its end.
            (old_count..count).rev().for_each(|slot| self.push_free_slot(slot));
        }
    }

    fn push_free_slot(&mut self, slot: usize) {
        if !std::mem::replace(&mut self.is_in_free_list[slot], true) {
            self.free.push(slot as u32);
        }
    }
}

impl<K: Key, V> Index<K> for Store<K, V> {
    type Output = V;

    fn index(&self, key: K) -> &V {
        &self.values[key]
    }
}

impl<K: Key, V> IndexMut<K> for Store<K, V> {
    fn index_mut(&mut self, key: K) -> &mut V {
        &mut self.values[key]
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{HashMap, HashSet};

    use proptest::prelude::*;

    use super::*;
    use crate::graph::NodeKey;

    proptest! {
        /// Compared with a map; no key is issued twice, those of removed objects included.
        #[test]
        fn keys_are_issued_once(steps in prop::collection::vec((0_u8..4, any::<u16>()), 1..300)) {
            let mut store: Store<NodeKey, usize> = Store::new();
            let (mut model, mut issued) = (HashMap::new(), Vec::new());
            for (value, (kind, number)) in steps.into_iter().enumerate() {
                let key: Option<NodeKey> = issued.get(usize::from(number) % issued.len().max(1)).copied();
                match (kind, key) {
                    (0 | 1, _) => {
                        let key = store.insert(value);
                        prop_assert!(!issued.contains(&key));
                        issued.push(key);
                        model.insert(key, value);
                    }
                    (2, Some(key)) => prop_assert_eq!(store.remove(key), model.remove(&key)),
                    (_, Some(key)) if store.key_at(slot(key)).is_none() => {
                        store.insert_at(key, value);
                        model.insert(key, value);
                    }
                    _ => {}
                }
                prop_assert!(issued.iter().all(|&key| store.get(key) == model.get(&key)));
                let stored: HashMap<_, _> = store.iter().map(|(key, &value)| (key, value)).collect();
                prop_assert_eq!(stored, model.clone());
                prop_assert_eq!(store.len(), model.len());
                prop_assert!(store.free.len() < store.generations.len(), "a slot is listed once");
            }
        }
    }

    #[test]
    fn a_slot_is_retired_after_its_last_generation_and_gaps_are_filled() {
        let mut store: Store<NodeKey, ()> = Store::new();
        let last: NodeKey = KeyData::from_ffi(u64::from(LAST_GENERATION) << 32 | 3).into();
        store.insert_at(last, ());
        assert_eq!(store.remove(last), Some(()));
        let slots: HashSet<usize> = (0..3).map(|_| slot(store.insert(()))).collect();
        assert_eq!(slots, HashSet::from([1, 2, 4]));
    }
}
