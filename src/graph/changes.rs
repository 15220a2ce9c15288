//! The change log: per-object change flags since each cursor's last read.
//!
//! The log is a queue of segments, each with one entry per object. A new segment starts at every cursor position;
//! segments without a cursor at their start are merged into the one before. So there are at most as many segments as
//! cursors, and the log's size is bounded by the number of objects, however often they change and however far a
//! consumer lags. Merging costs no more than the read that allowed it.

use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};

use super::key_map::KeyMap;
use super::{CoreKey, GeometryKey, MaterialKey, NodeKey, ObjectKey, SceneId, TextureKey};
use crate::Result;
use crate::error::require_invariant;

bitflags::bitflags! {
    /// What changed in an object. [`ADDED`](Self::ADDED) and [`REMOVED`](Self::REMOVED) are never combined with other
    /// flags. An object that was removed and restored under the same key (undo) has all flags except these two.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Change: u16 {
        /// The object was added.
        const ADDED = 1;
        /// The object was removed. Nodes below a removed node have entries of their own.
        const REMOVED = 2;
        /// A node's parent or its position among its siblings.
        const PARENT = 4;
        /// The key of the core that a node has.
        const CORE = 8;
        /// A node's own mask.
        const MASK = 16;
        /// A node's own visibility.
        const VISIBILITY = 32;
        /// A node's name.
        const NAME = 64;
        /// A core's transform, or whether the core is a transform: the world transforms of all its users changed.
        const TRANSFORM = 128;
        /// Any other content of a core; the content of a geometry, material or texture.
        const DATA = 256;
        /// A core's kind, for example from geometry to light. `DATA` is set with it.
        const KIND = 512;
        /// A node's list of children: one was added, removed or moved.
        const CHILDREN = 1024;
    }
}

impl Change {
    /// The combined change of two successive ones; empty if the object was added and removed.
    fn followed_by(self, later: Self) -> Self {
        match (self.contains(Self::ADDED), later.contains(Self::REMOVED)) {
            (true, true) => Self::empty(),
            (true, false) => Self::ADDED,
            (false, true) => Self::REMOVED,
            // Removed and restored: any part of it may differ.
            (false, false) if self.contains(Self::REMOVED) => Self::all().difference(Self::ADDED | Self::REMOVED),
            (false, false) => self | later,
        }
    }
}

/// The changes that one cursor has not read.
#[derive(Clone, Debug, PartialEq, Eq)]
#[must_use = "the cursor has moved past these changes"]
pub enum Changes {
    /// The cursor's first read of this scene: the consumer reads the whole scene.
    Everything,
    /// The objects changed since the last read, each once, ordered by first change. Objects added and removed in
    /// between are omitted.
    Since(Vec<(ObjectKey, Change)>),
}

/// A read position in a scene's change log. Dropping it ends the subscription and frees log entries kept only for it.
///
/// A default cursor has read nothing; see [`Scene::changes_since`](super::Scene::changes_since).
#[derive(Debug, Default)]
pub struct ChangeCursor {
    subscription: Option<(SceneId, Position)>,
}

/// The start number of the first segment that a cursor has not read. Only the scene's log reads or writes it.
type Position = Arc<AtomicU64>;

/// The log of one scene. Without cursors it stores nothing.
#[derive(Debug, Default)]
pub(super) struct ChangeLog {
    cursors: Vec<Weak<AtomicU64>>,
    /// Oldest first. New changes are recorded in the last one, the open segment. Empty without cursors.
    segments: VecDeque<Segment>,
    /// Where the open segment has an object's entry.
    entry_indices: EntryIndices,
    /// Entry indices of removed objects whose slot was reused since; undo may restore them.
    reused_slot_entries: HashMap<ObjectKey, usize>,
}

impl ChangeLog {
    /// Adds one change to the open segment. O(1) amortised.
    pub(super) fn record(&mut self, object: ObjectKey, change: Change) {
        let Some(open) = self.segments.back_mut() else { return };
        // 1. Find the object's entry: by the hint for its slot, else among those whose slot was reused.
        let hint = self.entry_indices.get(object).filter(|&index| open.has_entry_at(object, index));
        if let Some(index) = hint.or_else(|| self.reused_slot_entries.get(&object).copied()) {
            // 2. Merge into it. Where that left too many cancelled entries, entries move and all hints are set again.
            open.merge_at(index, change);
            if open.compact() {
                self.reused_slot_entries.clear();
                for (index, &(object, _)) in open.entries.iter().enumerate() {
                    let (hints, reused) = (&mut self.entry_indices, &mut self.reused_slot_entries);
                    set_entry_index(object, index, &open.entries, hints, reused);
                }
            }
            return;
        }
        // 3. Else append an entry.
        let (hints, reused) = (&mut self.entry_indices, &mut self.reused_slot_entries);
        set_entry_index(object, open.entries.len(), &open.entries, hints, reused);
        open.entries.push((object, change));
        if self.cursors.iter().any(|cursor| cursor.strong_count() == 0) {
            self.forget_dropped_cursors();
        }
    }

