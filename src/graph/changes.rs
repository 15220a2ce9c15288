//! The change log: what changed since each consumer last looked.
//!
//! The log is a queue of segments, each with one entry an object. A segment begins where some consumer's cursor
//! stands; where no cursor stands any more, neighbours are merged. So there are at most as many segments as cursors,
//! and the log's size is bounded by the objects, however often they change and however far a consumer lags. Merging
//! costs no more than the read that allowed it.

use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};

use super::key_map::KeyMap;
use super::{CoreKey, GeometryKey, MaterialKey, NodeKey, ObjectKey, SceneId, TextureKey};
use crate::Result;
use crate::error::require_invariant;

bitflags::bitflags! {
    /// What changed in an object. [`ADDED`](Self::ADDED) and [`REMOVED`](Self::REMOVED) stand alone: they say it all.
    /// An object that went and came back under its key, as by undo, has all other flags.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Change: u16 {
        /// The object is new.
        const ADDED = 1;
        /// The object is gone. Nodes below a removed node have entries of their own.
        const REMOVED = 2;
        /// A node's parent, and with it its place among siblings.
        const PARENT = 4;
        /// Which core a node has.
        const CORE = 8;
        /// A node's own mask.
        const MASK = 16;
        /// A node's own visibility.
        const VISIBILITY = 32;
        /// A node's name.
        const NAME = 64;
        /// A core's transform, or whether it has one: all its users moved.
        const TRANSFORM = 128;
        /// Anything else in a core; all of a geometry, material or texture.
        const DATA = 256;
        /// A core's kind: a geometry became a light, say. Its data changed with it.
        const KIND = 512;
        /// A node's children: one came, went or changed places.
        const CHILDREN = 1024;
    }
}

impl Change {
    /// Both, the later one after the earlier one; empty if the object came and went.
    fn followed_by(self, later: Self) -> Self {
        match (self.contains(Self::ADDED), later.contains(Self::REMOVED)) {
            (true, true) => Self::empty(),
            (true, false) => Self::ADDED,
            (false, true) => Self::REMOVED,
            // It went and came back: whatever it has may be another.
            (false, false) if self.contains(Self::REMOVED) => Self::all().difference(Self::ADDED | Self::REMOVED),
            (false, false) => self | later,
        }
    }
}

/// What one consumer has to catch up with.
#[derive(Clone, Debug, PartialEq, Eq)]
#[must_use = "the cursor has moved past these changes"]
pub enum Changes {
    /// The consumer's first read: take the whole scene.
    Everything,
    /// What changed since the last read, each object once, in the order of first changes. Objects that came and went
    /// are left out.
    Since(Vec<(ObjectKey, Change)>),
}

/// How far one consumer has read the log of a scene. Dropping it ends the subscription, and frees what only it had
/// still to read.
///
/// A default cursor has read nothing; see [`Scene::changes_since`](super::Scene::changes_since).
#[derive(Debug, Default)]
pub struct ChangeCursor {
    subscription: Option<(SceneId, Position)>,
}

/// The start of the first segment that a consumer has not read. Only the scene's log reads or writes it.
type Position = Arc<AtomicU64>;

/// The log of one scene. Without cursors it stores nothing.
#[derive(Debug, Default)]
pub(super) struct ChangeLog {
    cursors: Vec<Weak<AtomicU64>>,
    /// Oldest first. The last one is open: new changes go there. Empty without cursors.
    segments: VecDeque<Segment>,
    /// Where the open segment has an object's entry.
    places: EntryIndices,
    /// The same, for objects that are gone and whose slot others have got since: they may come back.
    displaced: HashMap<ObjectKey, usize>,
}

