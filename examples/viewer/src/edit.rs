//! Edits of the scene by the user.

use ropewalk::{NodeKey, Result, Scene, Transform};

/// One change of a scene.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Edit {
    Move(NodeKey, Transform),
    Rename(NodeKey, String),
    Show(NodeKey, bool),
    Mask(NodeKey, u32),
    Remove(NodeKey),
}

impl Edit {
    /// The name of the edit, in one word.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Move(..) => "move",
            Self::Rename(..) => "rename",
            Self::Show(_, true) => "show",
            Self::Show(_, false) => "hide",
            Self::Mask(..) => "mask",
            Self::Remove(_) => "remove",
        }
    }

    /// Applies the edit.
    pub(crate) fn apply(self, scene: &mut Scene) -> Result<()> {
        match self {
            Self::Move(node, local) => scene.set_local(node, local),
            Self::Rename(node, name) => scene.set_name(node, name),
            Self::Show(node, visible) => scene.set_visible(node, visible),
            Self::Mask(node, mask) => scene.set_mask(node, mask),
            Self::Remove(node) => scene.remove(node),
        }
    }
}
