//! Which entries there are: planting subtrees, and leaving gaps where some were removed.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::ops::Range;

use slotmap::Key;

use super::{DAffine3, EntryProperties, Hierarchy, PendingUpdates, ResolvedEntry, SceneStores};
use crate::Result;
use crate::error::{Resource, require_within};
use crate::graph::node::Node;
use crate::graph::{Core, NodeKey};

/// What the scene reports. Nothing is done about most of it before [`update`](Hierarchy::update).
impl Hierarchy {
    /// The node is new, or has another parent. O(1).
    pub(in crate::graph) fn node_attached(&mut self, node: NodeKey) {
        if self.pending.is_built {
            self.pending.reattached.push(node);
            self.pending.is_built = self.pending.reattached.len() <= self.rebuild_threshold();
        }
    }

    /// The node is about to go, with all below it. O(entries below it).
    pub(in crate::graph) fn subtree_removed(&mut self, node: NodeKey) {
        if self.pending.is_built {
            let entries: Vec<usize> = self.entries(node).collect();
            for entry in entries {
                self.remove_subtree(entry);
            }
        }
    }

    /// The node's own transform, mask, visibility or material is another. O(its entries).
    pub(in crate::graph) fn node_changed(&mut self, key: NodeKey, node: &Node, core: &Core) {
        self.edit_properties(key, |own| own.read(node, core));
    }

    /// The node's own transform is another one. O(its entries).
    pub(in crate::graph) fn transform_changed(&mut self, key: NodeKey, local: &DAffine3) {
        self.edit_properties(key, |own| own.local = *local);
    }

    #[inline]
    fn edit_properties(&mut self, key: NodeKey, change: impl Fn(&mut EntryProperties)) {
        if !self.pending.is_built {
            return;
        }
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

    /// The node's core is or was a switch, or its children are others.
    pub(in crate::graph) fn switch_changed(&mut self, node: NodeKey) {
        if self.pending.is_built {
            self.pending.switches.insert(node);
        }
    }

    /// Shows all edits made so far.
    ///
    /// # Errors
    /// [`Error::Limit`] if instances of instances make more than [`MAX_INSTANCED`](Self::MAX_INSTANCED) entries.
    pub(in crate::graph) fn update(&mut self, tree: SceneStores<'_>) -> Result<()> {
        if self.is_up_to_date() {
            return Ok(());
        }
        let result = if self.pending.is_built && self.unordered_count() <= self.rebuild_threshold() {
            self.update_structure(tree)
        } else {
            self.rebuild(tree)
        };
        if result.is_err() {
            let generation = self.generation;
            *self = Self { generation, ..Self::default() };
            return result;
        }
        self.apply_switches(tree);
        self.propagate_dirty();
        Ok(())
    }

    /// Gaps, and entries in grafts.
    fn unordered_count(&self) -> usize {
        self.gaps.len() + self.appended_count
    }

    fn rebuild_threshold(&self) -> usize {
        1024 + self.nodes.len() / 4
    }
}

/// Catching up.
impl Hierarchy {
    fn rebuild(&mut self, tree: SceneStores<'_>) -> Result<()> {
        let boxes = self.subtree_bounds.take().map(|_| Default::default());
        *self = Self { generation: self.generation + 1, subtree_bounds: boxes, ..Self::default() };
        let capacity = tree.nodes.len();
        self.nodes.reserve(capacity);
        self.parents.reserve(capacity);
        self.subtree_ends.reserve(capacity);
        self.properties.reserve(capacity);
        self.first_entries.set_capacity(capacity);
        self.pending = PendingUpdates { is_built: true, ..PendingUpdates::default() };
        self.check_entry_limit(tree, tree.root)?;
        self.append_subtree(tree, tree.root, Self::NO_PARENT, false);
        Ok(())
    }