impl ChangeLog {
    /// Adds one change to the open segment. O(1) amortised.
    pub(super) fn record(&mut self, object: ObjectKey, change: Change) {
        let Some(open) = self.segments.back_mut() else { return };
        let place = self.places.get(object).filter(|&place| open.has_entry_at(object, place));
        if let Some(place) = place.or_else(|| self.displaced.get(&object).copied()) {
            open.merge_at(place, change);
            if open.compact() {
                self.displaced.clear();
                for (place, &(object, _)) in open.entries.iter().enumerate() {
                    set_entry_index(object, place, &open.entries, &mut self.places, &mut self.displaced);
                }
            }
            return;
        }
        set_entry_index(object, open.entries.len(), &open.entries, &mut self.places, &mut self.displaced);
        open.entries.push((object, change));
        if self.cursors.iter().any(|cursor| cursor.strong_count() == 0) {
            self.forget_dropped_cursors();
        }
    }

    /// What changed since the cursor's last read of this scene. Moves the cursor.
    pub(super) fn read(&mut self, scene: SceneId, cursor: &mut ChangeCursor) -> Changes {
        if self.is_caught_up(scene, cursor) {
            return Changes::Since(Vec::new());
        }
        self.forget_dropped_cursors();
        let now = self.begin_segment();
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
        self.merge_between_cursors();
        changes
    }

    fn is_caught_up(&self, scene: SceneId, cursor: &ChangeCursor) -> bool {
        let (Some(open), Some((subscribed, position))) = (self.segments.back(), &cursor.subscription) else {
            return false;
        };
        *subscribed == scene && open.start == position.load(Ordering::Relaxed) && open.entries.is_empty()
    }

    /// Allocates what recording changes of objects up to these takes.
    pub(super) fn reserve(&mut self, last_node: Option<NodeKey>, last_core: Option<CoreKey>) {
        let last = [last_node.map(ObjectKey::from), last_core.map(ObjectKey::from)];
        last.into_iter().flatten().for_each(|object| {
            self.places.set(object, 0);
        });
    }

    /// The start of an open segment without entries.
    fn begin_segment(&mut self) -> u64 {
        let start = match self.segments.back() {
            Some(open) if open.entries.is_empty() => return open.start,
            Some(open) => open.start + 1,
            None => 0,
        };
        self.displaced.clear();
        self.segments.push_back(Segment::new(start));
        start
    }

    /// All entries from the segment that starts at `since` on, merged by object. Cursors are where they will be.
    fn merged_since(&mut self, since: u64) -> Vec<(ObjectKey, Change)> {
        let first = self.segments.partition_point(|segment| segment.start < since);
        let mut merged = if self.lowest_cursor() > since {
            // Nobody else is going to read it.
            std::mem::replace(&mut self.segments[first], Segment::new(since))
        } else {
            self.segments[first].copy()
        };
        for segment in self.segments.range(first + 1..) {
            merged.append(segment);
        }
        merged.entries.retain(|(_, change)| !change.is_empty());
        merged.entries
    }

    /// Merges segments until each begins at some cursor.
    fn merge_between_cursors(&mut self) {
        self.drop_read_segments();
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
        if self.cursors.is_empty() {
            *self = Self::default();
        } else {
            self.drop_read_segments();
        }
    }

    fn drop_read_segments(&mut self) {
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

    /// Checks that each cursor stands at the start of a segment, and that no segment has two entries for an object.
    pub(super) fn validate(&self, root: NodeKey) -> Result<()> {
        let rising = self.segments.iter().is_sorted_by(|a, b| a.start < b.start);
        require_invariant(rising, root, "the log is out of order")?;
        let at_segment = |position: &u64| self.segments.iter().any(|segment| segment.start == *position);
        require_invariant(self.positions().iter().all(at_segment), root, "a cursor is not at the start of a segment")?;
        for segment in &self.segments {
            let mut seen = HashSet::new();
            let entries = segment.entries.iter().enumerate().filter(|(_, (_, change))| !change.is_empty());
            for (place, &(object, _)) in entries {
                require_invariant(seen.insert(object), object, "it has two entries in one segment of the log")?;
                let found = segment.index.is_empty() || segment.index.get(&object) == Some(&place);
                require_invariant(found, object, "the log's index does not find it")?;
            }
            let dead = segment.entries.iter().filter(|(_, change)| change.is_empty()).count();
            require_invariant(dead == segment.cancelled, root, "the log miscounts what came and went")?;
        }
        Ok(())
    }
}

/// Notes where an object's entry is, and keeps where that of the object is which had its slot before.
fn set_entry_index(
    object: ObjectKey,
    place: usize,
    entries: &[(ObjectKey, Change)],
    places: &mut EntryIndices,
    displaced: &mut HashMap<ObjectKey, usize>,
) {
    if let Some((other, other_place)) = places.set(object, place)
        && entries.get(other_place).is_some_and(|&(found, change)| found == other && !change.is_empty())
    {
        displaced.insert(other, other_place);
    }
}

/// Changes between two cursors.
#[derive(Debug)]
struct Segment {
    /// Where it starts; each later segment has a higher one.
    start: u64,
    /// One an object, in the order of first changes; without a change if the object came and went.
    entries: Vec<(ObjectKey, Change)>,
    cancelled: usize,
    /// Where each object's entry is; empty until something is merged into a closed segment.
    index: HashMap<ObjectKey, usize>,
}

impl Segment {
    fn new(start: u64) -> Self {
        Self { start, entries: Vec::new(), cancelled: 0, index: HashMap::new() }
    }

