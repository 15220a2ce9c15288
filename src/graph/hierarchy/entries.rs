//! Adding and removing entries.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::ops::Range;

use slotmap::Key;

use super::{DAffine3, EntryProperties, Hierarchy, PendingUpdates, ResolvedEntry, SceneStores};
use crate::Result;
use crate::error::{Resource, require_within};
use crate::graph::node::Node;
use crate::graph::{Core, NodeKey};

/// Change notifications from the scene. Most are only recorded here and applied by [`update`](Hierarchy::update).
impl Hierarchy {
    /// The node was added, or has another parent. O(1).
    pub(in crate::graph) fn node_attached(&mut self, node: NodeKey) {
        if self.pending.is_built {
            self.pending.reattached.push(node);
            // After too many edits a rebuild is cheaper: stop recording until it is done.
            self.pending.is_built = self.pending.reattached.len() <= self.rebuild_threshold();
        }
    }

    /// The node and its subtree are about to be removed. O(entries removed).
    pub(in crate::graph) fn subtree_removed(&mut self, node: NodeKey) {
        if self.pending.is_built {
            // Copy the list first: removing an entry edits it.
            let entries: Vec<usize> = self.entries(node).collect();
            for entry in entries {
                self.remove_subtree(entry);
            }
        }
    }

    /// The node's own transform, mask, visibility or material group changed. O(its entries).
    pub(in crate::graph) fn node_changed(&mut self, key: NodeKey, node: &Node, core: &Core) {
        self.edit_properties(key, |own| own.read(node, core));
    }

    /// The node's own transform changed. O(its entries).
    pub(in crate::graph) fn transform_changed(&mut self, key: NodeKey, local: &DAffine3) {
        self.edit_properties(key, |own| own.local = *local);
    }

    #[inline]
    fn edit_properties(&mut self, key: NodeKey, change: impl Fn(&mut EntryProperties)) {
        if !self.pending.is_built {
            return;
        }
        // Edit the own values of every entry of the node; inherited values are recomputed at the next update.
        let more = self.instanced_entries.get(&key).into_iter().flatten();
        for &entry in self.first_entries.get(key).into_iter().chain(more) {
            change(&mut self.properties[entry as usize]);
            self.pending.dirty.insert(entry as usize);
        }
    }

    /// The node's core is or was an instance of another node.
    pub(in crate::graph) fn instance_changed(&mut self, node: NodeKey) {
        if self.pending.is_built {
            self.pending.instances.insert(node);
        }
    }

    /// The node's core is or was a switch, or its list of children changed.
    pub(in crate::graph) fn switch_changed(&mut self, node: NodeKey) {
        if self.pending.is_built {
            self.pending.switches.insert(node);
        }
    }

    /// Applies all recorded changes and recomputes inherited values.
    ///
    /// # Errors
    /// [`Error::Limit`] if instances of instances make more than [`MAX_INSTANCED`](Self::MAX_INSTANCED) entries.
    pub(in crate::graph) fn update(&mut self, tree: SceneStores<'_>) -> Result<()> {
        if self.is_up_to_date() {
            return Ok(());
        }
        // Patch the arrays, or rebuild them where too many entries were removed or appended.
        let result = if self.pending.is_built && self.unordered_count() <= self.rebuild_threshold() {
            self.update_structure(tree)
        } else {
            self.rebuild(tree)
        };
        // After an error the arrays may be half updated: drop them, so that the next update rebuilds.
        if result.is_err() {
            let generation = self.generation;
            *self = Self { generation, ..Self::default() };
            return result;
        }
        // Select the children of changed switches, then recompute inherited values below all dirty entries.
        self.apply_switches(tree);
        self.propagate_dirty();
        Ok(())
    }

    /// Number of removed entries and of entries in appended ranges.
    fn unordered_count(&self) -> usize {
        self.removed.len() + self.appended_count
    }

    /// Number of unordered entries, or of reattached nodes, beyond which a rebuild is cheaper than more updates.
    fn rebuild_threshold(&self) -> usize {
        1024 + self.nodes.len() / 4
    }
}

