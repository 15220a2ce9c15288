//! Intrusive lists: the children of a node, the users of a core. All operations are O(1).

use super::{CoreKey, NodeKey, Scene};

impl Scene {
    /// Appends `node`, which has no parent, to the children of `parent`.
    pub(super) fn link_child(&mut self, node: NodeKey, parent: NodeKey) {
        self.link_child_after(node, parent, self.nodes[parent].last_child);
    }

    /// Makes `node`, which has no parent, the child of `parent` that comes after `previous`; `None` makes it the
    /// first child.
    pub(super) fn link_child_after(&mut self, node: NodeKey, parent: NodeKey, previous: Option<NodeKey>) {
        // Link from the previous sibling, or as the first child.
        let next = match previous {
            Some(previous) => self.nodes[previous].next_sibling.replace(node),
            None => self.nodes[parent].first_child.replace(node),
        };
        // Link from the next sibling, or as the last child.
        match next {
            Some(next) => {
                self.save_prior_state(next);
                self.nodes[next].previous_sibling = Some(node);
            }
            None => self.nodes[parent].last_child = Some(node),
        }
        let slot = &mut self.nodes[node];
        (slot.parent, slot.previous_sibling, slot.next_sibling) = (Some(parent), previous, next);
    }

    /// Takes `node` out of the children of its parent.
    pub(super) fn unlink_child(&mut self, node: NodeKey) {
        self.save_prior_state(node);
        if let Some(next) = self.nodes[node].next_sibling {
            // Its previous sibling, which is part of its state, changes.
            self.save_prior_state(next);
        }
        // Clear the node's own links, then close the gap on both sides.
        let slot = &mut self.nodes[node];
        let (previous, next) = (slot.previous_sibling.take(), slot.next_sibling.take());
        let Some(parent) = slot.parent.take() else { return };
        match previous {
            Some(previous) => self.nodes[previous].next_sibling = next,
            None => self.nodes[parent].first_child = next,
        }
        match next {
            Some(next) => self.nodes[next].previous_sibling = previous,
            None => self.nodes[parent].last_child = previous,
        }
    }

    /// Makes `node`, which has no core, a user of `core`.
    pub(super) fn link_user(&mut self, node: NodeKey, core: CoreKey) {
        // Insert it at the head of the list: the order of users has no meaning.
        let slot = &mut self.cores[core];
        slot.user_count += 1;
        let next = slot.first_user.replace(node);
        if let Some(next) = next {
            self.nodes[next].previous_user = Some(node);
        }
        let slot = &mut self.nodes[node];
        (slot.core, slot.previous_user, slot.next_user) = (core, None, next);
    }

    /// Takes `node` out of the users of `core`, its core.
    pub(super) fn unlink_user(&mut self, node: NodeKey, core: CoreKey) {
        self.cores[core].user_count -= 1;
        let slot = &mut self.nodes[node];
        let (previous, next) = (slot.previous_user.take(), slot.next_user.take());
        // Close the gap in the list of users.
        match previous {
            Some(previous) => self.nodes[previous].next_user = next,
            None => self.cores[core].first_user = next,
        }
        if let Some(next) = next {
            self.nodes[next].previous_user = previous;
        }
    }
}
