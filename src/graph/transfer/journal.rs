//! The journal: what objects were before they were edited, so that edits can be taken back.

use std::collections::HashMap;

use super::check::order_of_siblings;
use super::undo::UndoHistory;
use super::{Delta, ObjectState};
use crate::Result;
use crate::graph::{ObjectKey, Scene};

/// What objects were before the first edit of each, `None` for absent.
pub(super) type PriorStates = HashMap<ObjectKey, Option<ObjectState>>;

/// What was before each open transaction, and before the edits that undo is going to take back.
#[derive(Debug, Default)]
pub(in crate::graph) struct Journal {
    /// The innermost last.
    transactions: Vec<PriorStates>,
    pub(super) history: Option<UndoHistory>,
}

impl Journal {
    fn is_active(&self) -> bool {
        self.history.is_some() || !self.transactions.is_empty()
    }

    pub(super) fn is_in_transaction(&self) -> bool {
        !self.transactions.is_empty()
    }

    /// Where edits are noted now.
    fn innermost(&mut self) -> Option<&mut PriorStates> {
        self.transactions.last_mut().or_else(|| Some(self.history.as_mut()?.prior_states_mut()))
    }
}

/// Taking note, for all that edits.
impl Scene {
    /// Notes what an object is, unless that is known. To be called before each edit of an object. Costs a branch where
    /// nobody wants to know.
    pub(in crate::graph) fn save_prior_state(&mut self, object: impl Into<ObjectKey>) {
        if self.journal.is_active() {
            self.save_state_once(object.into());
        }
    }

    /// Notes that an object that is here now was not before.
    pub(in crate::graph) fn save_as_absent(&mut self, object: ObjectKey) {
        if let Some(before) = self.journal.innermost() {
            before.entry(object).or_insert(None);
        }
    }

    /// Notes nothing of an object that is gone now and was not there before the group either: it only passed. (A
    /// transaction does not last long enough for that to matter.)
    pub(in crate::graph) fn discard_transient(&mut self, object: ObjectKey) {
        if !self.journal.is_in_transaction()
            && let Some(before) = self.journal.innermost()
            && before.get(&object) == Some(&None)
        {
            before.remove(&object);
        }
    }

    fn save_state_once(&mut self, object: ObjectKey) {
        let is_known = |before: &mut PriorStates| before.contains_key(&object);
        if !self.journal.innermost().is_some_and(is_known) {
            let state = self.state(object);
            if let Some(before) = self.journal.innermost() {
                before.insert(object, state);
            }
        }
    }
}

/// Transactions.
impl Scene {
    /// Runs edits, all or none: where they end with an error, or panic, all objects become again what they were, under
    /// the keys they had. Transactions can be nested. Costs a copy of the state of each object edited, arrays shared.
    ///
    /// What is taken back is logged as any edit is: who read the log in between reads that too.
    ///
    /// ```
    /// use ropewalk::{Core, Keep, Scene};
    ///
    /// let mut scene = Scene::new();
    /// let arm = scene.add(scene.root(), Core::Group)?;
    /// let result = scene.transaction(|scene| {
    ///     let hand = scene.add(arm, Core::Group)?;
    ///     scene.set_name(arm, "arm")?;
    ///     scene.reparent(arm, hand, Keep::Local)
    /// });
    /// assert!(result.is_err(), "that would close a cycle");
    /// assert_eq!((scene.node_count(), scene.name(arm)?), (2, ""));
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// Those of `edit`. Then the scene is as it was, but for its [`revision`](Self::revision).
    pub fn transaction<T>(&mut self, edit: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        self.journal.transactions.push(PriorStates::new());
        let mut transaction = Transaction { scene: self, is_done: false };
        let value = edit(transaction.scene)?;
        transaction.is_done = true;
        Ok(value)
    }
}

/// An open transaction. Whatever ends it, [`Drop`] sees it.
struct Transaction<'a> {
    scene: &'a mut Scene,
    is_done: bool,
}

impl Drop for Transaction<'_> {
    fn drop(&mut self) {
        let before = self.scene.journal.transactions.pop().unwrap_or_default();
        if self.is_done {
            self.scene.journal.merge_into_outer(before);
        } else {
            self.scene.restore(&Delta::new(before));
        }
    }
}

impl Journal {
    /// Makes a transaction that is done part of what is around it, which has seen none of its edits.
    fn merge_into_outer(&mut self, done: PriorStates) {
        if done.is_empty() {
            return;
        }
        if let Some(around) = self.innermost() {
            for (object, state) in done {
                around.entry(object).or_insert(state);
            }
        }
    }
}

impl Scene {
    /// Makes objects be what they were, without noting it.
    pub(super) fn restore(&mut self, before: &Delta) {
        let journal = std::mem::take(&mut self.journal);
        self.write_states(before, &order_of_siblings(before).0);
        self.journal = journal;
    }
}