/// Applying the recorded changes.
impl Hierarchy {
    /// Builds all arrays in preorder.
    fn rebuild(&mut self, tree: SceneStores<'_>) -> Result<()> {
        // Start from empty arrays of a new generation; the bounds stay enabled if they were in use.
        let boxes = self.subtree_bounds.take().map(|_| Default::default());
        *self = Self { generation: self.generation + 1, subtree_bounds: boxes, ..Self::default() };
        // Reserve one entry per node; those in instances come on top.
        let capacity = tree.nodes.len();
        self.nodes.reserve(capacity);
        self.parents.reserve(capacity);
        self.subtree_ends.reserve(capacity);
        self.properties.reserve(capacity);
        self.first_entries.set_capacity(capacity);
        self.pending = PendingUpdates { is_built: true, ..PendingUpdates::default() };
        // Append all entries from the root down.
        self.check_entry_limit(tree, tree.root)?;
        self.append_subtree(tree, tree.root, Self::NO_PARENT, false);
        Ok(())
    }

    /// Removes and appends the entries that changed.
    fn update_structure(&mut self, tree: SceneStores<'_>) -> Result<()> {
        // 1. Remove the entries of reattached nodes below their old parents; entries that are instance roots stay.
        let reattached = std::mem::take(&mut self.pending.reattached);
        for &node in &reattached {
            let children: Vec<usize> =
                self.entries(node).filter(|&entry| !self.properties[entry].is_instance_root).collect();
            for entry in children {
                self.remove_subtree(entry);
            }
        }

        // 2. Append the subtree of each reattached node below every entry of its new parent that does not have it yet
        //    (an earlier append may have brought it along).
        for node in reattached {
            let Some(slot) = tree.nodes.get(node) else { continue };
            let Some(parent) = slot.parent else { continue };
            let children = self.entries(node).filter(|&entry| !self.properties[entry].is_instance_root);
            let has_it: HashSet<usize> = children.map(|entry| self.parents[entry] as usize).collect();
            let parents: Vec<usize> = self.entries(parent).filter(|parent| !has_it.contains(parent)).collect();
            for parent in parents {
                self.append_below(tree, node, parent, false)?;
            }
        }

        // 3. Append each instance target below every entry of the node that instances it, replacing an old target.
        for node in std::mem::take(&mut self.pending.instances) {
            if !tree.nodes.contains_key(node) {
                continue;
            }
            let target = tree.target(node);
            let entries: Vec<usize> = self.entries(node).collect();
            for entry in entries {
                // The entry may have been removed together with one above it.
                if self.is_removed(entry) {
                    continue;
                }
                let instance_root = self.instance_root_below(entry);
                if instance_root.map(|entry| self.nodes[entry]) == target {
                    continue;
                }
                if let Some(old) = instance_root {
                    self.remove_subtree(old);
                }
                if let Some(target) = target {
                    self.append_below(tree, target, entry, true)?;
                }
            }
        }
        Ok(())
    }

    /// The root of the instanced subtree below `entry`, if its core is or was an instance.
    fn instance_root_below(&self, entry: usize) -> Option<usize> {
        // It follows its parent directly, before the children, or was appended later.
        let is_instance_root = |&below: &usize| {
            self.parents.get(below) == Some(&(entry as u32))
                && self.properties[below].is_instance_root
                && !self.nodes[below].is_null()
        };
        let appended = self.appended_below(entry..entry + 1);
        std::iter::once(entry + 1).chain(appended).find(is_instance_root)
    }

    /// Appends the entries of a subtree at the end of the arrays, as children of an existing entry.
    fn append_below(&mut self, tree: SceneStores<'_>, node: NodeKey, parent: usize, instanced: bool) -> Result<()> {
        let start = self.nodes.len();
        self.check_entry_limit(tree, node)?;
        self.append_subtree(tree, node, parent as u32, instanced);
        // Register the range with its parent, outside whose own range it lies.
        self.appended_subtrees.entry(parent as u32).or_default().push(start as u32);
        self.appended_count += self.nodes.len() - start;
        Ok(())
    }

