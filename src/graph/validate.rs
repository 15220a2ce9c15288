//! Validation of the scene's invariants.

use slotmap::Key;

use super::assets::UseCounted;
use super::node::Node;
use super::store::Store;
use super::value_checks::{check_core, check_material, check_texture};
use super::{Core, NodeKey, ObjectKey, Scene};
use crate::error::require_invariant;
use crate::{Error, Result};

impl Scene {
    /// Checks every internal invariant: links, user counts, values, the change log, and the flattened hierarchy if it
    /// is up to date. O(scene). For tests; no sequence of calls should make it fail.
    ///
    /// # Errors
    /// [`Error::Defect`] with the first object that is wrong; the error of the setter for a value that is not allowed.
    pub fn validate(&self) -> Result<()> {
        self.validate_tree()?;
        self.validate_cores()?;
        self.validate_assets()?;
        self.log.validate(self.root)?;
        if self.hierarchy.is_up_to_date() { self.hierarchy.validate(self.stores()) } else { Ok(()) }
    }

    /// Checks that every link has its counterpart, and that the links lead to every node once.
    fn validate_tree(&self) -> Result<()> {
        for (key, node) in self.nodes.iter() {
            // The root alone has no parent, and no link is stale.
            require_invariant(node.parent.is_none() == (key == self.root), key, "only the root has no parent")?;
            let links = [node.parent, node.first_child, node.last_child, node.previous_sibling, node.next_sibling];
            require_invariant(
                links.iter().flatten().all(|&link| self.contains(link)),
                key,
                "one of its links is a stale key",
            )?;

            // Each child and sibling links back.
            let family = |link: Option<NodeKey>| link.map(|link| &self.nodes[link]);
            let first_fits = family(node.first_child)
                .is_none_or(|child| child.parent == Some(key) && child.previous_sibling.is_none());
            let last_fits =
                family(node.last_child).is_none_or(|child| child.parent == Some(key) && child.next_sibling.is_none());
            let next_fits = family(node.next_sibling)
                .is_none_or(|next| next.parent == node.parent && next.previous_sibling == Some(key));
            let ends_fit = node.first_child.is_some() == node.last_child.is_some();
            require_invariant(first_fits && last_fits && ends_fit, key, "its children are not linked to it")?;
            require_invariant(next_fits, key, "its next sibling is not linked to it")?;
        }
        // Count the nodes reached from the root; `take` ends the walk where links form a cycle.
        let reached = self.subtree(self.root)?.take(self.nodes.len() + 1).count();
        require_invariant(reached == self.nodes.len(), self.root, "some nodes are not below it, or are below it twice")
    }

    /// Checks that the users of each core are the nodes that have it, and that no core instances a node above it.
    fn validate_cores(&self) -> Result<()> {
        require_invariant(*self.node_core(self.root)? == Core::Group, self.root, "the root is not a group")?;
        let is_user = |node: &Node, previous, core| node.core == core && node.previous_user == previous;
        let mut user_count = 0;
        for (key, slot) in self.cores.iter() {
            // Walk the users, each of which must have this core and link back; a cycle exceeds the count.
            let (mut previous, mut next, mut found) = (None, slot.first_user, 0);
            while let Some(user) = next {
                let node = self.node(user)?;
                require_invariant(is_user(node, previous, key), user, "it is not linked to the users of its core")?;
                (previous, next, found) = (next, node.next_user, found + 1);
                require_invariant(found <= slot.user_count, key, "it has more users than it counts")?;
            }
            require_invariant(found == slot.user_count, key, "it has fewer users than it counts")?;
            user_count += found;
            check_core(&slot.core)?;
            // An instance is registered with its target, and shows no node above its users.
            if let Core::Instance(target) = slot.core {
                self.node(target)?;
                let known = self.cores_by_target.get(&target).is_some_and(|cores| cores.contains(&key));
                require_invariant(known, key, "it is not registered with the target that it instances")?;
                let shows_itself = self.users(key)?.any(|user| self.is_ancestor_or_self(target, user));
                require_invariant(!shows_itself, key, "it instances itself or an ancestor")?;
            }
        }
        require_invariant(user_count == self.nodes.len(), self.root, "some nodes are not users of their cores")
    }

    /// Checks that every count is the number of references, and that every value is allowed.
    fn validate_assets(&self) -> Result<()> {
        // User counts equal the references from cores and materials.
        let cores = || self.cores.values().map(|slot| &slot.core);
        validate_counts(&self.geometries, cores().filter_map(Core::geometry))?;
        validate_counts(&self.materials, cores().filter_map(Core::material))?;
        let materials = self.materials.values().map(|used| &used.value);
        validate_counts(&self.textures, materials.clone().flat_map(|m| m.textures().map(|t| t.texture)))?;

        // Every stored value passes the check of its setter.
        self.geometries.values().try_for_each(|used| used.value.geometry.validate())?;
        self.textures.values().try_for_each(|used| check_texture(&used.value))?;
        materials.into_iter().try_for_each(check_material)
    }
}

/// Checks that each asset's count is the number of references to it.
fn validate_counts<K: Key + Into<ObjectKey>, V>(
    assets: &Store<K, UseCounted<V>>,
    references: impl Iterator<Item = K>,
) -> Result<()> {
    // Count the references to each asset, then compare.
    let mut counts: slotmap::SecondaryMap<K, usize> = assets.keys().map(|key| (key, 0)).collect();
    for key in references {
        let count = counts.get_mut(key);
        *count.ok_or(Error::Defect { object: key.into(), what: "it is referenced, but not in the scene" })? += 1;
    }
    for (key, used) in assets.iter() {
        require_invariant(counts[key] == used.user_count, key, "its user count is not the number of references to it")?;
    }
    Ok(())
}
