//! A consumer of the change log, and which changes it must be told of.

use std::collections::HashMap;

use ropewalk::Scene;
use ropewalk::graph::{Change, ChangeCursor, Changes, ObjectKey};

use super::model::Model;

#[derive(Default)]
pub(crate) struct Reader {
    cursor: ChangeCursor,
    /// The length of the naive log, and the model, at the last read.
    last: Option<(usize, Model)>,
}

impl Reader {
    /// Reads the change log and compares it with the naive log, and with the differences of the model since the last
    /// read.
    pub(crate) fn read(&mut self, scene: &mut Scene, model: &Model, log: &[(ObjectKey, Change)]) {
        match (scene.changes_since(&mut self.cursor), &self.last) {
            (Changes::Everything, None) => {}
            (Changes::Since(changes), Some((start, snapshot))) => {
                let found: HashMap<_, _> = changes.iter().copied().collect();
                assert_eq!(found.len(), changes.len(), "an object has two entries");
                assert_eq!(found, merge(&log[*start..]));
                is_difference(&found, &snapshot.changes_to(model));
            }
            (changes, last) => panic!("{changes:?} after {last:?}"),
        }
        self.last = Some((log.len(), model.clone()));
    }
}

/// One entry for each object: a new object has no other changes, and one that was created and removed since has none.
fn merge(log: &[(ObjectKey, Change)]) -> HashMap<ObjectKey, Change> {
    let mut merged: HashMap<ObjectKey, Change> = HashMap::new();
    for &(object, change) in log {
        let before = merged.get(&object).copied().unwrap_or_default();
        if before == Change::ADDED && change == Change::REMOVED {
            merged.remove(&object);
        } else if before == Change::ADDED || change == Change::REMOVED {
            merged.insert(object, before & Change::ADDED | change & Change::REMOVED);
        } else {
            merged.insert(object, before | change);
        }
    }
    merged
}

/// Every difference was reported, and creations and removals exactly. A value that was changed back was reported, too.
fn is_difference(found: &HashMap<ObjectKey, Change>, expected: &[(ObjectKey, Change)]) {
    let ends = Change::ADDED | Change::REMOVED;
    assert!(expected.iter().all(|(object, change)| found.get(object).is_some_and(|found| found.contains(*change))));
    let count = |changes: &mut dyn Iterator<Item = Change>| changes.filter(|change| change.intersects(ends)).count();
    assert_eq!(count(&mut found.values().copied()), count(&mut expected.iter().map(|(_, change)| *change)));
}
