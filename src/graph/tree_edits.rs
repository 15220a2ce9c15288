//! Tree edits: add, remove, reparent; and node properties: name, mask, visibility.

use glam::{DAffine3, DVec3};

use super::changes::Change;
use super::node::Node;
use super::{Core, CoreSource, KeepTransform, NodeKey, Scene, Transform};
use crate::error::RootEdit;
use crate::{Error, Result};

/// The tree.
impl Scene {
    /// Adds a node as the last child of `parent`: visible, with all bits of its mask set and an empty name. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`] for the parent or a key in the core; [`Error::OutOfRange`] if a number in a new core is out
    /// of range; [`Error::Cycle`] if the core instances the parent or one of its ancestors (through parents or
    /// instances).
    pub fn add(&mut self, parent: NodeKey, core: impl Into<CoreSource>) -> Result<NodeKey> {
        self.node(parent)?;
        // Check the core, and that an instance does not show a node above it.
        let source = core.into();
        if let CoreSource::New(core @ Core::Instance(_)) = &source {
            self.check_core(core)?;
            self.check_instance_cycle(parent, core)?;
        } else if let CoreSource::Shared(key) = source {
            self.check_instance_cycle(parent, self.core(key)?)?;
        }
        // Create the node, and link it to its core and its parent.
        let core = self.insert_or_share_core(source)?;
        let node = self.nodes.insert(Node::new(core));
        self.link_user(node, core);
        self.link_child(node, parent);
        // Notify the hierarchy and the change log.
        self.hierarchy.node_attached(node);
        self.record(node, Change::ADDED);
        self.children_changed(parent);
        Ok(node)
    }

    /// Removes a node and everything below it, and frees the cores, geometries, materials and textures that only these
    /// used. Instance cores whose target is removed become groups. O(nodes removed).
    ///
    /// # Errors
    /// [`Error::StaleKey`]; [`Error::Root`] for the root.
    pub fn remove(&mut self, node: NodeKey) -> Result<()> {
        self.node(node)?;
        if node == self.root {
            return Err(Error::Root { attempt: RootEdit::Remove });
        }
        // 1. Replace the instance cores that show a removed node.
        if !self.cores_by_target.is_empty() {
            let nodes: Vec<NodeKey> = self.subtree(node)?.collect();
            nodes.into_iter().try_for_each(|node| self.replace_instances_by_groups(node))?;
        }
        // 2. Take the subtree out of the hierarchy and out of the children of its parent.
        self.hierarchy.subtree_removed(node);
        let parent = self.nodes[node].parent;
        self.unlink_child(node);
        parent.into_iter().for_each(|parent| self.children_changed(parent));

        // 3. Free the subtree in postorder, so that links are valid while they are followed.
        let mut current = self.first_leaf(node);
        loop {
            let (parent, next) = (self.nodes[current].parent, self.nodes[current].next_sibling);
            self.release_node(current);
            if current == node {
                return Ok(());
            }
            current = match (next, parent) {
                (Some(sibling), _) => self.first_leaf(sibling),
                (None, Some(parent)) => parent,
                (None, None) => return Ok(()),
            };
        }
    }

    /// Makes `node` the last child of `parent`, with everything below it. If `parent` already is its parent, the
    /// sibling order is unchanged. O(depth) for the cycle check, or O(ancestors through all instances) if the scene has
    /// instances.
    ///
    /// With [`KeepTransform::World`] the node gets a [`Transform::Matrix`] that preserves its world transform up to
    /// rounding. If its transform core is shared, the node first gets a copy, so that other users do not move.
    ///
    /// # Errors
    /// [`Error::StaleKey`]; [`Error::Root`] for the root; [`Error::Cycle`] if `parent` is `node`, or below it, or shown
    /// by an instance below it. With [`KeepTransform::World`] also [`Error::WrongCore`] if the node has no transform
    /// core, and [`Error::Singular`] if the new parent's world matrix cannot be inverted: some scale above it is 0, or
    /// too large or small for f64.
    pub fn reparent(&mut self, node: NodeKey, parent: NodeKey, keep: KeepTransform) -> Result<()> {
        // 1. Check that the node may move there.
        self.node(node)?;
        self.node(parent)?;
        if node == self.root {
            return Err(Error::Root { attempt: RootEdit::Move });
        }
        if self.is_ancestor_or_self(node, parent) {
            return Err(Error::Cycle { node, parent });
        }
        // 2. Compute the local transform that preserves the world transform, while the old one is known.
        let local = match keep {
            KeepTransform::Local => None,
            KeepTransform::World => self.local_transform_under(node, parent)?,
        };
        // 3. Link the node to its new parent.
        let old_parent = self.nodes[node].parent;
        if old_parent != Some(parent) {
            self.unlink_child(node);
            self.link_child(node, parent);
            self.hierarchy.node_attached(node);
            self.record(node, Change::PARENT);
            old_parent.into_iter().chain([parent]).for_each(|parent| self.children_changed(parent));
        }
        // 4. Set its local transform.
        match local {
            None => Ok(()),
            Some(local) => self.set_unshared_transform(node, local),
        }
    }

