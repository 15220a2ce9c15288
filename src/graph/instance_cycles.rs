//! Instances of nodes: who shows whom, and that nobody comes to show itself.

use std::collections::HashSet;

use super::{Core, CoreKey, NodeKey, Scene};
use crate::{Error, Result};

impl Scene {
    /// Whether `above` is the node, or something that the node is shown by: its parents, what instances them, and so on
    /// upwards. O(depth) without instances, O(all that is above) with some.
    pub(super) fn is_ancestor_or_self(&self, above: NodeKey, node: NodeKey) -> bool {
        if self.instancers.is_empty() {
            return std::iter::successors(Some(node), |&node| self.nodes[node].parent).any(|node| node == above);
        }
        let mut seen = HashSet::new();
        let mut open = vec![node];
        while let Some(node) = open.pop() {
            if node == above {
                return true;
            }
            if seen.insert(node) {
                open.extend(self.nodes[node].parent);
                let cores = self.instancers.get(&node).into_iter().flatten();
                open.extend(cores.filter_map(|&core| self.users(core).ok()).flatten());
            }
        }
        false
    }

    /// Checks that a node with this core would not show itself.
    pub(super) fn check_instance_cycle(&self, node: NodeKey, core: &Core) -> Result<()> {
        match *core {
            Core::Instance(target) if self.is_ancestor_or_self(target, node) => {
                Err(Error::Cycle { node: target, parent: node })
            }
            _ => Ok(()),
        }
    }

    /// Notes what the core instances.
    pub(super) fn register_instance(&mut self, key: CoreKey, core: &Core) {
        if let Core::Instance(target) = *core {
            self.instancers.entry(target).or_default().insert(key);
        }
    }

    /// Forgets what the core instanced.
    pub(super) fn unregister_instance(&mut self, key: CoreKey, core: &Core) {
        let Core::Instance(target) = *core else { return };
        if let Some(cores) = self.instancers.get_mut(&target) {
            cores.remove(&key);
            if cores.is_empty() {
                self.instancers.remove(&target);
            }
        }
    }

    /// Makes groups of the cores that instance a node, which is about to go.
    pub(super) fn replace_instances_by_groups(&mut self, node: NodeKey) -> Result<()> {
        for core in self.instancers.get(&node).cloned().unwrap_or_default() {
            self.set_core(core, Core::Group)?;
        }
        Ok(())
    }
}
