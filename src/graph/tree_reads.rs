//! Read access to the tree: parents, children, world transforms, bounds. All iterative.

use glam::DAffine3;

use super::{Core, CoreKey, NodeKey, Scene};
use crate::Result;
use crate::math::Bounds;

/// Reading the tree.
impl Scene {
    /// Whether the key is that of a node of this scene.
    pub fn contains(&self, node: NodeKey) -> bool {
        self.nodes.contains_key(node)
    }

    /// The parent; `None` for the root.
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn parent(&self, node: NodeKey) -> Result<Option<NodeKey>> {
        Ok(self.node(node)?.parent)
    }

    /// The children, in order.
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn children(&self, node: NodeKey) -> Result<Children<'_>> {
        Ok(Children { scene: self, next: self.node(node)?.first_child })
    }

    /// The parent, its parent, and so on up to the root.
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn ancestors(&self, node: NodeKey) -> Result<Ancestors<'_>> {
        Ok(Ancestors { scene: self, next: self.node(node)?.parent })
    }

    /// The node itself, then everything below it, in preorder: each node before its children, children in order.
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn subtree(&self, node: NodeKey) -> Result<Subtree<'_>> {
        self.node(node)?;
        Ok(Subtree { scene: self, top: node, next: Some(node) })
    }

    /// The nodes that have this core, in no particular order.
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn users(&self, core: CoreKey) -> Result<Users<'_>> {
        Ok(Users { scene: self, next: self.core_slot(core)?.first_user })
    }

    /// World matrix `world_from_local`: the product of the transforms from the root down to the node, its own included.
    /// O(depth), or O(1) while the [`hierarchy`](Self::hierarchy) is up to date; the result is the same, bit for bit.
    /// Not finite if the product overflows f64.
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey).
    pub fn world_from_local(&self, node: NodeKey) -> Result<DAffine3> {
        let core = self.node_core(node)?;
        // Read the matrix from the hierarchy if that is up to date.
        if self.hierarchy.is_up_to_date()
            && let Some(entry) = self.hierarchy.entry(node)
        {
            return Ok(self.hierarchy.resolved()[entry].world_from_local);
        }
        // Else multiply from the root down, in the hierarchy's order, so that both results agree bit for bit.
        let ancestors = self.ancestors(node)?.map(|ancestor| &self.cores[self.nodes[ancestor].core].core);
        let locals: Vec<_> = std::iter::once(core).chain(ancestors).filter_map(local_affine).collect();
        Ok(locals.into_iter().rev().fold(DAffine3::IDENTITY, |world, local| world * local))
    }

    /// The world-space box around all geometry at and below the node, including hidden geometry and instances. Empty if
    /// there is no geometry. O(entries changed since the last such call + log n), O(nodes) the first time.
    ///
    /// Conservative: rotated geometry is bounded by the box of its rotated local box. For the tight box around what is
    /// visible, at a higher cost, see [`visible_bounds`](Self::visible_bounds).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey); as [`hierarchy`](Self::hierarchy).
    pub fn world_bounds(&mut self, node: NodeKey) -> Result<Bounds> {
        self.node(node)?;
        let (hierarchy, tree) = self.hierarchy_and_stores();
        hierarchy.update(tree)?;
        let entry = hierarchy.entry(node);
        Ok(entry.map_or(Bounds::EMPTY, |entry| hierarchy.world_bounds(tree, entry)))
    }

    /// World matrix of the parent; the identity for the root.
    pub(super) fn world_from_parent(&self, node: NodeKey) -> Result<DAffine3> {
        self.parent(node)?.map_or(Ok(DAffine3::IDENTITY), |parent| self.world_from_local(parent))
    }
}

fn local_affine(core: &Core) -> Option<DAffine3> {
    match core {
        Core::Transform(transform) => Some(transform.to_affine()),
        _ => None,
    }
}

/// Iterates over the children of a node; see [`Scene::children`].
#[derive(Clone, Debug)]
pub struct Children<'a> {
    scene: &'a Scene,
    next: Option<NodeKey>,
}

impl Iterator for Children<'_> {
    type Item = NodeKey;

    fn next(&mut self) -> Option<NodeKey> {
        let node = self.next?;
        self.next = self.scene.nodes[node].next_sibling;
        Some(node)
    }
}

/// Iterates over the nodes above a node; see [`Scene::ancestors`].
#[derive(Clone, Debug)]
pub struct Ancestors<'a> {
    scene: &'a Scene,
    next: Option<NodeKey>,
}

impl Iterator for Ancestors<'_> {
    type Item = NodeKey;

    fn next(&mut self) -> Option<NodeKey> {
        let node = self.next?;
        self.next = self.scene.nodes[node].parent;
        Some(node)
    }
}

/// Iterates over the nodes that have a core; see [`Scene::users`].
#[derive(Clone, Debug)]
pub struct Users<'a> {
    scene: &'a Scene,
    next: Option<NodeKey>,
}

impl Iterator for Users<'_> {
    type Item = NodeKey;

    fn next(&mut self) -> Option<NodeKey> {
        let node = self.next?;
        self.next = self.scene.nodes[node].next_user;
        Some(node)
    }
}

/// Iterates over a subtree; see [`Scene::subtree`].
#[derive(Clone, Debug)]
pub struct Subtree<'a> {
    scene: &'a Scene,
    top: NodeKey,
    next: Option<NodeKey>,
}

impl Subtree<'_> {
    /// The next node in preorder that is not below `node`.
    fn after(&self, mut node: NodeKey) -> Option<NodeKey> {
        while node != self.top {
            let slot = &self.scene.nodes[node];
            if slot.next_sibling.is_some() {
                return slot.next_sibling;
            }
            node = slot.parent?;
        }
        None
    }
}

impl Iterator for Subtree<'_> {
    type Item = NodeKey;

    fn next(&mut self) -> Option<NodeKey> {
        let node = self.next?;
        self.next = self.scene.nodes[node].first_child.or_else(|| self.after(node));
        Some(node)
    }
}
