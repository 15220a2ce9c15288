//! Undo and redo: groups of edits that are taken back and done again.

use std::collections::VecDeque;

use super::Delta;
use super::journal::PriorStates;
use crate::error::HistoryStep;
use crate::graph::Scene;
use crate::{Error, Result};

/// What undo and redo can do.
#[derive(Debug)]
pub(super) struct UndoHistory {
    limit: usize,
    /// To be undone; the newest last.
    undo_groups: VecDeque<UndoGroup>,
    /// To be redone; the one that was undone last, last.
    redo_groups: Vec<UndoGroup>,
    /// What objects were before the edits since the last group.
    open: PriorStates,
}

/// What the objects of a group of edits were on the other side of it.
#[derive(Debug)]
struct UndoGroup {
    name: String,
    states: Delta,
}

impl UndoHistory {
    /// Where edits are to be noted. They end what could be redone.
    pub(super) fn prior_states_mut(&mut self) -> &mut PriorStates {
        self.redo_groups.clear();
        &mut self.open
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
    /// How many groups can be undone unless [`set_undo_limit`](Self::set_undo_limit) says otherwise.
    pub const DEFAULT_UNDO_LIMIT: usize = 256;

    /// From now on edits can be taken back. Does nothing where they already can.
    ///
    /// Each edit then notes what the object was, once in each group: O(1), arrays shared. Removed objects come back
    /// under their keys, and whatever held on to these can go on.
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
            open: PriorStates::new(),
        });
    }

    /// Forgets what could be undone and redone, and notes nothing any more.
    pub fn disable_undo(&mut self) {
        self.journal.history = None;
    }

    /// Keeps at most this many groups to be undone; the oldest go. Does nothing where undo is not enabled.
    pub fn set_undo_limit(&mut self, groups: usize) {
        if let Some(history) = &mut self.journal.history {
            history.limit = groups;
            history.trim_to_limit();
        }
    }

    /// Makes all edits since the last call one group, to be undone together. Without such edits there is no group; and
    /// within a transaction, which may yet be taken back, it does nothing. O(objects edited).
    pub fn end_undo_group(&mut self, name: impl Into<String>) {
        if self.journal.is_in_transaction() {
            return;
        }
        let Some(history) = &mut self.journal.history else { return };
        let mut before = std::mem::take(&mut history.open);
        // Not what came and went.
        before.retain(|&object, state| state.is_some() || self.contains_object(object));
        if let Some(history) = &mut self.journal.history
            && !before.is_empty()
        {
            history.push_undo(UndoGroup { name: name.into(), states: Delta::new(before) });
        }
    }

    /// Takes back the newest group that was not, and tells its name; `None` if there is none. Edits that no group was
    /// ended after are a group without a name. O(objects edited in it).
    ///
    /// # Errors
    /// [`Error::Transaction`] within a transaction: let that end first.
    pub fn undo(&mut self) -> Result<Option<String>> {
        self.require_no_transaction(HistoryStep::Undo)?;
        self.end_undo_group("");
        let Some(group) = self.journal.history.as_mut().and_then(|history| history.undo_groups.pop_back()) else {
            return Ok(None);
        };
        let group = self.swap_states(group);
        let name = group.name.clone();
        if let Some(history) = &mut self.journal.history {
            history.redo_groups.push(group);
        }
        Ok(Some(name))
    }

    /// Does the group again that was undone last, and tells its name; `None` if there is none, or if there were edits
    /// since. O(objects edited in it).
    ///
    /// # Errors
    /// [`Error::Transaction`] within a transaction: let that end first.
    pub fn redo(&mut self) -> Result<Option<String>> {
        self.require_no_transaction(HistoryStep::Redo)?;
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

    /// The name of the group that [`undo`](Self::undo) would take back; empty for edits that no group was ended after.
    pub fn next_undo(&self) -> Option<&str> {
        let history = self.journal.history.as_ref()?;
        let last = || history.undo_groups.back().map(|group| group.name.as_str());
        if history.open.is_empty() { last() } else { Some("") }
    }

    /// The name of the group that [`redo`](Self::redo) would do again.
    pub fn next_redo(&self) -> Option<&str> {
        self.journal.history.as_ref()?.redo_groups.last().map(|group| group.name.as_str())
    }

    /// Makes the objects of a group what they were on the other side of it; gives the group as seen from there.
    fn swap_states(&mut self, group: UndoGroup) -> UndoGroup {
        let objects = group.states.objects().map(|(object, _)| object);
        let states = Delta::new(objects.map(|object| (object, self.state(object))));
        self.restore(&group.states);
        UndoGroup { name: group.name, states }
    }

    fn require_no_transaction(&self, attempt: HistoryStep) -> Result<()> {
        if self.journal.is_in_transaction() { Err(Error::Transaction { attempt }) } else { Ok(()) }
    }
}
