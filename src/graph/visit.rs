//! Depth-first traversal with a visitor. Iterative, so that depth is unlimited.

use std::ops::ControlFlow;

use super::{NodeKey, Scene};
use crate::Result;

/// Whether the children of the node just entered are visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Descend {
    /// The children are visited.
    Into,
    /// The children are skipped; the node is left at once.
    Skip,
}

/// Callbacks of [`Scene::visit`]. A closure `FnMut(NodeKey) -> ControlFlow<B, Descend>` is a visitor with only `enter`.
pub trait Visitor {
    /// The value with which the visitor ends the traversal early.
    type Break;

    /// Called for a node before its children.
    fn enter(&mut self, node: NodeKey) -> ControlFlow<Self::Break, Descend>;

    /// Called for a node after its subtree, visited or skipped. The default does nothing.
    fn leave(&mut self, _node: NodeKey) -> ControlFlow<Self::Break> {
        ControlFlow::Continue(())
    }
}

impl<B, F: FnMut(NodeKey) -> ControlFlow<B, Descend>> Visitor for F {
    type Break = B;

    fn enter(&mut self, node: NodeKey) -> ControlFlow<B, Descend> {
        self(node)
    }
}

/// Visiting the tree.
impl Scene {
    /// Traverses the subtree of `top`, children in order: enters each node before its children and leaves it after
    /// them. Stops when the visitor breaks; `leave` is then not called for the nodes entered and not left yet. O(nodes
    /// visited), no memory.
    ///
    /// ```
    /// use std::ops::ControlFlow::{self, Break, Continue};
    /// use ropewalk::graph::Descend;
    /// use ropewalk::{NodeKey, Scene, Transform};
    ///
    /// let mut scene = Scene::new();
    /// let arm = scene.add(scene.root(), Transform::IDENTITY)?;
    /// let hand = scene.add(arm, Transform::IDENTITY)?;
    /// scene.set_visible(arm, false)?;
    ///
    /// // Count the visible nodes: nothing below a hidden node is visible.
    /// let mut shown = 0;
    /// let _: ControlFlow<()> = scene.visit(scene.root(), |node| match scene.is_visible(node) {
    ///     Ok(true) => {
    ///         shown += 1;
    ///         Continue(Descend::Into)
    ///     }
    ///     _ => Continue(Descend::Skip),
    /// })?;
    /// assert_eq!(shown, 1);
    ///
    /// // Stop at a node.
    /// let found = scene.visit(scene.root(), |node| if node == hand { Break(node) } else { Continue(Descend::Into) })?;
    /// assert_eq!(found, Break(hand));
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn visit<V: Visitor>(&self, top: NodeKey, mut visitor: V) -> Result<ControlFlow<V::Break>> {
        self.node(top)?;
        Ok(self.traverse(top, &mut visitor))
    }

    fn traverse<V: Visitor>(&self, top: NodeKey, visitor: &mut V) -> ControlFlow<V::Break> {
        let mut node = top;
        loop {
            // 1. Descend while there are children to visit.
            while let (Descend::Into, Some(child)) = (visitor.enter(node)?, self.nodes[node].first_child) {
                node = child;
            }
            // 2. Leave nodes, ascending, up to the first one with a next sibling.
            loop {
                visitor.leave(node)?;
                if node == top {
                    return ControlFlow::Continue(());
                }
                let slot = &self.nodes[node];
                match (slot.next_sibling, slot.parent) {
                    (Some(sibling), _) => {
                        node = sibling;
                        break;
                    }
                    (None, Some(parent)) => node = parent,
                    (None, None) => return ControlFlow::Continue(()),
                }
            }
        }
    }
}
