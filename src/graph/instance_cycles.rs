//! Instance targets: which cores instance a node, and the check that no node instances itself or an ancestor.

use std::collections::HashSet;

use super::{Core, CoreKey, NodeKey, Scene};
use crate::{Error, Result};

impl Scene {
    /// Whether `above` is `node` or an ancestor of it, where the users of an instance core count as parents of its
    /// target. O(depth) without instances, O(ancestors through all instances) with some.
    pub(super) fn is_ancestor_or_self(&self, above: NodeKey, node: NodeKey) -> bool {
        // Without instances each node has one path to the root.
        if self.cores_by_target.is_empty() {
            return std::iter::successors(Some(node), |&node| self.nodes[node].parent).any(|node| node == above);
        }
        // Depth-first search up the ancestors, each visited once.
        let mut seen = HashSet::new();
        let mut stack = vec![node];
        while let Some(node) = stack.pop() {
            if node == above {
                return true;
            }
            if seen.insert(node) {
                stack.extend(self.nodes[node].parent);
                let cores = self.cores_by_target.get(&node).into_iter().flatten();
                stack.extend(cores.filter_map(|&core| self.users(core).ok()).flatten());
            }
        }
        false
    }

    /// Checks that giving `core` to `node` closes no cycle.
    pub(super) fn check_instance_cycle(&self, node: NodeKey, core: &Core) -> Result<()> {
        match *core {
            Core::Instance(target) if self.is_ancestor_or_self(target, node) => {
                Err(Error::Cycle { node: target, parent: node })
            }
            _ => Ok(()),
        }
    }

    /// Registers an instance core with its target.
    pub(super) fn register_instance(&mut self, key: CoreKey, core: &Core) {
        if let Core::Instance(target) = *core {
            self.cores_by_target.entry(target).or_default().insert(key);
        }
    }

    /// Removes an instance core from those of its target.
    pub(super) fn unregister_instance(&mut self, key: CoreKey, core: &Core) {
        let Core::Instance(target) = *core else { return };
        if let Some(cores) = self.cores_by_target.get_mut(&target) {
            cores.remove(&key);
            if cores.is_empty() {
                self.cores_by_target.remove(&target);
            }
        }
    }

    /// Replaces by [`Core::Group`] every core that instances `node`, which is about to be removed.
    pub(super) fn replace_instances_by_groups(&mut self, node: NodeKey) -> Result<()> {
        for core in self.cores_by_target.get(&node).cloned().unwrap_or_default() {
            self.set_core(core, Core::Group)?;
        }
        Ok(())
    }
}
