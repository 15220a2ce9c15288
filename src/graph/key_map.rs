//! A map indexed by key slot, as fast as an array, with one value per slot for whichever generation was inserted last.

use std::num::NonZeroU32;
use std::ops::{Index, IndexMut};

use slotmap::{Key, KeyData};

/// Values by key, at most one for all generations of a slot: that of the generation inserted last.
///
/// [`slotmap::SecondaryMap`] keeps the newest generation instead. That is wrong where undo brings an object back under
/// its old key.
#[derive(Clone, Debug)]
pub(crate) struct KeyMap<K, V> {
    /// By slot: the generation of its key, and its value.
    slots: Vec<Option<(NonZeroU32, V)>>,
    len: usize,
    keys: std::marker::PhantomData<fn(K) -> K>,
}

impl<K: Key, V> KeyMap<K, V> {
    pub(crate) fn new() -> Self {
        Self { slots: Vec::new(), len: 0, keys: std::marker::PhantomData }
    }

    /// Number of values.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    pub(crate) fn contains_key(&self, key: K) -> bool {
        self.get(key).is_some()
    }

    pub(crate) fn get(&self, key: K) -> Option<&V> {
        match self.slots.get(slot(key)) {
            Some(Some((generation, value))) if generation.get() == self::generation(key) => Some(value),
            _ => None,
        }
    }

    pub(crate) fn get_mut(&mut self, key: K) -> Option<&mut V> {
        match self.slots.get_mut(slot(key)) {
            Some(Some((generation, value))) if generation.get() == self::generation(key) => Some(value),
            _ => None,
        }
    }

    /// The key whose value is in this slot.
    pub(crate) fn key_at(&self, slot: usize) -> Option<K> {
        self.slots.get(slot)?.as_ref().map(|(generation, _)| key_of(slot, *generation))
    }

    /// Stores a value in the key's slot. Returns the key and value that were there, of whatever generation. Does
    /// nothing for the null key. O(1), or O(slot) for a slot beyond the last one.
    pub(crate) fn insert(&mut self, key: K, value: V) -> Option<(K, V)> {
        if key.is_null() {
            return None;
        }
        let (slot, generation) = (slot(key), NonZeroU32::new(generation(key)));
        if slot >= self.slots.len() {
            self.slots.resize_with(slot + 1, || None);
        }
        let old = std::mem::replace(&mut self.slots[slot], generation.map(|generation| (generation, value)));
        self.len += usize::from(old.is_none());
        old.map(|(generation, value)| (key_of(slot, generation), value))
    }

    pub(crate) fn remove(&mut self, key: K) -> Option<V> {
        self.get(key)?;
        self.len -= 1;
        self.slots[slot(key)].take().map(|(_, value)| value)
    }

    /// All keys with their values, in ascending order of slots. O(slots).
    pub(crate) fn iter(&self) -> impl DoubleEndedIterator<Item = (K, &V)> + Clone {
        self.slots.iter().enumerate().filter_map(|(slot, occupant)| {
            let (generation, value) = occupant.as_ref()?;
            Some((key_of(slot, *generation), value))
        })
    }
}

impl<K: Key, V> Default for KeyMap<K, V> {
    fn default() -> Self {
        Self::new()
    }
}

impl<K: Key, V> Index<K> for KeyMap<K, V> {
    type Output = V;

    #[expect(clippy::expect_used, reason = "an index that is not there is a defect, as in std's maps")]
    fn index(&self, key: K) -> &V {
        self.get(key).expect("the key is in the map")
    }
}

impl<K: Key, V> IndexMut<K> for KeyMap<K, V> {
    #[expect(clippy::expect_used, reason = "an index that is not there is a defect, as in std's maps")]
    fn index_mut(&mut self, key: K) -> &mut V {
        self.get_mut(key).expect("the key is in the map")
    }
}

/// The index of a key's value in arrays with one element per slot.
pub(crate) fn slot<K: Key>(key: K) -> usize {
    key.data().as_ffi() as u32 as usize
}

/// The generation of a key: odd, and higher for each new key of its slot.
pub(crate) fn generation<K: Key>(key: K) -> u32 {
    (key.data().as_ffi() >> 32) as u32
}

fn key_of<K: Key>(slot: usize, generation: NonZeroU32) -> K {
    KeyData::from_ffi(u64::from(generation.get()) << 32 | slot as u64).into()
}