    /// The changes since the cursor's last read of this scene. Advances the cursor.
    pub(super) fn read(&mut self, scene: SceneId, cursor: &mut ChangeCursor) -> Changes {
        // 1. Nothing was recorded since.
        if self.is_caught_up(scene, cursor) {
            return Changes::Since(Vec::new());
        }
        // 2. Open a new segment: later changes are new to this cursor.
        self.forget_dropped_cursors();
        let now = self.begin_segment();
        // 3. Advance the cursor, and merge the segments since its last read, or subscribe it.
        let changes = match &cursor.subscription {
            Some((subscribed, position)) if *subscribed == scene => {
                let since = position.swap(now, Ordering::Relaxed);
                Changes::Since(self.merged_since(since))
            }
            _ => {
                let position = Arc::new(AtomicU64::new(now));
                self.cursors.push(Arc::downgrade(&position));
                cursor.subscription = Some((scene, position));
                Changes::Everything
            }
        };
        // 4. Merge segments that no longer have a cursor at their start.
        self.merge_between_cursors();
        changes
    }

    fn is_caught_up(&self, scene: SceneId, cursor: &ChangeCursor) -> bool {
        let (Some(open), Some((subscribed, position))) = (self.segments.back(), &cursor.subscription) else {
            return false;
        };
        *subscribed == scene && open.start == position.load(Ordering::Relaxed) && open.entries.is_empty()
    }

    /// Allocates the hints for objects up to these keys.
    pub(super) fn reserve(&mut self, last_node: Option<NodeKey>, last_core: Option<CoreKey>) {
        let last = [last_node.map(ObjectKey::from), last_core.map(ObjectKey::from)];
        last.into_iter().flatten().for_each(|object| {
            self.entry_indices.set(object, 0);
        });
    }

    /// Opens a segment without entries, if the open one has some. Returns its start number.
    fn begin_segment(&mut self) -> u64 {
        let start = match self.segments.back() {
            Some(open) if open.entries.is_empty() => return open.start,
            Some(open) => open.start + 1,
            None => 0,
        };
        self.reused_slot_entries.clear();
        self.segments.push_back(Segment::new(start));
        start
    }

    /// All entries from the segment that starts at `since` on, merged by object. The reading cursor was advanced
    /// before.
    fn merged_since(&mut self, since: u64) -> Vec<(ObjectKey, Change)> {
        // Copy or take the first unread segment, and append all later ones to it.
        let first = self.segments.partition_point(|segment| segment.start < since);
        let mut merged = if self.lowest_cursor() > since {
            // No other cursor reads this segment: take it.
            std::mem::replace(&mut self.segments[first], Segment::new(since))
        } else {
            self.segments[first].copy()
        };
        for segment in self.segments.range(first + 1..) {
            merged.append(segment);
        }
        // Objects added and removed in between are of no interest to the reader.
        merged.entries.retain(|(_, change)| !change.is_empty());
        merged.entries
    }

    /// Merges segments until each has a cursor at its start.
    fn merge_between_cursors(&mut self) {
        self.drop_read_segments();
        // Append each segment without a cursor at its start to the one before.
        let starts = self.positions();
        let mut kept: VecDeque<Segment> = VecDeque::with_capacity(starts.len());
        for segment in self.segments.drain(..) {
            match kept.back_mut() {
                Some(last) if !starts.contains(&segment.start) => last.append(&segment),
                _ => kept.push_back(segment),
            }
        }
        self.segments = kept;
    }

    fn forget_dropped_cursors(&mut self) {
        self.cursors.retain(|cursor| cursor.strong_count() > 0);
        // Without cursors nothing needs to be stored.
        if self.cursors.is_empty() {
            *self = Self::default();
        } else {
            self.drop_read_segments();
        }
    }

    fn drop_read_segments(&mut self) {
        // Every cursor is past these segments. The last one stays: it is open.
        let lowest = self.lowest_cursor();
        while self.segments.len() > 1 && self.segments.front().is_some_and(|oldest| oldest.start < lowest) {
            self.segments.pop_front();
        }
    }

    fn lowest_cursor(&self) -> u64 {
        self.positions().into_iter().min().unwrap_or(u64::MAX)
    }

    fn positions(&self) -> Vec<u64> {
        self.cursors.iter().filter_map(|cursor| Some(cursor.upgrade()?.load(Ordering::Relaxed))).collect()
    }

