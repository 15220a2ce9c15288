//! Writes the states of a validated delta into the scene.

use super::delta::Delta;
use super::{NodeState, ObjectState};
use crate::graph::assets::{StoredGeometry, UseCounted};
use crate::graph::changes::Change;
use crate::graph::core::CoreSlot;
use crate::graph::core_edits::HierarchyEffects;
use crate::graph::node::Node;
use crate::graph::{Core, CoreKey, Geometry, GeometryKey, Material, MaterialKey, NodeKey, ObjectKey};
use crate::graph::{Scene, Texture, TextureKey};

impl Scene {
    /// Gives the objects of a validated delta their target states. `order` are its nodes, each after its previous
    /// sibling.
    pub(super) fn write_states(&mut self, delta: &Delta, order: &[NodeKey]) {
        // Suspend automatic freeing: the delta lists every removal.
        self.defers_release = true;
        // 1. Release references that change, so that no removed object is still referenced.
        for (object, state) in delta.objects() {
            self.release_references(object, state);
        }
        // 2. Remove objects, so that their slots are vacant.
        self.remove_from_hierarchy(delta);
        for (object, _) in delta.objects().filter(|(_, state)| state.is_none()) {
            self.remove_object(object);
        }
        // 3. Add and change objects, each before those that refer to it.
        for (object, state) in delta.objects.iter().rev() {
            match (*object, state) {
                (ObjectKey::Texture(key), Some(ObjectState::Texture(texture))) => self.put_texture(key, texture),
                (ObjectKey::Material(key), Some(ObjectState::Material(material))) => self.put_material(key, material),
                (ObjectKey::Geometry(key), Some(ObjectState::Geometry(geometry))) => self.put_geometry(key, geometry),
                (ObjectKey::Core(key), Some(ObjectState::Core(core))) => self.put_core(key, core),
                (ObjectKey::Node(key), Some(ObjectState::Node(node))) => self.write_node(key, node),
                _ => {}
            }
        }
        // 4. Link nodes to their parents and siblings, which all exist now.
        for &node in order {
            if let Some(Some(ObjectState::Node(state))) = delta.get(node.into()) {
                self.link_node(node, state);
            }
        }
        self.defers_release = false;
    }

    /// Ends the uses of those objects that the target state does not refer to.
    fn release_references(&mut self, object: ObjectKey, state: Option<&ObjectState>) {
        match (object, state) {
            (ObjectKey::Node(key), state) if self.nodes.contains_key(key) => {
                let core = self.nodes[key].core;
                if !matches!(state, Some(ObjectState::Node(new)) if new.core == core) {
                    self.save_prior_state(key);
                    self.unlink_user(key, core);
                }
            }
            (ObjectKey::Core(key), state) if self.cores.contains_key(key) => {
                let core = &self.cores[key].core;
                if !matches!(state, Some(ObjectState::Core(new)) if new == core) {
                    let core = core.clone();
                    self.save_prior_state(key);
                    self.release_assets(key, &core);
                }
            }
            (ObjectKey::Material(key), state) if self.materials.contains_key(key) => {
                let material = &self.materials[key].value;
                if !matches!(state, Some(ObjectState::Material(new)) if **new == *material) {
                    let material = material.clone();
                    self.save_prior_state(key);
                    self.release_textures(&material);
                }
            }
            _ => {}
        }
    }

    /// Reports each topmost removed node to the hierarchy; its subtree follows.
    fn remove_from_hierarchy(&mut self, delta: &Delta) {
        let is_removed = |node: NodeKey| matches!(delta.get(node.into()), Some(None));
        for (object, _) in delta.objects() {
            if let ObjectKey::Node(key) = object
                && is_removed(key)
                && self.nodes.get(key).is_some_and(|node| node.parent.is_some_and(|parent| !is_removed(parent)))
            {
                self.hierarchy.subtree_removed(key);
            }
        }
    }

    fn remove_object(&mut self, object: ObjectKey) {
        if !self.contains_object(object) {
            return;
        }
        self.save_prior_state(object);
        match object {
            ObjectKey::Node(key) => {
                // Children are removed too or get other parents.
                while let Some(child) = self.nodes[key].first_child {
                    self.unlink_child(child);
                }
                let parent = self.nodes[key].parent;
                self.unlink_child(key);
                self.nodes.remove(key);
                parent.into_iter().for_each(|parent| self.children_changed(parent));
            }
            ObjectKey::Core(key) => drop(self.cores.remove(key)),
            ObjectKey::Geometry(key) => drop(self.geometries.remove(key)),
            ObjectKey::Material(key) => drop(self.materials.remove(key)),
            ObjectKey::Texture(key) => drop(self.textures.remove(key)),
        }
        self.record(object, Change::REMOVED);
    }