    /// Appends entries for a node and all below it in preorder; an instance target precedes the node's own children.
    fn append_subtree(&mut self, tree: SceneStores<'_>, top: NodeKey, parent: u32, instanced: bool) {
        let first = self.nodes.len() as u32;
        let (mut node, mut parent, mut instanced) = (top, parent, instanced);
        'down: loop {
            let entry = self.push(tree, node, parent, instanced);
            // Descend to the instance target, else to the first child.
            if let Some(target) = tree.target(node) {
                (node, parent, instanced) = (target, entry, true);
                continue;
            }
            if let Some(child) = tree.nodes[node].first_child {
                (node, parent, instanced) = (child, entry, false);
                continue;
            }
            // No child left: ascend to the next sibling, setting the subtree ends on the way.
            let mut closed = entry;
            loop {
                self.subtree_ends[closed as usize] = self.nodes.len() as u32;
                if closed == first {
                    self.pending.dirty.insert(first as usize);
                    return;
                }
                // An instance target is followed by its instance node's own children, any other entry by its next
                // sibling.
                let above = self.parents[closed as usize];
                let next = if self.properties[closed as usize].is_instance_root {
                    tree.nodes[self.nodes[above as usize]].first_child
                } else {
                    tree.nodes[self.nodes[closed as usize]].next_sibling
                };
                if let Some(next) = next {
                    (node, parent, instanced) = (next, above, false);
                    continue 'down;
                }
                closed = above;
            }
        }
    }

    /// Checks the entry limit before allocating: nested instances multiply.
    fn check_entry_limit(&self, tree: SceneStores<'_>, top: NodeKey) -> Result<()> {
        // Without instances there is one entry per node.
        if !tree.has_instances {
            return Ok(());
        }
        let used = self.nodes.len() - self.removed.len();
        let needed = tree.entry_count(top).saturating_add(used as u64);
        let limit = (tree.nodes.len() + Self::MAX_INSTANCED) as u64;
        require_within(Resource::HierarchyEntries, needed, limit)
    }

    /// Appends one entry, without its inherited values. Returns its index.
    fn push(&mut self, tree: SceneStores<'_>, key: NodeKey, parent: u32, instanced: bool) -> u32 {
        // 1. The entry's own values.
        let entry = self.nodes.len() as u32;
        let node = &tree.nodes[key];
        let core = &tree.cores[node.core].core;
        let is_in_instance = instanced || self.properties.get(parent as usize).is_some_and(|own| own.is_in_instance);
        let mut own = EntryProperties { is_instance_root: instanced, is_in_instance, ..EntryProperties::DEFAULT };
        own.read(node, core);
        if matches!(core, Core::Switch(_)) {
            self.pending.switches.insert(key);
        }
        // 2. Append it to the arrays.
        self.nodes.push(key);
        self.parents.push(parent);
        self.subtree_ends.push(entry + 1);
        self.properties.push(own);
        self.resolved.push(ResolvedEntry::ROOT_INHERITANCE);
        // 3. Register it with its node. A node's own entry takes precedence over its instanced ones.
        let other = match self.first_entries.get(key).copied() {
            Some(_) if is_in_instance => Some(entry),
            first => {
                self.first_entries.insert(key, entry);
                first
            }
        };
        if let Some(other) = other {
            self.instanced_entries.entry(key).or_default().insert(other);
        }
        entry
    }

    /// Marks an entry and all below it as removed.
    fn remove_subtree(&mut self, entry: usize) {
        if self.nodes[entry].is_null() {
            return;
        }
        for range in self.subtree(entry) {
            self.clear(range);
        }
    }

    fn clear(&mut self, range: Range<usize>) {
        for entry in range {
            // Null keys mark removed entries; the entry keeps its index.
            let node = std::mem::take(&mut self.nodes[entry]);
            if !node.is_null() {
                self.unregister_entry(node, entry as u32);
                self.properties[entry].visible = false;
                self.resolved[entry].visible = false;
                self.removed.push(entry as u32);
                if let Some(boxes) = &mut self.subtree_bounds {
                    boxes.mark_entry(entry);
                }
            }
        }
    }

    /// Removes an entry from those of its node.
    fn unregister_entry(&mut self, node: NodeKey, entry: u32) {
        // If it was the node's first entry, one of the others takes its place.
        let more = self.instanced_entries.get_mut(&node);
        if self.first_entries.get(node) == Some(&entry) {
            match more.and_then(BTreeSet::pop_last) {
                Some(other) => drop(self.first_entries.insert(node, other)),
                None => drop(self.first_entries.remove(node)),
            }
        } else if let Some(more) = more {
            more.remove(&entry);
        }
        // Keep no empty sets.
        if self.instanced_entries.get(&node).is_some_and(BTreeSet::is_empty) {
            self.instanced_entries.remove(&node);
        }
    }

    /// Re-evaluates the switches in `pending` and marks children whose selection changed. O(children of the switches).
    fn apply_switches(&mut self, tree: SceneStores<'_>) {
        for node in std::mem::take(&mut self.pending.switches) {
            let Some(slot) = tree.nodes.get(node) else { continue };
            let core = &tree.cores[slot.core].core;
            // Walk the children with their index; below any other core all of them are selected.
            let (mut child, mut child_index) = (slot.first_child, 0);
            while let Some(key) = child {
                let selected = if let Core::Switch(switch) = core { switch.shows(child_index) } else { true };
                let entries: Vec<usize> = self.entries(key).collect();
                for entry in entries {
                    // Where an instance shows the child, its entry is not below the switch.
                    let own = &mut self.properties[entry];
                    if !own.is_instance_root && own.selected != selected {
                        own.selected = selected;
                        self.pending.dirty.insert(entry);
                    }
                }
                (child, child_index) = (tree.nodes[key].next_sibling, child_index + 1);
            }
        }
    }
}