    /// Checks that each cursor is at the start of a segment, and that no segment has two entries for an object.
    pub(super) fn validate(&self, root: NodeKey) -> Result<()> {
        // Segments ascend, and each cursor is at the start of one.
        let rising = self.segments.iter().is_sorted_by(|a, b| a.start < b.start);
        require_invariant(rising, root, "the log is out of order")?;
        let at_segment = |position: &u64| self.segments.iter().any(|segment| segment.start == *position);
        require_invariant(self.positions().iter().all(at_segment), root, "a cursor is not at the start of a segment")?;
        // In each segment an object has one entry, which the index finds if there is one.
        for segment in &self.segments {
            let mut seen = HashSet::new();
            let entries = segment.entries.iter().enumerate().filter(|(_, (_, change))| !change.is_empty());
            for (index, &(object, _)) in entries {
                require_invariant(seen.insert(object), object, "it has two entries in one segment of the log")?;
                let found = segment.index.is_empty() || segment.index.get(&object) == Some(&index);
                require_invariant(found, object, "the log's index does not find it")?;
            }
            let cancelled = segment.entries.iter().filter(|(_, change)| change.is_empty()).count();
            require_invariant(cancelled == segment.cancelled, root, "the log miscounts its cancelled entries")?;
        }
        Ok(())
    }
}

/// Stores the index of the entry of `object`. If it displaces the index of an older generation of the slot, that one
/// moves to `reused`.
fn set_entry_index(
    object: ObjectKey,
    entry_index: usize,
    entries: &[(ObjectKey, Change)],
    hints: &mut EntryIndices,
    reused: &mut HashMap<ObjectKey, usize>,
) {
    // Hints may be outdated: keep the displaced one only if the other key's entry is really there.
    if let Some((other, other_index)) = hints.set(object, entry_index)
        && entries.get(other_index).is_some_and(|&(found, change)| found == other && !change.is_empty())
    {
        reused.insert(other, other_index);
    }
}

/// The changes between two cursor positions.
#[derive(Debug)]
struct Segment {
    /// Start number; ascending from segment to segment.
    start: u64,
    /// One entry per object, ordered by first change. A cancelled entry has no flags: the object was added and removed.
    entries: Vec<(ObjectKey, Change)>,
    /// Number of cancelled entries.
    cancelled: usize,
    /// Index of each object's entry; empty until another segment is merged into this one.
    index: HashMap<ObjectKey, usize>,
}

impl Segment {
    fn new(start: u64) -> Self {
        Self { start, entries: Vec::new(), cancelled: 0, index: HashMap::new() }
    }

    fn copy(&self) -> Self {
        Self { entries: self.entries.clone(), cancelled: self.cancelled, ..Self::new(self.start) }
    }

    fn has_entry_at(&self, object: ObjectKey, entry_index: usize) -> bool {
        self.entries.get(entry_index).is_some_and(|entry| entry.0 == object)
    }

    /// Combines the change of an entry with a later one.
    fn merge_at(&mut self, entry_index: usize, later: Change) {
        let change = &mut self.entries[entry_index].1;
        // An object whose entry was cancelled may be restored under its key.
        self.cancelled -= usize::from(change.is_empty());
        *change = change.followed_by(later);
        self.cancelled += usize::from(change.is_empty());
    }

    /// Adds the changes of the next segment to this one. O(entries of that one), once this one has an index.
    fn append(&mut self, later: &Self) {
        if later.entries.is_empty() {
            return;
        }
        // Build the index at the first merge.
        if self.index.is_empty() {
            self.index = self.entries.iter().enumerate().map(|(index, entry)| (entry.0, index)).collect();
        }
        // Merge each change into the object's entry, or add an entry.
        for &(object, change) in later.entries.iter().filter(|(_, change)| !change.is_empty()) {
            if let Some(&entry_index) = self.index.get(&object) {
                self.merge_at(entry_index, change);
            } else {
                self.index.insert(object, self.entries.len());
                self.entries.push((object, change));
            }
        }
        // Compaction moves entries: the index is rebuilt at the next merge.
        if self.compact() {
            self.index.clear();
        }
    }

    /// Removes cancelled entries if they are more than half. Returns whether it did.
    fn compact(&mut self) -> bool {
        let is_worthwhile = self.cancelled * 2 > self.entries.len();
        if is_worthwhile {
            self.entries.retain(|(_, change)| !change.is_empty());
            self.cancelled = 0;
        }
        is_worthwhile
    }
}

/// A hint per slot: the index of the entry of one of its keys. Hints may be outdated; callers check the entry found.
#[derive(Debug, Default)]
struct EntryIndices {
    nodes: KeyMap<NodeKey, u32>,
    cores: KeyMap<CoreKey, u32>,
    geometries: KeyMap<GeometryKey, u32>,
    materials: KeyMap<MaterialKey, u32>,
    textures: KeyMap<TextureKey, u32>,
}