    fn put_texture(&mut self, key: TextureKey, texture: &Texture) {
        match self.textures.get(key) {
            None => {
                self.textures.insert_at(key, UseCounted::new(texture.clone()));
                self.record(key, Change::ADDED);
            }
            Some(old) if old.value == *texture => {}
            Some(_) => {
                self.save_prior_state(key);
                self.textures[key].value = texture.clone();
                self.record(key, Change::DATA);
            }
        }
    }

    fn put_material(&mut self, key: MaterialKey, material: &Material) {
        match self.materials.get(key) {
            None => {
                self.acquire_textures(material);
                self.materials.insert_at(key, UseCounted::new(material.clone()));
                self.record(key, Change::ADDED);
            }
            Some(old) if old.value == *material => {}
            // The old state was saved, and its textures released, in step 1 of `write_states`.
            Some(_) => {
                self.acquire_textures(material);
                self.materials[key].value = material.clone();
                self.record(key, Change::DATA);
            }
        }
    }

    fn put_geometry(&mut self, key: GeometryKey, geometry: &Geometry) {
        match self.geometries.get(key) {
            None => {
                // The scene's revision exceeds every earlier version of this key.
                let stored = StoredGeometry::from_validated(geometry.clone(), self.revision());
                self.geometries.insert_at(key, UseCounted::new(stored));
                self.record(key, Change::ADDED);
            }
            // Equal content keeps its version, so that data derived from it stay valid.
            Some(old) if old.value.geometry.has_equal_content(geometry) => {}
            Some(_) => self.replace_geometry(key, geometry.clone()),
        }
    }

    fn put_core(&mut self, key: CoreKey, core: &Core) {
        match self.cores.get(key) {
            None => {
                self.cores.insert_at(key, CoreSlot::new(core.clone()));
                self.acquire_assets(key, core);
                self.record(key, Change::ADDED);
            }
            Some(old) if old.core == *core => {}
            // The uses of the old core were ended in step 1 of `write_states`.
            Some(_) => {
                self.acquire_assets(key, core);
                self.replace_core(key, core.clone());
            }
        }
    }

    /// Writes everything of a node except its links to parent and siblings.
    fn write_node(&mut self, key: NodeKey, state: &NodeState) {
        let Some(node) = self.nodes.get(key) else {
            // The key may have had entries before whose removal the hierarchy has not applied yet.
            self.hierarchy.subtree_removed(key);
            let node = Node::new(state.core);
            let node = Node { mask: state.mask, visible: state.visible, name: state.name.clone(), ..node };
            self.nodes.insert_at(key, node);
            self.link_user(key, state.core);
            self.record(key, Change::ADDED);
            return;
        };
        // Find out what differs.
        let mut change = Change::empty();
        change.set(Change::CORE, node.core != state.core);
        change.set(Change::MASK, node.mask != state.mask);
        change.set(Change::VISIBILITY, node.visible != state.visible);
        change.set(Change::NAME, node.name != state.name);
        if change.is_empty() {
            return;
        }
        self.save_prior_state(key);
        // Write the new values.
        let node = &mut self.nodes[key];
        (node.mask, node.visible) = (state.mask, state.visible);
        node.name.clone_from(&state.name);
        // The use of the old core was ended in step 1 of `write_states`, and that core may be removed by now.
        if change.contains(Change::CORE) {
            self.link_user(key, state.core);
            self.core_changed(key, HierarchyEffects::ANY);
        } else if change != Change::NAME {
            self.node_changed(key);
        }
        self.record(key, change);
    }

    /// Links a node to its parent and previous sibling.
    fn link_node(&mut self, key: NodeKey, state: &NodeState) {
        let Some(parent) = state.parent else { return };
        // Leave a node alone that is in its place.
        let node = &self.nodes[key];
        let old_parent = node.parent;
        if (old_parent, node.previous_sibling) == (state.parent, state.previous_sibling) {
            return;
        }
        // Move it. Only another parent moves its entries; `children_changed` tells switches of the new order.
        self.unlink_child(key);
        self.link_child_after(key, parent, state.previous_sibling);
        if old_parent != Some(parent) {
            self.hierarchy.node_attached(key);
            old_parent.into_iter().for_each(|parent| self.children_changed(parent));
        }
        self.record(key, Change::PARENT);
        self.children_changed(parent);
    }
}
