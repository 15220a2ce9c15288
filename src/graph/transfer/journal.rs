//! The journal: prior states of edited objects, for transactions and undo.

use std::collections::HashMap;

use super::check::order_of_siblings;
use super::undo::UndoHistory;
use super::{Delta, ObjectState};
use crate::Result;
use crate::graph::{ObjectKey, Scene};

/// The states of objects before the first edit of each; `None` for absent.
pub(super) type PriorStates = HashMap<ObjectKey, Option<ObjectState>>;

/// The prior states of each open transaction and of the current undo group, and the undo history.
#[derive(Debug, Default)]
pub(in crate::graph) struct Journal {
    /// Open transactions, the innermost last.
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

    /// The map that records prior states at the moment: the innermost transaction's, else the current undo group's.
    fn innermost(&mut self) -> Option<&mut PriorStates> {
        self.transactions.last_mut().or_else(|| Some(self.history.as_mut()?.prior_states_mut()))
    }
}

/// Recording; called by every edit.
impl Scene {
    /// To be called before every edit of an object. The first call in a transaction or undo group saves the object's
    /// state; later ones do nothing. One branch if neither a transaction nor undo is active.
    pub(in crate::graph) fn save_prior_state(&mut self, object: impl Into<ObjectKey>) {
        if self.journal.is_active() {
            self.save_state_once(object.into());
        }
    }

    /// Records that an object, just added, was absent before.
    pub(in crate::graph) fn save_as_absent(&mut self, object: ObjectKey) {
        if let Some(before) = self.journal.innermost() {
            before.entry(object).or_insert(None);
        }
    }

    /// Drops the record of an object that was created and removed within the current undo group. (In a transaction the
    /// record stays; it is short-lived.)
    pub(in crate::graph) fn discard_transient(&mut self, object: ObjectKey) {
        if !self.journal.is_in_transaction()
            && let Some(before) = self.journal.innermost()
            && before.get(&object) == Some(&None)
        {
            before.remove(&object);
        }
    }

    fn save_state_once(&mut self, object: ObjectKey) {
        let is_saved = |before: &mut PriorStates| before.contains_key(&object);
        if !self.journal.innermost().is_some_and(is_saved) {
            let state = self.state(object);
            if let Some(before) = self.journal.innermost() {
                before.insert(object, state);
            }
        }
    }
}

/// Transactions.
impl Scene {
    /// Runs `edit` atomically: if it returns an error or panics, every object is restored under its key. Nestable.
    /// Costs a copy of the state of each object edited, arrays shared.
    ///
    /// The rollback is logged like any edit, so cursors read in between see it.
    ///
    /// ```
    /// use ropewalk::graph::KeepTransform;
    /// use ropewalk::{Core, Scene};
    ///
    /// let mut scene = Scene::new();
    /// let arm = scene.add(scene.root(), Core::Group)?;
    /// let result = scene.transaction(|scene| {
    ///     let hand = scene.add(arm, Core::Group)?;
    ///     scene.set_name(arm, "arm")?;
    ///     scene.reparent(arm, hand, KeepTransform::Local)
    /// });
    /// assert!(result.is_err(), "that would close a cycle");
    /// assert_eq!((scene.node_count(), scene.name(arm)?), (2, ""));
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// Those of `edit`. Then the scene is as it was, except for its [`revision`](Self::revision).
    pub fn transaction<T>(&mut self, edit: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        self.journal.transactions.push(PriorStates::new());
        // The guard rolls back when it is dropped, by `?` or by a panic, unless it is marked as done.
        let mut transaction = Transaction { scene: self, is_done: false };
        let value = edit(transaction.scene)?;
        transaction.is_done = true;
        Ok(value)
    }
}

/// An open transaction. [`Drop`] ends it in any case: it commits if `is_done`, else it rolls back.
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
    /// Merges the prior states of a committed transaction into the enclosing one or the undo group.
    fn merge_into_outer(&mut self, done: PriorStates) {
        if done.is_empty() {
            return;
        }
        // The outer record is older: it takes precedence.
        if let Some(outer) = self.innermost() {
            for (object, state) in done {
                outer.entry(object).or_insert(state);
            }
        }
    }
}

impl Scene {
    /// Restores the states of objects, without recording it.
    pub(super) fn restore(&mut self, before: &Delta) {
        // Without its journal the scene records nothing.
        let journal = std::mem::take(&mut self.journal);
        self.write_states(before, &order_of_siblings(before).0);
        self.journal = journal;
    }
}
