//! Validation of a delta against a scene, before any change is made.

use std::collections::{BTreeSet, HashMap, HashSet};

use super::delta::Delta;
use super::{NodeState, ObjectState};
use crate::error::{DeltaFault, Resource, RootEdit, require_within};
use crate::graph::value_checks::{check_core, check_material, check_texture};
use crate::graph::{Core, CoreKey, NodeKey, ObjectKey, Scene};
use crate::{Error, Result};

/// Limit on unused slots that partial deltas may create. A legitimate sender can skip slots (objects created and freed
/// between two reads); a corrupt key must not cause an unbounded allocation.
const MAX_SKIPPED_SLOTS: usize = 1 << 20;

/// Checks everything that must hold in the scene after the delta. Returns the nodes of the delta, each after its
/// previous sibling.
pub(super) fn check(scene: &Scene, delta: &Delta) -> Result<Vec<NodeKey>> {
    // Check each object by itself, against the scene as it will be.
    let after = SceneAfter { scene, delta };
    check_order(scene, delta)?;
    for (object, state) in delta.objects() {
        match state {
            Some(state) => after.check_state(object, state)?,
            None => after.check_removal(object)?,
        }
    }
    // Then what concerns several of them: references, sibling order, cycles.
    after.check_root()?;
    after.check_references()?;
    after.check_siblings()?;
    after.check_cycles()?;
    match order_of_siblings(delta) {
        (order, None) => Ok(order),
        (_, Some(node)) => Err(mismatch(node, DeltaFault::SiblingCycle)),
    }
}

/// Checks that no object occurs twice, and that no two objects claim the same slot.
fn check_order(scene: &Scene, delta: &Delta) -> Result<()> {
    if let Some(pair) = delta.objects.windows(2).find(|pair| pair[0].0 >= pair[1].0) {
        return Err(mismatch(pair[1].0, DeltaFault::DuplicateObject));
    }
    // Keys of one kind are ordered by slot, so that generations of one slot are adjacent.
    let present = delta.objects.iter().filter(|(_, state)| state.is_some());
    let slots = present.map(|&(object, _)| (object, std::mem::discriminant(&object), scene.slot_occupancy(object).0));
    let mut last = None;
    for (object, kind, slot) in slots {
        if last.replace((kind, slot)) == Some((kind, slot)) {
            return Err(mismatch(object, DeltaFault::SharedSlot));
        }
    }
    Ok(())
}

/// The nodes of a delta, each after its previous sibling if that is in the delta too; and a node on a cycle of
/// previous-sibling links, if any. O(nodes).
pub(super) fn order_of_siblings(delta: &Delta) -> (Vec<NodeKey>, Option<NodeKey>) {
    let (mut order, mut circular) = (Vec::new(), None);
    let mut seen = HashSet::new();
    let mut chain = Vec::new();
    for (object, state) in delta.objects() {
        // Follow the previous siblings up to one that is in order already or not in the delta; append the chain in
        // reverse.
        let mut next = Some((object, state));
        while let Some((ObjectKey::Node(node), Some(ObjectState::Node(state)))) = next {
            if !seen.insert(node) {
                // In order already, unless it is in this chain: then the chain is a cycle.
                circular = circular.or_else(|| chain.contains(&node).then_some(node));
                break;
            }
            chain.push(node);
            let previous = state.previous_sibling.map(ObjectKey::from);
            next = previous.and_then(|previous| Some((previous, delta.get(previous)?.as_ref())));
        }
        order.extend(chain.drain(..).rev());
    }
    (order, circular)
}

/// Read-only view of a scene with a delta applied.
struct SceneAfter<'a> {
    scene: &'a Scene,
    delta: &'a Delta,
}

