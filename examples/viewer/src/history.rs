//! Edits, and their undoing.

use ropewalk::{NodeKey, Result, Scene, Transform};

/// One change of a scene that the user asks for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Edit {
    Move(NodeKey, Transform),
    Rename(NodeKey, String),
    Show(NodeKey, bool),
    Mask(NodeKey, u32),
}

/// What was done and can be undone, in groups with a name.
#[derive(Debug, Default)]
pub(crate) struct History {
    /// What undoes the edits since the last group ended.
    open: Vec<Edit>,
    name: &'static str,
    undo: Vec<Group>,
    redo: Vec<Group>,
}

#[derive(Debug)]
struct Group {
    name: &'static str,
    /// In the order of the edits that they undo.
    edits: Vec<Edit>,
}

impl Edit {
    /// In one word.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Move(..) => "move",
            Self::Rename(..) => "rename",
            Self::Show(_, true) => "show",
            Self::Show(_, false) => "hide",
            Self::Mask(..) => "mask",
        }
    }

    /// Does it, and returns what undoes it.
    fn apply(self, scene: &mut Scene) -> Result<Self> {
        match self {
            Self::Move(node, local) => {
                let old = scene.local(node)?;
                scene.set_local(node, local).map(|()| Self::Move(node, old))
            }
            Self::Rename(node, name) => {
                let old = scene.name(node)?.to_owned();
                scene.set_name(node, name).map(|()| Self::Rename(node, old))
            }
            Self::Show(node, visible) => {
                let old = scene.is_visible(node)?;
                scene.set_visible(node, visible).map(|()| Self::Show(node, old))
            }
            Self::Mask(node, mask) => {
                let old = scene.mask(node)?;
                scene.set_mask(node, mask).map(|()| Self::Mask(node, old))
            }
        }
    }
}

impl History {
    /// Does an edit as part of the open group.
    pub(crate) fn edit(&mut self, scene: &mut Scene, edit: Edit) -> Result<()> {
        self.name = edit.name();
        self.open.push(edit.apply(scene)?);
        Ok(())
    }

    /// Ends the open group; returns its name if there was one.
    pub(crate) fn end_group(&mut self) -> Option<&'static str> {
        if self.open.is_empty() {
            return None;
        }
        self.redo.clear();
        self.undo.push(Group { name: self.name, edits: std::mem::take(&mut self.open) });
        Some(self.name)
    }

    /// The name of the group that [`undo`](Self::undo) would undo.
    pub(crate) fn undoable(&self) -> Option<&'static str> {
        self.undo.last().map(|group| group.name)
    }

    /// The name of the group that [`redo`](Self::redo) would do again.
    pub(crate) fn redoable(&self) -> Option<&'static str> {
        self.redo.last().map(|group| group.name)
    }

    /// Undoes the last group and returns its name.
    pub(crate) fn undo(&mut self, scene: &mut Scene) -> Result<Option<&'static str>> {
        self.end_group();
        swap(&mut self.undo, &mut self.redo, scene)
    }

    /// Does the last undone group again and returns its name.
    pub(crate) fn redo(&mut self, scene: &mut Scene) -> Result<Option<&'static str>> {
        swap(&mut self.redo, &mut self.undo, scene)
    }
}

/// Applies the last group of one list and puts what undoes it on the other.
fn swap(from: &mut Vec<Group>, to: &mut Vec<Group>, scene: &mut Scene) -> Result<Option<&'static str>> {
    let Some(Group { name, edits }) = from.pop() else { return Ok(None) };
    let inverse = edits.into_iter().rev().map(|edit| edit.apply(scene)).collect::<Result<_>>()?;
    to.push(Group { name, edits: inverse });
    Ok(Some(name))
}
