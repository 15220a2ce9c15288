//! Walks that choose their way: visitors. Iterative, so as deep as any scene.

use std::ops::ControlFlow;

use super::{NodeKey, Scene};
use crate::Result;

/// What a [`Visitor`] wants of the children of the node that it has just entered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Descend {
    /// Visit them.
    Into,
    /// Pass them over; the node is left at once.
    Skip,
}

/// What [`Scene::visit`] calls on its way. A closure from a node to `ControlFlow<B, Descend>` is one that only enters.
pub trait Visitor {
    /// What the visitor breaks off with.
    type Break;

    /// Called for a node before its children.
    fn enter(&mut self, node: NodeKey) -> ControlFlow<Self::Break, Descend>;

    /// Called for a node after what is below it, if that was visited at all. Does nothing unless written.
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
    /// Walks from `top` down, children in order: enters each node before its children and leaves it after them, until the
    /// visitor breaks off; then nothing more is left. O(nodes visited), no memory.
    ///
    /// ```
    /// use std::ops::ControlFlow::{self, Break, Continue};
    /// use ropewalk::{Descend, NodeKey, Scene, Transform};
    ///
    /// let mut scene = Scene::new();
    /// let arm = scene.add(scene.root(), Transform::IDENTITY)?;
    /// let hand = scene.add(arm, Transform::IDENTITY)?;
    /// scene.set_visible(arm, false)?;
    ///
    /// // Counts what is shown: nothing below a hidden node is.
    /// let mut shown = 0;
    /// let _: ControlFlow<()> = scene.visit(scene.root(), |node| match scene.is_visible(node) {
    ///     Ok(true) => {
    ///         shown += 1;
    ///         Continue(Descend::Into)
    ///     }
    ///     _ => Continue(Descend::Past),
    /// })?;
    /// assert_eq!(shown, 1);
    ///
    /// // Breaks off at the first node that is two below.
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
            // 1. Down, as far as there are children.
            while let (Descend::Into, Some(child)) = (visitor.enter(node)?, self.nodes[node].first_child) {
                node = child;
            }
            // 2. Up, to the first node that has a sibling left.
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
