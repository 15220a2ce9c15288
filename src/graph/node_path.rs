//! Which appearance of a node: the node, and the instances that it is seen through.

use serde::{Deserialize, Serialize};

use super::NodeKey;

/// Names one appearance of a node in the world: a node below an instanced subtree has several.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct NodePath {
    /// The instance nodes that it is seen through, outermost first; empty for the node where it stands in the tree.
    pub instances: Vec<NodeKey>,
    /// The node itself.
    pub node: NodeKey,
}

impl From<NodeKey> for NodePath {
    /// The node where it stands in the tree.
    fn from(node: NodeKey) -> Self {
        Self { instances: Vec::new(), node }
    }
}
