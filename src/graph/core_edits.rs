//! Edits of cores, shared or not.

use super::changes::Change;
use super::core::CoreSlot;
use super::value_checks::{check_core, check_transform};
use super::{Core, CoreKey, CoreKind, CoreSource, NodeKey, Scene, Transform};
use crate::error::RootEdit;
use crate::{Error, Result};

/// Cores.
impl Scene {
    /// Adds a core that no node uses yet. It goes when its last user goes, not before its first came. O(1).
    ///
    /// # Errors
    /// [`Error::StaleKey`] for what it refers to; [`Error::OutOfRange`] for a bad number in it.
    pub fn add_core(&mut self, core: Core) -> Result<CoreKey> {
        self.insert_or_share_core(core.into())
    }

    /// What the node is.
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn node_core(&self, node: NodeKey) -> Result<&Core> {
        Ok(&self.cores[self.node(node)?.core].core)
    }

    /// The name of the node's core: give it to [`add`](Self::add) to share the core with another node.
    ///
    /// # Errors
    /// [`Error::StaleKey`].
    pub fn core_key(&self, node: NodeKey) -> Result<CoreKey> {
        Ok(self.node(node)?.core)
    }

    /// The core that a key names.
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

    /// Gives one node another core; other users of its old one keep that. O(1).
    ///
    /// The same key, or a new core equal to one that the node has for itself alone, changes nothing.
    ///
    /// # Errors
    /// [`Error::StaleKey`] for the node or what the core refers to; [`Error::OutOfRange`] for a bad number in a new
    /// core; [`Error::Root`] for the root and a core other than a group; [`Error::Cycle`] if the core instances the node,
    /// or something that shows it.
    pub fn assign_core(&mut self, node: NodeKey, core: impl Into<CoreSource>) -> Result<()> {
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
        let new = self.insert_or_share_core(source)?;
        self.save_prior_state(node);
        let was = HierarchyEffects::of(&self.cores[old].core);
        self.unlink_user(node, old);
        self.link_user(node, new);
        self.core_changed(node, was);
        self.record(node, Change::CORE);
        self.release_core_if_unused(old);
        Ok(())
    }

    /// Changes a core, and with it every node that uses it. O(users).
    ///
    /// # Errors
    /// [`Error::StaleKey`] for the core or what it is to refer to; [`Error::OutOfRange`] for a bad number;
    /// [`Error::Root`] if the root uses it and it would no longer be a group; [`Error::Cycle`] if it would instance one of
    /// its users, or something that shows one.
    pub fn set_core(&mut self, key: CoreKey, core: Core) -> Result<()> {
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
        self.acquire_assets(key, &core);
        let old = self.replace_core(key, core);
        self.release_assets(key, &old);
        Ok(())
    }

    /// Edits the content of a core for all nodes that use it: [`set_core`](Self::set_core) with a changed copy. O(users).
    ///
    /// ```
    /// use ropewalk::{Core, Scene, Switch};
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

    /// Puts another core, whose assets count it, in the place of one, which it gives back.
    pub(super) fn replace_core(&mut self, key: CoreKey, core: Core) -> Core {
        self.save_prior_state(key);
        let old = std::mem::replace(&mut self.cores[key].core, core);
        let new = &self.cores[key].core;
        let moves = matches!(old, Core::Transform(_)) || matches!(new, Core::Transform(_));
        let mut change = if moves { Change::TRANSFORM } else { Change::empty() };
        if std::mem::discriminant(&old) != std::mem::discriminant(new) {
            change |= Change::KIND | Change::DATA;
        } else if !moves {
            change |= Change::DATA;
        }
        let was = HierarchyEffects::of(&old);
        let mut next = self.cores[key].first_user;
        while let Some(user) = next {
            self.core_changed(user, was);
            next = self.nodes[user].next_user;
        }
        self.record(key, change);
        old
    }

    /// The transform of a transform node into its parent's space.
    ///
    /// # Errors
    /// [`Error::StaleKey`]; [`Error::WrongCore`] if the node has no transform: move its parent, or put a transform
    /// node above it.
    pub fn local(&self, node: NodeKey) -> Result<Transform> {
        match *self.node_core(node)? {
            Core::Transform(transform) => Ok(transform),
            ref core => Err(Error::WrongCore { node, expected: CoreKind::Transform, found: core.kind() }),
        }
    }

    /// Moves a transform node with everything below it, and with it all nodes that share its core. O(nodes that share
    /// it).
    ///
    /// # Errors
    /// As [`local`](Self::local); [`Error::OutOfRange`] if some number is not finite.
    pub fn set_local(&mut self, node: NodeKey, transform: impl Into<Transform>) -> Result<()> {
        let transform = transform.into();
        if self.local(node)? != transform {
            self.edit_transform(self.nodes[node].core, transform)?;
        }
        Ok(())
    }

    /// Moves all users of a transform core. What [`set_core`](Self::set_core) does, without what it does for other cores.
    fn edit_transform(&mut self, key: CoreKey, transform: Transform) -> Result<()> {
        let local = check_transform(&transform)?;
        self.save_prior_state(key);
        let slot = &mut self.cores[key];
        slot.core = Core::Transform(transform);
        let mut next = slot.first_user;
        while let Some(user) = next {
            self.hierarchy.transform_changed(user, &local);
            next = self.nodes[user].next_user;
        }
        self.record(key, Change::TRANSFORM);
        Ok(())
    }

    /// The key of a source, which exists afterwards.
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

    /// Frees a core that lost a user, if it was the last.
    pub(super) fn release_core_if_unused(&mut self, key: CoreKey) {
        if self.cores[key].user_count > 0 {
            return;
        }
        self.save_prior_state(key);
        if let Some(slot) = self.cores.remove(key) {
            self.record(key, Change::REMOVED);
            self.release_assets(key, &slot.core);
        }
    }

    /// Tells the hierarchy that a node's own transform, mask or visibility is another.
    pub(super) fn node_changed(&mut self, key: NodeKey) {
        let node = &self.nodes[key];
        self.hierarchy.node_changed(key, node, &self.cores[node.core].core);
    }

    /// Tells the hierarchy that a node's core is another than it was.
    pub(super) fn core_changed(&mut self, key: NodeKey, was: HierarchyEffects) {
        self.node_changed(key);
        let is = HierarchyEffects::of(&self.cores[self.nodes[key].core].core);
        if was.switch || is.switch {
            self.hierarchy.switch_changed(key);
        }
        if was.instance || is.instance {
            self.hierarchy.instance_changed(key);
        }
        if was.geometry || is.geometry {
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

/// What a core means to others than its node.
#[derive(Clone, Copy)]
pub(super) struct HierarchyEffects {
    switch: bool,
    instance: bool,
    geometry: bool,
}

impl HierarchyEffects {
    /// Of a core that is not known any more.
    pub(super) const ANY: Self = Self { switch: true, instance: true, geometry: true };

    fn of(core: &Core) -> Self {
        Self {
            switch: matches!(core, Core::Switch(_)),
            instance: matches!(core, Core::Instance(_)),
            geometry: matches!(core, Core::Geometry { .. }),
        }
    }
}