    fn update_structure(&mut self, tree: SceneStores<'_>) -> Result<()> {
        // 1. Those that have another parent leave the old one. Where they are instanced, they stay.
        let unplanted = std::mem::take(&mut self.pending.reattached);
        for &node in &unplanted {
            let real: Vec<usize> =
                self.entries(node).filter(|&entry| !self.properties[entry].is_instance_root).collect();
            for entry in real {
                self.remove_subtree(entry);
            }
        }

        // 2. They appear below every entry of their parent, with all below them. Below one that is planted later, or was
        //    planted here, they come with it.
        for node in unplanted {
            let Some(slot) = tree.nodes.get(node) else { continue };
            let Some(parent) = slot.parent else { continue };
            let standing = self.entries(node).filter(|&entry| !self.properties[entry].is_instance_root);
            let has_it: HashSet<usize> = standing.map(|entry| self.parents[entry] as usize).collect();
            let parents: Vec<usize> = self.entries(parent).filter(|parent| !has_it.contains(parent)).collect();
            for parent in parents {
                self.append_below(tree, node, parent, false)?;
            }
        }

        // 3. What is instanced stands below every entry of the node that instances it.
        for node in std::mem::take(&mut self.pending.instances) {
            if !tree.nodes.contains_key(node) {
                continue;
            }
            let target = tree.target(node);
            let entries: Vec<usize> = self.entries(node).collect();
            for entry in entries {
                // One may stand below another, and have gone with it.
                if self.is_removed(entry) {
                    continue;
                }
                let instanced = self.instance_root_below(entry);
                if instanced.map(|entry| self.nodes[entry]) == target {
                    continue;
                }
                if let Some(old) = instanced {
                    self.remove_subtree(old);
                }
                if let Some(target) = target {
                    self.append_below(tree, target, entry, true)?;
                }
            }
        }
        Ok(())
    }

    /// The entry that stands below `entry` because that one instances its node.
    fn instance_root_below(&self, entry: usize) -> Option<usize> {
        let is_it = |&below: &usize| {
            self.parents.get(below) == Some(&(entry as u32))
                && self.properties[below].is_instance_root
                && !self.nodes[below].is_null()
        };
        let grafts = self.appended_below(entry..entry + 1);
        std::iter::once(entry + 1).chain(grafts).find(is_it)
    }

    /// Plants a subtree at the end of the arrays, below an entry that may lie anywhere before it.
    fn append_below(&mut self, tree: SceneStores<'_>, node: NodeKey, parent: usize, instanced: bool) -> Result<()> {
        let start = self.nodes.len();
        self.check_entry_limit(tree, node)?;
        self.append_subtree(tree, node, parent as u32, instanced);
        self.appended_subtrees.entry(parent as u32).or_default().push(start as u32);
        self.appended_count += self.nodes.len() - start;
        Ok(())
    }