impl EntryIndices {
    fn get(&self, object: ObjectKey) -> Option<usize> {
        let entry_index = match object {
            ObjectKey::Node(key) => self.nodes.get(key),
            ObjectKey::Core(key) => self.cores.get(key),
            ObjectKey::Geometry(key) => self.geometries.get(key),
            ObjectKey::Material(key) => self.materials.get(key),
            ObjectKey::Texture(key) => self.textures.get(key),
        };
        entry_index.map(|&index| index as usize)
    }

    /// Sets the hint of an object. Returns the hint of another generation of the slot, with its key, that this one
    /// displaces.
    fn set(&mut self, object: ObjectKey, entry_index: usize) -> Option<(ObjectKey, usize)> {
        fn insert<K: slotmap::Key + Into<ObjectKey>>(
            map: &mut KeyMap<K, u32>,
            key: K,
            entry_index: usize,
        ) -> Option<(ObjectKey, usize)> {
            let (other, index) = map.insert(key, entry_index as u32).filter(|&(other, _)| other != key)?;
            Some((other.into(), index as usize))
        }
        match object {
            ObjectKey::Node(key) => insert(&mut self.nodes, key, entry_index),
            ObjectKey::Core(key) => insert(&mut self.cores, key, entry_index),
            ObjectKey::Geometry(key) => insert(&mut self.geometries, key, entry_index),
            ObjectKey::Material(key) => insert(&mut self.materials, key, entry_index),
            ObjectKey::Texture(key) => insert(&mut self.textures, key, entry_index),
        }
    }
}

#[cfg(test)]
mod tests {
    use slotmap::SlotMap;

    use super::*;
    use crate::Scene;

    fn entry_count(log: &ChangeLog) -> usize {
        log.segments.iter().map(|segment| segment.entries.len()).sum()
    }

    #[test]
    fn without_cursors_nothing_is_stored() {
        let mut keys: SlotMap<NodeKey, ()> = SlotMap::with_key();
        let (mut log, scene) = (ChangeLog::default(), Scene::new().id());
        log.record(keys.insert(()).into(), Change::ADDED);
        assert_eq!(entry_count(&log), 0);

        let mut cursor = ChangeCursor::default();
        assert_eq!(log.read(scene, &mut cursor), Changes::Everything);
        log.record(keys.insert(()).into(), Change::ADDED);
        assert_eq!(entry_count(&log), 1);

        drop(cursor);
        log.record(keys.insert(()).into(), Change::ADDED);
        assert!(log.segments.is_empty());
    }

    /// One consumer never reads again, one reads after each edit, others read once and are dropped.
    #[test]
    fn a_lagging_consumer_costs_one_entry_an_object() {
        let mut keys: SlotMap<NodeKey, ()> = SlotMap::with_key();
        let objects: Vec<ObjectKey> = (0..10).map(|_| keys.insert(()).into()).collect();
        let (mut log, scene) = (ChangeLog::default(), Scene::new().id());
        let (mut lagging, mut eager) = (ChangeCursor::default(), ChangeCursor::default());
        assert_eq!(log.read(scene, &mut lagging), Changes::Everything);
        assert_eq!(log.read(scene, &mut eager), Changes::Everything);

        for round in 0..1000 {
            let object = objects[round * 7 % objects.len()];
            log.record(object, Change::MASK);
            let visitor: ObjectKey = keys.insert(()).into();
            log.record(visitor, Change::ADDED);
            let mut passing = ChangeCursor::default();
            assert_eq!(log.read(scene, &mut passing), Changes::Everything);
            log.record(visitor, Change::REMOVED);
            assert_eq!(log.read(scene, &mut eager), Changes::Since(vec![(object, Change::MASK)]));
            log.validate(NodeKey::default()).unwrap();
            assert!(log.segments.len() <= 4, "{} segments", log.segments.len());
            assert!(entry_count(&log) <= 2 * objects.len() + 4, "{} entries", entry_count(&log));
        }
        let Changes::Since(all) = log.read(scene, &mut lagging) else { panic!("it has read before") };
        assert_eq!(all.len(), objects.len());
    }

    #[test]
    fn a_cursor_follows_its_consumer_to_another_scene() {
        let (mut one, mut other) = (Scene::new(), Scene::new());
        let mut cursor = one.subscribe();
        assert_eq!(one.changes_since(&mut cursor), Changes::Everything);
        assert_eq!(other.changes_since(&mut cursor), Changes::Everything);
        assert_eq!(other.changes_since(&mut cursor), Changes::Since(vec![]));
        one.set_mask(one.root(), 1).unwrap();
        assert!(one.log.segments.is_empty(), "the cursor has left");
        assert_eq!(one.changes_since(&mut cursor), Changes::Everything);
    }
}
