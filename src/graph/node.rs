//! Nodes, stored with intrusive links to parent, siblings, children and the other users of their core.

use super::{CoreKey, NodeKey};

/// A node as the scene stores it. Children and core users are intrusive doubly linked lists, so that insertion and
/// removal are O(1).
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
    /// A node that is not linked into any list.
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

/// Which transform of a node is preserved when it is reparented.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KeepTransform {
    /// The local transform; the world transform changes with the new parent.
    Local,
    /// The world transform; the local transform is recomputed.
    World,
}