    /// Appends entries for a node and all below it in preorder: what a node instances comes before its children.
    fn append_subtree(&mut self, tree: SceneStores<'_>, top: NodeKey, parent: u32, instanced: bool) {
        let first = self.nodes.len() as u32;
        let (mut node, mut parent, mut instanced) = (top, parent, instanced);
        'down: loop {
            let entry = self.push(tree, node, parent, instanced);
            if let Some(target) = tree.target(node) {
                (node, parent, instanced) = (target, entry, true);
                continue;
            }
            if let Some(child) = tree.nodes[node].first_child {
                (node, parent, instanced) = (child, entry, false);
                continue;
            }
            // Go up to what comes next, closing the subtrees that end here.
            let mut closed = entry;
            loop {
                self.subtree_ends[closed as usize] = self.nodes.len() as u32;
                if closed == first {
                    self.pending.dirty.insert(first as usize);
                    return;
                }
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

    /// Checks, before anything is allocated, that a subtree has not too many entries.
    fn check_entry_limit(&self, tree: SceneStores<'_>, top: NodeKey) -> Result<()> {
        if !tree.has_instances {
            return Ok(());
        }
        let used = self.nodes.len() - self.gaps.len();
        let needed = tree.entry_count(top).saturating_add(used as u64);
        let limit = (tree.nodes.len() + Self::MAX_INSTANCED) as u64;
        require_within(Resource::HierarchyEntries, needed, limit)
    }

    fn push(&mut self, tree: SceneStores<'_>, key: NodeKey, parent: u32, instanced: bool) -> u32 {
        let entry = self.nodes.len() as u32;
        let node = &tree.nodes[key];
        let core = &tree.cores[node.core].core;
        let copy = instanced || self.properties.get(parent as usize).is_some_and(|own| own.is_in_instance);
        let mut own = EntryProperties { is_instance_root: instanced, is_in_instance: copy, ..EntryProperties::DEFAULT };
        own.read(node, core);
        if matches!(core, Core::Switch(_)) {
            self.pending.switches.insert(key);
        }
        self.nodes.push(key);
        self.parents.push(parent);
        self.subtree_ends.push(entry + 1);
        self.properties.push(own);
        self.placed.push(ResolvedEntry::ROOT_INHERITANCE);
        // Where a node itself stands comes first.
        let other = match self.first_entries.get(key).copied() {
            Some(_) if copy => Some(entry),
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

    /// Leaves gaps for an entry and all below it.
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
            let node = std::mem::take(&mut self.nodes[entry]);
            if !node.is_null() {
                self.unregister_entry(node, entry as u32);
                self.properties[entry].visible = false;
                self.placed[entry].visible = false;
                self.gaps.push(entry as u32);
                if let Some(boxes) = &mut self.subtree_bounds {
                    boxes.mark_entry(entry);
                }
            }
        }
    }

    fn unregister_entry(&mut self, node: NodeKey, entry: u32) {
        let more = self.instanced_entries.get_mut(&node);
        if self.first_entries.get(node) == Some(&entry) {
            match more.and_then(BTreeSet::pop_last) {
                Some(other) => drop(self.first_entries.insert(node, other)),
                None => drop(self.first_entries.remove(node)),
            }
        } else if let Some(more) = more {
            more.remove(&entry);
        }
        if self.instanced_entries.get(&node).is_some_and(BTreeSet::is_empty) {
            self.instanced_entries.remove(&node);
        }
    }

    /// Finds out which children are chosen wherever that may have changed. O(children of the switches).
    fn apply_switches(&mut self, tree: SceneStores<'_>) {
        for node in std::mem::take(&mut self.pending.switches) {
            let Some(slot) = tree.nodes.get(node) else { continue };
            let core = &tree.cores[slot.core].core;
            let (mut child, mut number) = (slot.first_child, 0);
            while let Some(key) = child {
                let chosen = if let Core::Switch(switch) = core { switch.shows(number) } else { true };
                let entries: Vec<usize> = self.entries(key).collect();
                for entry in entries {
                    let own = &mut self.properties[entry];
                    if !own.is_instance_root && own.selected != chosen {
                        own.selected = chosen;
                        self.pending.dirty.insert(entry);
                    }
                }
                (child, number) = (tree.nodes[key].next_sibling, number + 1);
            }
        }
    }
}

impl SceneStores<'_> {
    /// The node that this one instances, if that is still there.
    fn target(self, node: NodeKey) -> Option<NodeKey> {
        match *self.core(node) {
            Core::Instance(target) => Some(target).filter(|&target| self.nodes.contains_key(target)),
            _ => None,
        }
    }

    /// How many entries a node and all below it have. O(nodes that are shown there, each counted twice at most).
    fn entry_count(self, top: NodeKey) -> u64 {
        let mut counts: HashMap<NodeKey, u64> = HashMap::new();
        let mut open = vec![top];
        while let Some(&node) = open.last() {
            if counts.contains_key(&node) {
                open.pop();
                continue;
            }
            let (mut count, before) = (0u64, open.len());
            let mut next = Some(node);
            while let Some(below) = next {
                count = count.saturating_add(1);
                match self.target(below).map(|target| (target, counts.get(&target))) {
                    Some((_, Some(&more))) => count = count.saturating_add(more),
                    Some((target, None)) => open.push(target),
                    None => {}
                }
                next = self.after(node, below);
            }
            if open.len() == before {
                counts.insert(node, count);
                open.pop();
            }
        }
        counts[&top]
    }

    /// The node after `node` in preorder, by children, at or below `top`.
    fn after(self, top: NodeKey, mut node: NodeKey) -> Option<NodeKey> {
        if let Some(child) = self.nodes[node].first_child {
            return Some(child);
        }
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

    /// Takes over what node and core say.
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