impl SceneAfter<'_> {
    fn has(&self, object: ObjectKey) -> bool {
        self.delta.get(object).map_or_else(|| self.scene.contains_object(object), Option::is_some)
    }

    fn require_object(&self, object: ObjectKey) -> Result<()> {
        if self.has(object) { Ok(()) } else { Err(Error::StaleKey { object }) }
    }

    fn parent(&self, node: NodeKey) -> Option<NodeKey> {
        match self.delta.get(node.into()) {
            Some(Some(ObjectState::Node(state))) => state.parent,
            Some(_) => None,
            None => self.scene.nodes.get(node)?.parent,
        }
    }

    fn core(&self, core: CoreKey) -> Option<&Core> {
        match self.delta.get(core.into()) {
            Some(Some(ObjectState::Core(core))) => Some(core),
            Some(_) => None,
            None => self.scene.core(core).ok(),
        }
    }

    fn check_state(&self, object: ObjectKey, state: &ObjectState) -> Result<()> {
        // The state fits the key, the key can be used, and everything that it refers to exists.
        if !state.matches_kind(object) {
            return Err(mismatch(object, DeltaFault::KindMismatch));
        }
        if !self.scene.contains_object(object) {
            self.check_key(object)?;
        }
        state.references().into_iter().try_for_each(|used| self.require_object(used))?;
        // Check the values; a geometry that the scene has already was validated before.
        match state {
            ObjectState::Node(node) => self.check_node(object, node),
            ObjectState::Core(core) => check_core(core),
            ObjectState::Geometry(geometry) => match object {
                ObjectKey::Geometry(key)
                    if self.scene.geometry(key).is_ok_and(|old| old.has_equal_content(geometry)) =>
                {
                    Ok(())
                }
                _ => geometry.validate(),
            },
            ObjectState::Material(material) => check_material(material),
            ObjectState::Texture(texture) => check_texture(texture),
        }
    }

    /// Checks that a new object's key can be used: its slot is free and within the limit.
    fn check_key(&self, object: ObjectKey) -> Result<()> {
        let (slot, occupant, slot_count) = self.scene.slot_occupancy(object);
        // Slot 0 is never used.
        if slot == 0 || slot >= u32::MAX as usize {
            return Err(mismatch(object, DeltaFault::InvalidKey));
        }
        // The slot is vacant, or this delta vacates it.
        if occupant.is_some_and(|occupant| self.has(occupant)) {
            return Err(mismatch(object, DeltaFault::SlotTaken));
        }
        // The slot is one that the scene has or the snapshot's scene had, or at most a fixed number beyond the live
        // objects.
        let issued = self.delta.snapshot_generations.as_ref().map_or(0, |generations| match object {
            ObjectKey::Node(_) => generations.nodes.len(),
            ObjectKey::Core(_) => generations.cores.len(),
            ObjectKey::Geometry(_) => generations.geometries.len(),
            ObjectKey::Material(_) => generations.materials.len(),
            ObjectKey::Texture(_) => generations.textures.len(),
        });
        let live = match object {
            ObjectKey::Node(_) => self.scene.node_count(),
            ObjectKey::Core(_) => self.scene.core_count(),
            ObjectKey::Geometry(_) => self.scene.geometry_count(),
            ObjectKey::Material(_) => self.scene.material_count(),
            ObjectKey::Texture(_) => self.scene.texture_count(),
        };
        let skippable = if self.delta.is_snapshot() { 0 } else { MAX_SKIPPED_SLOTS };
        let limit = slot_count.max(issued).max(live + skippable);
        require_within(Resource::KeySlots, slot as u64 + 1, limit as u64)
    }

    fn check_node(&self, object: ObjectKey, node: &NodeState) -> Result<()> {
        let is_root = object == self.scene.root.into();
        match (node.parent, node.previous_sibling) {
            (None, None) if is_root => Ok(()),
            (_, _) if is_root => Err(Error::Root { attempt: RootEdit::Move }),
            (None, _) => Err(mismatch(object, DeltaFault::NoParent)),
            // Parent and previous sibling exist, and the sibling has the same parent.
            (Some(parent), previous) => {
                self.require_object(parent.into())?;
                let Some(previous) = previous else { return Ok(()) };
                self.require_object(previous.into())?;
                if self.parent(previous) == Some(parent) {
                    Ok(())
                } else {
                    Err(mismatch(object, DeltaFault::SiblingElsewhere))
                }
            }
        }
    }

    /// Checks that a removed node keeps no child. (New children are covered by [`check_node`](Self::check_node): their
    /// parent must exist.)
    fn check_removal(&self, object: ObjectKey) -> Result<()> {
        let ObjectKey::Node(node) = object else { return Ok(()) };
        if node == self.scene.root {
            return Err(Error::Root { attempt: RootEdit::Remove });
        }
        // A child stays if the delta does not name it.
        let mut children = self.scene.children(node).into_iter().flatten();
        match children.find(|&child| self.delta.get(child.into()).is_none()) {
            Some(child) => Err(mismatch(child, DeltaFault::ChildStays)),
            None => Ok(()),
        }
    }

    fn check_root(&self) -> Result<()> {
        let core = match self.delta.get(self.scene.root.into()) {
            Some(Some(ObjectState::Node(root))) => root.core,
            _ => self.scene.nodes[self.scene.root].core,
        };
        match self.core(core) {
            Some(Core::Group) => Ok(()),
            Some(other) => Err(Error::Root { attempt: RootEdit::SetCore(other.kind()) }),
            None => Err(mismatch(core, DeltaFault::StillUsed)),
        }
    }

    /// Checks that every removed object is no longer referenced.
    fn check_references(&self) -> Result<()> {
        if self.delta.objects.iter().all(|(_, state)| state.is_some()) {
            return Ok(());
        }
        // 1. Count the references to removed objects by the old states of the delta's objects. None of the new states
        //    has any: that was checked.
        let mut ended_uses: HashMap<ObjectKey, usize> = HashMap::new();
        for old in self.delta.objects.iter().filter_map(|&(object, _)| self.scene.state(object)) {
            for used in old.references().into_iter().filter(|&used| matches!(self.delta.get(used), Some(None))) {
                *ended_uses.entry(used).or_default() += 1;
            }
        }
        // 2. An object with more users than that is still referenced.
        for (object, _) in
            self.delta.objects().filter(|(object, state)| state.is_none() && self.scene.contains_object(*object))
        {
            let user_count = match object {
                ObjectKey::Node(key) => self.scene.cores_by_target.get(&key).map_or(0, BTreeSet::len),
                ObjectKey::Core(key) => self.scene.cores[key].user_count,
                ObjectKey::Geometry(key) => self.scene.geometries[key].user_count,
                ObjectKey::Material(key) => self.scene.materials[key].user_count,
                ObjectKey::Texture(key) => self.scene.textures[key].user_count,
            };
            if user_count != ended_uses.get(&object).copied().unwrap_or(0) {
                return Err(mismatch(object, DeltaFault::StillUsed));
            }
        }
        Ok(())
    }

    /// Checks that no two nodes have the same previous sibling.
    fn check_siblings(&self) -> Result<()> {
        let mut positions = HashSet::new();
        for (object, state) in self.delta.objects() {
            if let Some(ObjectState::Node(node)) = state
                && !positions.insert((node.parent, node.previous_sibling))
            {
                return Err(mismatch(object, DeltaFault::SiblingTwice));
            }
        }
        Ok(())
    }

    /// Checks that no node is below itself, through parents or through instances. O(ancestors of the nodes with new
    /// links), and O(instances) if there are any.
    fn check_cycles(&self) -> Result<()> {
        enum Visit {
            Enter(NodeKey),
            Leave(NodeKey),
        }
        let starts = self.nodes_with_new_links();
        let instancing = if starts.is_empty() { HashMap::new() } else { self.instancing_nodes() };
        // Depth-first search up the ancestors: the path holds the nodes entered and not left yet, each a parent of the
        // one before it, so that a node that is entered again closes a cycle.
        let (mut done, mut on_path, mut path) = (HashSet::new(), HashSet::new(), Vec::new());
        for start in starts {
            let mut stack = vec![Visit::Enter(start)];
            while let Some(visit) = stack.pop() {
                match visit {
                    Visit::Leave(node) => {
                        path.pop();
                        on_path.remove(&node);
                        done.insert(node);
                    }
                    Visit::Enter(node) if done.contains(&node) => {}
                    Visit::Enter(node) if !on_path.insert(node) => return Err(self.cycle_error(&path, node)),
                    Visit::Enter(node) => {
                        path.push(node);
                        stack.push(Visit::Leave(node));
                        let instances = instancing.get(&node).into_iter().flatten().copied();
                        stack.extend(self.parent(node).into_iter().chain(instances).map(Visit::Enter));
                    }
                }
            }
        }
        Ok(())
    }

    /// The error of the cycle that `path` closes at `first`, one of its nodes: it names a link that the delta adds,
    /// which each cycle has.
    fn cycle_error(&self, path: &[NodeKey], first: NodeKey) -> Error {
        // List the links of the cycle, each node with its parent, those that are new first.
        let cycle = path.iter().copied().skip_while(|&node| node != first);
        let mut links: Vec<(NodeKey, NodeKey)> = cycle.clone().zip(cycle.skip(1).chain([first])).collect();
        links.sort_by_key(|&(node, parent)| self.has_old_link(node, parent));
        let (node, parent) = links.first().copied().unwrap_or((first, first));
        Error::Cycle { node, parent }
    }

    /// Whether the scene before the delta has this link, by parent or by instance.
    fn has_old_link(&self, node: NodeKey, parent: NodeKey) -> bool {
        self.scene.nodes.get(node).is_some_and(|old| old.parent == Some(parent))
            || self.scene.node_core(parent).is_ok_and(|core| core.instance_target() == Some(node))
    }

    /// The child ends of all new parent and instance links: every new cycle contains one of them.
    fn nodes_with_new_links(&self) -> Vec<NodeKey> {
        let mut children = Vec::new();
        for (object, state) in self.delta.objects() {
            match (object, state) {
                (ObjectKey::Node(key), Some(ObjectState::Node(state))) => {
                    // The link to the parent is new, or that from its core to the node that it instances.
                    let old = self.scene.nodes.get(key);
                    if old.is_none_or(|old| old.parent != state.parent) {
                        children.push(key);
                    }
                    if old.is_none_or(|old| old.core != state.core) {
                        children.extend(self.core(state.core).and_then(Core::instance_target));
                    }
                }
                (_, Some(ObjectState::Core(core))) => children.extend(core.instance_target()),
                _ => {}
            }
        }
        children
    }

    /// By instance target: the nodes whose cores instance it.
    fn instancing_nodes(&self) -> HashMap<NodeKey, Vec<NodeKey>> {
        // 1. The targets of all instance cores after the delta.
        let old = self.scene.cores_by_target.values().flatten().copied();
        let new = self.delta.objects().filter_map(|(object, _)| match object {
            ObjectKey::Core(key) => Some(key),
            _ => None,
        });
        let cores = old.chain(new);
        let targets: HashMap<CoreKey, NodeKey> =
            cores.filter_map(|key| Some((key, self.core(key)?.instance_target()?))).collect();

        // 2. The users of these cores after the delta: old users that the delta does not name, and its own nodes.
        let is_unchanged = |user: &NodeKey| self.delta.get((*user).into()).is_none();
        let old = targets.keys().flat_map(|&key| {
            let users = self.scene.users(key).into_iter().flatten();
            users.filter(is_unchanged).map(move |user| (user, key))
        });
        let new = self.delta.objects().filter_map(|(object, state)| match (object, state) {
            (ObjectKey::Node(key), Some(ObjectState::Node(state))) => Some((key, state.core)),
            _ => None,
        });
        let mut instancing: HashMap<NodeKey, Vec<NodeKey>> = HashMap::new();
        for (user, core) in old.chain(new) {
            if let Some(&target) = targets.get(&core) {
                instancing.entry(target).or_default().push(user);
            }
        }
        instancing
    }
}

fn mismatch(object: impl Into<ObjectKey>, cause: DeltaFault) -> Error {
    Error::Delta { object: object.into(), cause }
}