    /// The local transform that preserves the world transform of `node` below `parent`; `None` if it is unchanged.
    fn local_transform_under(&self, node: NodeKey, parent: NodeKey) -> Result<Option<Transform>> {
        // Fail for nodes without a transform core, even where the transform would not change.
        self.local(node)?;
        // Equal parent matrices: the local transform stays, bit for bit.
        let old_parent_world = self.world_from_parent(node)?;
        let parent_world = self.world_from_local(parent)?;
        if parent_world == old_parent_world {
            return Ok(None);
        }
        // Solve parent * local = world, and check the product: a singular parent has no inverse.
        let world = self.world_from_local(node)?;
        let local = parent_world.inverse() * world;
        if preserves_world(&parent_world, &local, &world) {
            Ok(Some(Transform::Matrix(local)))
        } else {
            Err(Error::Singular { node, parent })
        }
    }

    /// The name; empty if it has none.
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn name(&self, node: NodeKey) -> Result<&str> {
        Ok(&self.node(node)?.name)
    }

    /// Sets the name of a node. Names need not be unique.
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn set_name(&mut self, node: NodeKey, name: impl Into<Box<str>>) -> Result<()> {
        let name = name.into();
        if *self.node(node)?.name != *name {
            self.save_prior_state(node);
            self.nodes[node].name = name;
            self.record(node, Change::NAME);
        }
        Ok(())
    }

    /// The node's own ray mask. A ray can hit geometry below the node only if its mask has a bit in common with the AND
    /// of the masks from the root to the geometry.
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn mask(&self, node: NodeKey) -> Result<u32> {
        Ok(self.node(node)?.mask)
    }

    /// Sets the node's own ray mask.
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn set_mask(&mut self, node: NodeKey, mask: u32) -> Result<()> {
        if self.node(node)?.mask != mask {
            self.save_prior_state(node);
            self.nodes[node].mask = mask;
            self.node_changed(node);
            self.record(node, Change::MASK);
        }
        Ok(())
    }

    /// The node's own visibility. A node is visible in the scene only if all nodes above it are visible too.
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn is_visible(&self, node: NodeKey) -> Result<bool> {
        Ok(self.node(node)?.visible)
    }

    /// Shows or hides a node with everything below it.
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn set_visible(&mut self, node: NodeKey, visible: bool) -> Result<()> {
        if self.node(node)?.visible != visible {
            self.save_prior_state(node);
            self.nodes[node].visible = visible;
            self.node_changed(node);
            self.record(node, Change::VISIBILITY);
        }
        Ok(())
    }

    /// Sets the local transform of this node only: if it shares its core, it gets a core of its own.
    fn set_unshared_transform(&mut self, node: NodeKey, local: Transform) -> Result<()> {
        let slot = &self.cores[self.nodes[node].core];
        if slot.user_count > 1 && slot.core != Core::Transform(local) {
            self.assign_core(node, Core::Transform(local))
        } else {
            self.set_local(node, local)
        }
    }

    /// Records that the children of `parent` changed.
    pub(super) fn children_changed(&mut self, parent: NodeKey) {
        if matches!(self.cores[self.nodes[parent].core].core, Core::Switch(_)) {
            self.hierarchy.switch_changed(parent);
        }
        self.record(parent, Change::CHILDREN);
    }

    /// The node without children that is reached from `node` by first children.
    fn first_leaf(&self, mut node: NodeKey) -> NodeKey {
        while let Some(child) = self.nodes[node].first_child {
            node = child;
        }
        node
    }

    /// Frees an unlinked node and its use of its core.
    fn release_node(&mut self, node: NodeKey) {
        self.save_prior_state(node);
        self.record(node, Change::REMOVED);
        // End its use of the core before the node goes: the list of users runs through the nodes.
        let core = self.nodes[node].core;
        self.unlink_user(node, core);
        self.nodes.remove(node);
        self.release_core_if_unused(core);
    }
}

/// Whether `parent * local` is `world` up to rounding: each axis relative to its own length, the translation relative
/// to its length.
fn preserves_world(parent: &DAffine3, local: &DAffine3, world: &DAffine3) -> bool {
    /// Well above f64 rounding, well below a visible error.
    const TOLERANCE: f64 = 1e-6;

    // Compare each axis of the product with the one wanted.
    let result = *parent * *local;
    let close = |a: DVec3, b: DVec3, extent: f64| (a - b).abs().max_element() <= TOLERANCE * extent;
    let preserves_axis = |i| {
        let axis = world.matrix3.col(i);
        close(result.matrix3.col(i), axis, axis.abs().max_element())
    };
    // The translation may cancel against the parent's: the larger of both sets the tolerance.
    let extent = world.translation.abs().max_element().max(parent.translation.abs().max_element());
    let finite = [local, world, &result].into_iter().all(DAffine3::is_finite);
    finite && (0..3).all(preserves_axis) && close(result.translation, world.translation, extent)
}
