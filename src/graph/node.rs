//! Nodes: the tree's joints, linked to their family and to the other users of their core.

use super::{CoreKey, NodeKey};

/// A node as the scene stores it. All lists are linked through the nodes themselves, so that every edit of them is
/// O(1).
#[derive(Debug)]
pub(super) struct Node {
    pub(super) parent: Option<NodeKey>,
    pub(super) first_child: Option<NodeKey>,
    pub(super) last_child: Option<NodeKey>,
    pub(super) previous_sibling: Option<NodeKey>,
    pub(super) next_sibling: Option<NodeKey>,
    pub(super) core: CoreKey,
    pub(super) previous_user: Option<NodeKey>,
    pub(super) next_user: Option<NodeKey>,
    pub(super) mask: u32,
    pub(super) visible: bool,
    pub(super) name: Box<str>,
}

impl Node {
    /// A node outside all lists.
    pub(super) fn new(core: CoreKey) -> Self {
        Self {
            parent: None,
            first_child: None,
            last_child: None,
            previous_sibling: None,
            next_sibling: None,
            core,
            previous_user: None,
            next_user: None,
            mask: u32::MAX,
            visible: true,
            name: Box::default(),
        }
    }
}

/// What stays as it is when a node gets another parent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KeepTransform {
    /// Its local transform: it moves with its new parent's space.
    Local,
    /// Its world transform: it stays where it is, and its local transform is adapted.
    World,
}
