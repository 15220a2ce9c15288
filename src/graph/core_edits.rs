//! Adding, replacing and editing cores.

use super::changes::Change;
use super::core::CoreSlot;
use super::value_checks::{check_core, check_transform};
use super::{Core, CoreKey, CoreKind, CoreSource, NodeKey, Scene, Transform};
use crate::error::RootEdit;
use crate::{Error, Result};

/// Cores.
impl Scene {
    /// Adds a core without users. It is freed when its last user is removed; until it has a first user it stays. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`] for a key in it; [`Error::OutOfRange`] if a number in it is out of range.
    pub fn add_core(&mut self, core: Core) -> Result<CoreKey> {
        self.insert_or_share_core(core.into())
    }

    /// The node's core. Its kind is `scene.node_core(node)?.kind()`. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn node_core(&self, node: NodeKey) -> Result<&Core> {
        Ok(&self.cores[self.node(node)?.core].core)
    }

    /// The key of the node's core; pass it to [`add`](Self::add) to share the core. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn core_key(&self, node: NodeKey) -> Result<CoreKey> {
        Ok(self.node(node)?.core)
    }

    /// The core with this key. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn core(&self, key: CoreKey) -> Result<&Core> {
        Ok(&self.core_slot(key)?.core)
    }

    /// All cores, in no particular order.
    pub fn cores(&self) -> impl Iterator<Item = (CoreKey, &Core)> {
        self.cores.iter().map(|(key, slot)| (key, &slot.core))
    }

    /// Gives one node another core. Other nodes that shared the old core keep it. O(1).
    ///
    /// Does nothing if the node already has this core, or has an unshared core equal to it.
    ///
    /// # Errors
    /// [`Error::StaleKey`] for the node or a key in the core; [`Error::OutOfRange`] if a number in a new core is out of
    /// range; [`Error::Root`] for the root and a core other than a group; [`Error::Cycle`] if the core instances the
    /// node itself or one of its ancestors (through parents or instances).
    pub fn assign_core(&mut self, node: NodeKey, core: impl Into<CoreSource>) -> Result<()> {
        // 1. Check the new core, and whether it is the one that the node has.
        let old = self.node(node)?.core;
        let source = core.into();
        if node == self.root {
            self.check_root_core(&source)?;
        }
        match &source {
            CoreSource::Shared(key) if *key == old => return Ok(()),
            CoreSource::New(core) if self.cores[old].user_count == 1 && self.cores[old].core == *core => return Ok(()),
            _ => {}
        }
        match &source {
            CoreSource::New(core) => self.check_instance_cycle(node, core)?,
            CoreSource::Shared(key) => self.check_instance_cycle(node, self.core(*key)?)?,
        }
        // 2. Move the node from the users of the old core to those of the new one.
        let new = self.insert_or_share_core(source)?;
        self.save_prior_state(node);
        let old_effects = HierarchyEffects::of(&self.cores[old].core);
        self.unlink_user(node, old);
        self.link_user(node, new);
        // 3. Report the change, and free the old core if this was its last user.
        self.core_changed(node, old_effects);
        self.record(node, Change::CORE);
        self.release_core_if_unused(old);
        Ok(())
    }

    /// Replaces the content of a core for all nodes that use it. O(users).
    ///
    /// # Errors
    /// [`Error::StaleKey`] for the core or a key in the new content; [`Error::OutOfRange`] if a number in it is out of
    /// range; [`Error::Root`] if the root uses the core and it would no longer be a group; [`Error::Cycle`] if it would
    /// instance one of its users or of their ancestors (through parents or instances).
    pub fn set_core(&mut self, key: CoreKey, core: Core) -> Result<()> {
        // 1. Check the new content against all users.
        if self.core_slot(key)?.core == core {
            return Ok(());
        }
        if self.nodes[self.root].core == key {
            self.check_root_core(&CoreSource::New(core.clone()))?;
        }
        self.check_core(&core)?;
        if let Core::Instance(_) = core {
            self.users(key)?.try_for_each(|user| self.check_instance_cycle(user, &core))?;
        }
        // 2. Replace it. References are acquired before old ones are released, so that what both refer to is not freed.
        self.acquire_assets(key, &core);
        let old = self.replace_core(key, core);
        self.release_assets(key, &old);
        Ok(())
    }

    /// Edits the content of a core for all nodes that use it: [`set_core`](Self::set_core) with a changed copy.
    /// O(users).
    ///
    /// ```
    /// use ropewalk::graph::Switch;
    /// use ropewalk::{Core, Scene};
    ///
    /// let mut scene = Scene::new();
    /// let switch = scene.add_core(Core::Switch(Switch::All))?;
    /// scene.edit_core(switch, |core| {
    ///     if let Core::Switch(shown) = core {
    ///         *shown = Switch::One(2);
    ///     }
    /// })?;
    /// assert_eq!(*scene.core(switch)?, Core::Switch(Switch::One(2)));
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`set_core`](Self::set_core).
    pub fn edit_core(&mut self, key: CoreKey, edit: impl FnOnce(&mut Core)) -> Result<()> {
        let mut core = self.core(key)?.clone();
        edit(&mut core);
        self.set_core(key, core)
    }

    /// Replaces a stored core and returns the old one. The caller has already counted the new core's asset references.
    pub(super) fn replace_core(&mut self, key: CoreKey, core: Core) -> Core {
        // 1. Swap the content.
        self.save_prior_state(key);
        let old = std::mem::replace(&mut self.cores[key].core, core);
        let new = &self.cores[key].core;
        // 2. Classify the change: a transform that stays one has no other data.
        let moves = matches!(old, Core::Transform(_)) || matches!(new, Core::Transform(_));
        let mut change = if moves { Change::TRANSFORM } else { Change::empty() };
        if old.kind() != new.kind() {
            change |= Change::KIND | Change::DATA;
        } else if !moves {
            change |= Change::DATA;
        }
        // 3. Notify the hierarchy of every user.
        let old_effects = HierarchyEffects::of(&old);
        let mut next = self.cores[key].first_user;
        while let Some(user) = next {
            self.core_changed(user, old_effects);
            next = self.nodes[user].next_user;
        }
        self.record(key, change);
        old
    }

    /// The local transform of a transform node: `parent_from_local`.
    ///
    /// # Errors
    /// [`Error::StaleKey`]; [`Error::WrongCore`] if the node has no transform core: move its parent, or put a transform
    /// node above it.
    pub fn local(&self, node: NodeKey) -> Result<Transform> {
        match *self.node_core(node)? {
            Core::Transform(transform) => Ok(transform),
            ref core => Err(Error::WrongCore { node, expected: CoreKind::Transform, found: core.kind() }),
        }
    }

    /// Sets the local transform of a transform node, and of all nodes that share its core. O(nodes that share it).
    ///
    /// # Errors
    /// As [`local`](Self::local); [`Error::OutOfRange`] if a number in it is not finite.
    pub fn set_local(&mut self, node: NodeKey, transform: impl Into<Transform>) -> Result<()> {
        let transform = transform.into();
        if self.local(node)? != transform {
            self.edit_transform(self.nodes[node].core, transform)?;
        }
        Ok(())
    }

    /// Fast path of [`set_core`](Self::set_core) for transforms: no asset counts, no instance checks.
    fn edit_transform(&mut self, key: CoreKey, transform: Transform) -> Result<()> {
        // Check the transform and compute its matrix once for all users.
        let local = check_transform(&transform)?;
        self.save_prior_state(key);
        let slot = &mut self.cores[key];
        slot.core = Core::Transform(transform);
        // Give it to the entries of every user.
        let mut next = slot.first_user;
        while let Some(user) = next {
            self.hierarchy.transform_changed(user, &local);
            next = self.nodes[user].next_user;
        }
        self.record(key, Change::TRANSFORM);
        Ok(())
    }

    /// Inserts a new core or checks a shared key; returns the key.
    pub(super) fn insert_or_share_core(&mut self, source: CoreSource) -> Result<CoreKey> {
        match source {
            CoreSource::Shared(key) => self.core_slot(key).map(|_| key),
            CoreSource::New(core) => {
                self.check_core(&core)?;
                let key = self.cores.insert(CoreSlot::new(core.clone()));
                self.acquire_assets(key, &core);
                self.record(key, Change::ADDED);
                Ok(key)
            }
        }
    }

    /// Frees a core that has no users left.
    pub(super) fn release_core_if_unused(&mut self, key: CoreKey) {
        if self.cores[key].user_count > 0 {
            return;
        }
        // Remove the core, then end its uses of assets.
        self.save_prior_state(key);
        if let Some(slot) = self.cores.remove(key) {
            self.record(key, Change::REMOVED);
            self.release_assets(key, &slot.core);
        }
    }

    /// Marks the node's entries dirty: its local transform, mask, visibility or material group changed.
    pub(super) fn node_changed(&mut self, key: NodeKey) {
        let node = &self.nodes[key];
        self.hierarchy.node_changed(key, node, &self.cores[node.core].core);
    }

    /// Tells the hierarchy that a node's core changed; `old_effects` are the effects of the old core.
    pub(super) fn core_changed(&mut self, key: NodeKey, old_effects: HierarchyEffects) {
        // Reload the own values; derived data depend on the kinds of the old and the new core.
        self.node_changed(key);
        let new_effects = HierarchyEffects::of(&self.cores[self.nodes[key].core].core);
        if old_effects.switch || new_effects.switch {
            self.hierarchy.switch_changed(key);
        }
        if old_effects.instance || new_effects.instance {
            self.hierarchy.instance_changed(key);
        }
        if old_effects.geometry || new_effects.geometry {
            self.hierarchy.geometry_bounds_changed(key);
        }
    }

    fn check_root_core(&self, source: &CoreSource) -> Result<()> {
        let core = match source {
            CoreSource::New(core) => core,
            CoreSource::Shared(key) => self.core(*key)?,
        };
        match core {
            Core::Group => Ok(()),
            other => Err(Error::Root { attempt: RootEdit::SetCore(other.kind()) }),
        }
    }

    /// Checks the keys and the numbers in a core.
    pub(super) fn check_core(&self, core: &Core) -> Result<()> {
        if let Some(geometry) = core.geometry() {
            self.geometries.require(geometry)?;
        }
        if let Some(material) = core.material() {
            self.materials.require(material)?;
        }
        if let Core::Instance(target) = *core {
            self.node(target)?;
        }
        check_core(core)
    }
}

/// Which derived data of the hierarchy depend on a core, by its kind.
#[derive(Clone, Copy)]
pub(super) struct HierarchyEffects {
    switch: bool,
    instance: bool,
    geometry: bool,
}

impl HierarchyEffects {
    /// All effects; used when the old core is no longer available.
    pub(super) const ANY: Self = Self { switch: true, instance: true, geometry: true };

    fn of(core: &Core) -> Self {
        Self {
            switch: matches!(core, Core::Switch(_)),
            instance: matches!(core, Core::Instance(_)),
            geometry: matches!(core, Core::Geometry { .. }),
        }
    }
}