impl SceneStores<'_> {
    /// The target of the node, if its core is an instance and the target is in the scene.
    fn target(self, node: NodeKey) -> Option<NodeKey> {
        match *self.core(node) {
            Core::Instance(target) => Some(target).filter(|&target| self.nodes.contains_key(target)),
            _ => None,
        }
    }

    /// How many entries a node and all below it have. O(nodes reachable from `top`); memoised per instance target.
    fn entry_count(self, top: NodeKey) -> u64 {
        // Depth-first over `top` and the instance targets below it. A subtree is counted when the counts of all targets
        // in it are known; until then those without one are put on the stack above it.
        let mut counts: HashMap<NodeKey, u64> = HashMap::new();
        let mut stack = vec![top];
        while let Some(&node) = stack.last() {
            if counts.contains_key(&node) {
                stack.pop();
                continue;
            }
            // Count the nodes of this subtree, with the known counts of its targets.
            let (mut count, before) = (0u64, stack.len());
            let mut next = Some(node);
            while let Some(below) = next {
                count = count.saturating_add(1);
                match self.target(below).map(|target| (target, counts.get(&target))) {
                    Some((_, Some(&more))) => count = count.saturating_add(more),
                    Some((target, None)) => stack.push(target),
                    None => {}
                }
                next = self.after(node, below);
            }
            // No target was missing: the count is final.
            if stack.len() == before {
                counts.insert(node, count);
                stack.pop();
            }
        }
        counts[&top]
    }

    /// The next node in preorder, by children, at or below `top`.
    fn after(self, top: NodeKey, mut node: NodeKey) -> Option<NodeKey> {
        if let Some(child) = self.nodes[node].first_child {
            return Some(child);
        }
        // Ascend to the first node with a next sibling.
        while node != top {
            let slot = &self.nodes[node];
            if slot.next_sibling.is_some() {
                return slot.next_sibling;
            }
            node = slot.parent?;
        }
        None
    }
}

impl EntryProperties {
    const DEFAULT: Self = Self {
        local: DAffine3::IDENTITY,
        material: None,
        mask: u32::MAX,
        visible: true,
        has_transform: false,
        selected: true,
        is_instance_root: false,
        is_in_instance: false,
    };

    /// Loads the own values from node and core.
    fn read(&mut self, node: &Node, core: &Core) {
        (self.local, self.has_transform) = match core {
            Core::Transform(transform) => (transform.to_affine(), true),
            _ => (DAffine3::IDENTITY, false),
        };
        self.material = match *core {
            Core::MaterialGroup(material) => Some(material),
            _ => None,
        };
        (self.mask, self.visible) = (node.mask, node.visible);
    }
}
