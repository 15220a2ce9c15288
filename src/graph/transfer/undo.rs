//! Undo and redo of groups of edits.

use std::collections::VecDeque;

use super::Delta;
use super::journal::PriorStates;
use crate::error::HistoryStep;
use crate::graph::Scene;
use crate::{Error, Result};

/// The groups that can be undone and redone.
#[derive(Debug)]
pub(super) struct UndoHistory {
    limit: usize,
    /// Undo stack; the newest group last.
    undo_groups: VecDeque<UndoGroup>,
    /// Redo stack; the group undone last is last.
    redo_groups: Vec<UndoGroup>,
    /// Prior states of the current group: the edits since the last one ended.
    current: PriorStates,
}

/// A named group of edits: the states its objects had before it (on the undo stack) or after it (on the redo stack).
#[derive(Debug)]
struct UndoGroup {
    name: String,
    states: Delta,
}

impl UndoHistory {
    /// The prior states of the current group. Clears the redo stack, as a new edit does.
    pub(super) fn prior_states_mut(&mut self) -> &mut PriorStates {
        self.redo_groups.clear();
        &mut self.current
    }

    fn push_undo(&mut self, group: UndoGroup) {
        self.undo_groups.push_back(group);
        self.trim_to_limit();
    }

    fn trim_to_limit(&mut self) {
        while self.undo_groups.len() > self.limit {
            self.undo_groups.pop_front();
        }
    }
}

/// Undo and redo.
impl Scene {
    /// Number of groups that can be undone unless [`set_undo_limit`](Self::set_undo_limit) changes it.
    pub const DEFAULT_UNDO_LIMIT: usize = 256;

    /// Enables undo. Does nothing if it is enabled.
    ///
    /// Each edit then saves the state of its object, once per group: O(1), arrays shared. Undo restores removed objects
    /// under their keys, so that keys held elsewhere are valid again.
    ///
    /// ```
    /// use ropewalk::{Core, Scene};
    ///
    /// let mut scene = Scene::new();
    /// scene.enable_undo();
    /// let node = scene.add(scene.root(), Core::Group)?;
    /// scene.set_name(node, "arm")?;
    /// scene.end_undo_group("add an arm");
    /// scene.remove(node)?;
    /// scene.end_undo_group("remove the arm");
    ///
    /// assert_eq!(scene.next_undo(), Some("remove the arm"));
    /// scene.undo()?;
    /// assert_eq!(scene.name(node)?, "arm");
    /// assert_eq!(scene.undo()?.as_deref(), Some("add an arm"));
    /// assert!(!scene.contains(node));
    /// assert_eq!(scene.redo()?.as_deref(), Some("add an arm"));
    /// assert_eq!((scene.name(node)?, scene.next_redo()), ("arm", Some("remove the arm")));
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    pub fn enable_undo(&mut self) {
        self.journal.history.get_or_insert_with(|| UndoHistory {
            limit: Self::DEFAULT_UNDO_LIMIT,
            undo_groups: VecDeque::new(),
            redo_groups: Vec::new(),
            current: PriorStates::new(),
        });
    }

    /// Disables undo and drops all groups.
    pub fn disable_undo(&mut self) {
        self.journal.history = None;
    }

    /// Limits the undo stack to this many groups; the oldest are dropped. Does nothing if undo is not enabled.
    pub fn set_undo_limit(&mut self, groups: usize) {
        if let Some(history) = &mut self.journal.history {
            history.limit = groups;
            history.trim_to_limit();
        }
    }

    /// Ends the current group: all edits since the last call are undone together. Without such edits there is no group.
    /// Within a transaction, which may yet be rolled back, it does nothing. O(objects edited).
    pub fn end_undo_group(&mut self, name: impl Into<String>) {
        if self.journal.is_in_transaction() {
            return;
        }
        let Some(history) = &mut self.journal.history else { return };
        let mut before = std::mem::take(&mut history.current);
        // Leave out objects that were added and removed within the group.
        before.retain(|&object, state| state.is_some() || self.contains_object(object));
        if let Some(history) = &mut self.journal.history
            && !before.is_empty()
        {
            history.push_undo(UndoGroup { name: name.into(), states: Delta::new(before) });
        }
    }

    /// Undoes the newest group and returns its name; `None` if there is none. Edits since the last
    /// [`end_undo_group`](Self::end_undo_group) form an unnamed group. O(objects edited in it).
    ///
    /// # Errors
    /// [`Error::Transaction`] within a transaction: let that end first.
    pub fn undo(&mut self) -> Result<Option<String>> {
        // 1. End the current group, and take the newest one.
        self.require_no_transaction(HistoryStep::Undo)?;
        self.end_undo_group("");
        let Some(group) = self.journal.history.as_mut().and_then(|history| history.undo_groups.pop_back()) else {
            return Ok(None);
        };
        // 2. Restore its states; those that they replace are what redo restores.
        let group = self.swap_states(group);
        let name = group.name.clone();
        if let Some(history) = &mut self.journal.history {
            history.redo_groups.push(group);
        }
        Ok(Some(name))
    }

    /// Redoes the group undone last and returns its name; `None` if there is none, or if there were edits since.
    /// O(objects edited in it).
    ///
    /// # Errors
    /// [`Error::Transaction`] within a transaction: let that end first.
    pub fn redo(&mut self) -> Result<Option<String>> {
        self.require_no_transaction(HistoryStep::Redo)?;
        // As undo, from the redo stack to the undo stack.
        let Some(group) = self.journal.history.as_mut().and_then(|history| history.redo_groups.pop()) else {
            return Ok(None);
        };
        let group = self.swap_states(group);
        let name = group.name.clone();
        if let Some(history) = &mut self.journal.history {
            history.push_undo(group);
        }
        Ok(Some(name))
    }

    /// The name of the group that [`undo`](Self::undo) would undo; empty for an unnamed group.
    pub fn next_undo(&self) -> Option<&str> {
        let history = self.journal.history.as_ref()?;
        let last = || history.undo_groups.back().map(|group| group.name.as_str());
        if history.current.is_empty() { last() } else { Some("") }
    }

    /// The name of the group that [`redo`](Self::redo) would redo.
    pub fn next_redo(&self) -> Option<&str> {
        self.journal.history.as_ref()?.redo_groups.last().map(|group| group.name.as_str())
    }

    /// Swaps the states stored in the group with the scene's current ones.
    fn swap_states(&mut self, group: UndoGroup) -> UndoGroup {
        // Save the current states of the same objects before they are overwritten.
        let objects = group.states.objects().map(|(object, _)| object);
        let states = Delta::new(objects.map(|object| (object, self.state(object))));
        self.restore(&group.states);
        UndoGroup { name: group.name, states }
    }

    fn require_no_transaction(&self, attempt: HistoryStep) -> Result<()> {
        if self.journal.is_in_transaction() { Err(Error::Transaction { attempt }) } else { Ok(()) }
    }
}