    fn copy(&self) -> Self {
        Self { entries: self.entries.clone(), cancelled: self.cancelled, ..Self::new(self.start) }
    }

    fn has_entry_at(&self, object: ObjectKey, place: usize) -> bool {
        self.entries.get(place).is_some_and(|entry| entry.0 == object)
    }

    fn merge_at(&mut self, place: usize, later: Change) {
        let change = &mut self.entries[place].1;
        // What came and went can come back.
        self.cancelled -= usize::from(change.is_empty());
        *change = change.followed_by(later);
        self.cancelled += usize::from(change.is_empty());
    }

    /// Adds the changes of the segment after this one. O(changes there), once there is an index.
    fn append(&mut self, later: &Self) {
        if later.entries.is_empty() {
            return;
        }
        if self.index.is_empty() {
            self.index = self.entries.iter().enumerate().map(|(place, entry)| (entry.0, place)).collect();
        }
        for &(object, change) in later.entries.iter().filter(|(_, change)| !change.is_empty()) {
            if let Some(&place) = self.index.get(&object) {
                self.merge_at(place, change);
            } else {
                self.index.insert(object, self.entries.len());
                self.entries.push((object, change));
            }
        }
        if self.compact() {
            self.index.clear();
        }
    }

    /// Closes the gaps if half of the entries are dead; whether it did.
    fn compact(&mut self) -> bool {
        let worth_it = self.cancelled * 2 > self.entries.len();
        if worth_it {
            self.entries.retain(|(_, change)| !change.is_empty());
            self.cancelled = 0;
        }
        worth_it
    }
}

/// A place for each object. One that was never set, or was set long ago, is wrong: the reader checks what is there.
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
        let place = match object {
            ObjectKey::Node(key) => self.nodes.get(key),
            ObjectKey::Core(key) => self.cores.get(key),
            ObjectKey::Geometry(key) => self.geometries.get(key),
            ObjectKey::Material(key) => self.materials.get(key),
            ObjectKey::Texture(key) => self.textures.get(key),
        };
        place.map(|&place| place as usize)
    }

    /// Gives the object of another generation that was in the same place, with its place.
    fn set(&mut self, object: ObjectKey, place: usize) -> Option<(ObjectKey, usize)> {
        fn insert<K: slotmap::Key + Into<ObjectKey>>(
            map: &mut KeyMap<K, u32>,
            key: K,
            place: usize,
        ) -> Option<(ObjectKey, usize)> {
            let (other, place) = map.insert(key, place as u32).filter(|&(other, _)| other != key)?;
            Some((other.into(), place as usize))
        }
        match object {
            ObjectKey::Node(key) => insert(&mut self.nodes, key, place),
            ObjectKey::Core(key) => insert(&mut self.cores, key, place),
            ObjectKey::Geometry(key) => insert(&mut self.geometries, key, place),
            ObjectKey::Material(key) => insert(&mut self.materials, key, place),
            ObjectKey::Texture(key) => insert(&mut self.textures, key, place),
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

    /// One consumer never reads again, one reads after each edit, others come and go.
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
