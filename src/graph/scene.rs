//! The scene: owner of all nodes, cores, geometries, materials and textures.

use std::collections::{BTreeSet, HashMap};
use std::sync::atomic::{AtomicU64, Ordering};

use super::assets::{StoredGeometry, UseCounted};
use super::changes::{Change, ChangeCursor, ChangeLog, Changes};
use super::core::CoreSlot;
use super::hierarchy::{Hierarchy, SceneStores};
use super::node::Node;
use super::store::Store;
use super::transfer::Journal;
use super::{Core, CoreKey, GeometryKey, Material, MaterialKey, NodeKey, ObjectKey, Texture, TextureKey};
use crate::Result;

/// A retained scene graph.
///
/// A scene is a tree of nodes below one root. Each node has one parent, ordered children, one [`Core`] that holds its
/// content, a name, a ray mask and a visibility. Cores refer to geometries and materials, materials to textures; all of
/// these can be shared and are reference counted: each is freed when its last user is removed. One that never had a
/// user stays until [`remove_unused`](Self::remove_unused).
///
/// Objects are identified by keys, valid until the object is removed; a stale key is
/// [`Error::StaleKey`](crate::Error::StaleKey). A call that returns an error leaves the scene as it was. There is no
/// commit step: getters always reflect all edits.
///
/// Not guaranteed: that a key of another scene is detected. It may happen to refer to an object of this scene.
///
/// ```
/// use glam::{DVec3, Vec3};
/// use ropewalk::{Core, Geometry, Material, Scene, Transform};
///
/// let mut scene = Scene::new();
/// let geometry = scene.add_geometry(Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]]))?;
/// let material = scene.add_material(Material::default())?;
///
/// // An arm that turns a hand.
/// let arm = scene.add(scene.root(), Transform::from_translation(DVec3::X))?;
/// let hand = scene.add(arm, Core::Geometry { geometry, material })?;
/// scene.set_name(hand, "hand")?;
///
/// // A second hand shares the core of the first: both show one geometry.
/// let core = scene.core_key(hand)?;
/// let other = scene.add(scene.root(), core)?;
/// assert_eq!(scene.users(core)?.count(), 2);
/// assert_eq!((scene.triangle_count(), scene.instanced_triangle_count()), (1, 2));
///
/// // Getters reflect all edits.
/// scene.set_local(arm, Transform::from_translation(DVec3::new(5.0, 0.0, 0.0)))?;
/// assert_eq!(scene.world_from_local(hand)?.translation, DVec3::new(5.0, 0.0, 0.0));
///
/// // The geometry is freed with its last user.
/// scene.remove(arm)?;
/// scene.remove(other)?;
/// assert!(scene.geometry(geometry).is_err());
/// # Ok::<(), ropewalk::Error>(())
/// ```
#[derive(Debug)]
pub struct Scene {
    id: SceneId,
    pub(super) root: NodeKey,
    pub(super) nodes: Store<NodeKey, Node>,
    pub(super) cores: Store<CoreKey, CoreSlot>,
    pub(super) geometries: Store<GeometryKey, UseCounted<StoredGeometry>>,
    pub(super) materials: Store<MaterialKey, UseCounted<Material>>,
    pub(super) textures: Store<TextureKey, UseCounted<Texture>>,
    pub(super) log: ChangeLog,
    pub(super) hierarchy: Hierarchy,
    pub(super) journal: Journal,
    /// While set, objects without users are not freed (in `write_states`).
    pub(super) defers_release: bool,
    /// The cores that instance each node.
    pub(super) cores_by_target: HashMap<NodeKey, BTreeSet<CoreKey>>,
    revision: u64,
}

/// Identifies a scene among those of one process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SceneId(u64);

impl Default for Scene {
    fn default() -> Self {
        Self::new()
    }
}

/// The whole scene.
impl Scene {
    /// An empty scene: a root node with a group core.
    pub fn new() -> Self {
        static NEXT_ID: AtomicU64 = AtomicU64::new(0);

        let (mut nodes, mut cores) = (Store::new(), Store::new());
        let core = cores.insert(CoreSlot::new(Core::Group));
        let mut scene = Self {
            id: SceneId(NEXT_ID.fetch_add(1, Ordering::Relaxed)),
            root: nodes.insert(Node::new(core)),
            nodes,
            cores,
            geometries: Store::new(),
            materials: Store::new(),
            textures: Store::new(),
            log: ChangeLog::default(),
            hierarchy: Hierarchy::default(),
            journal: Journal::default(),
            defers_release: false,
            cores_by_target: HashMap::new(),
            revision: 0,
        };
        scene.link_user(scene.root, core);
        scene
    }

    /// The identity of this scene: no two scenes of one process have the same.
    pub fn id(&self) -> SceneId {
        self.id
    }

    /// The node above all others. It has a group core and cannot be removed or moved.
    pub fn root(&self) -> NodeKey {
        self.root
    }

    /// Number of changes made so far. At two equal revisions a scene has equal content.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Number of nodes, the root included. O(1).
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// Number of cores. O(1).
    pub fn core_count(&self) -> usize {
        self.cores.len()
    }

    /// Number of geometries. O(1).
    pub fn geometry_count(&self) -> usize {
        self.geometries.len()
    }

    /// Number of materials. O(1).
    pub fn material_count(&self) -> usize {
        self.materials.len()
    }

    /// Number of textures. O(1).
    pub fn texture_count(&self) -> usize {
        self.textures.len()
    }

    /// Number of triangles over all geometries, each counted once. O(geometries).
    pub fn triangle_count(&self) -> u64 {
        self.geometries.values().map(|used| used.value.geometry.indices.len() as u64).sum()
    }

    /// Number of triangles with each geometry counted once per node that uses it, visible or not; subtrees under
    /// [`Core::Instance`] are not multiplied, unlike in
    /// [`CompileReport::instanced_triangles`](crate::compile::CompileReport::instanced_triangles). O(cores).
    pub fn instanced_triangle_count(&self) -> u64 {
        let triangles = |slot: &CoreSlot| match slot.core {
            Core::Geometry { geometry, .. } => self.geometries[geometry].value.geometry.indices.len() as u64,
            _ => 0,
        };
        // Each core counts once for each of its users.
        self.cores.values().map(|slot| triangles(slot) * slot.user_count as u64).sum()
    }

    /// A cursor into the log of changes, for one consumer. Its first read gives [`Changes::Everything`]. Equal to
    /// `ChangeCursor::default()`.
    pub fn subscribe(&self) -> ChangeCursor {
        ChangeCursor::default()
    }

    /// Changes since the last read with this cursor, merged per object; advances the cursor.
    ///
    /// A cursor that has not read from this scene before gets [`Changes::Everything`] and belongs to this scene from
    /// then on, so a consumer can be given another scene at any time. O(objects changed since); O(nodes + cores) the
    /// first time.
    ///
    /// ```
    /// use ropewalk::graph::{Change, Changes, ObjectKey};
    /// use ropewalk::Scene;
    ///
    /// let mut scene = Scene::new();
    /// let mut cursor = scene.subscribe();
    /// assert_eq!(scene.changes_since(&mut cursor), Changes::Everything);
    ///
    /// scene.set_name(scene.root(), "world")?;
    /// scene.set_mask(scene.root(), 1)?;
    /// let expected = vec![(ObjectKey::Node(scene.root()), Change::NAME | Change::MASK)];
    /// assert_eq!(scene.changes_since(&mut cursor), Changes::Since(expected));
    /// assert_eq!(scene.changes_since(&mut cursor), Changes::Since(vec![]));
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    pub fn changes_since(&mut self, cursor: &mut ChangeCursor) -> Changes {
        let changes = self.log.read(self.id, cursor);
        if changes == Changes::Everything {
            // Allocate now: the first edit should not pay for it.
            self.log.reserve(self.nodes.keys().last(), self.cores.keys().last());
        }
        changes
    }

    /// The flattened hierarchy, brought up to date. O(1) if nothing changed, else O(nodes changed and all below them),
    /// amortised.
    ///
    /// # Errors
    /// [`Error::Limit`](crate::Error::Limit) if instances of instances make more than [`Hierarchy::MAX_INSTANCED`]
    /// entries.
    pub fn hierarchy(&mut self) -> Result<&Hierarchy> {
        Ok(self.with_hierarchy()?.1)
    }

    /// As [`hierarchy`](Self::hierarchy), together with a shared reference to the scene.
    ///
    /// # Errors
    /// As [`hierarchy`](Self::hierarchy).
    pub fn with_hierarchy(&mut self) -> Result<(&Self, &Hierarchy)> {
        let (hierarchy, tree) = self.hierarchy_and_stores();
        hierarchy.update(tree)?;
        Ok((self, &self.hierarchy))
    }

    /// The hierarchy, for an update, and the objects that it is built from.
    pub(super) fn hierarchy_and_stores(&mut self) -> (&mut Hierarchy, SceneStores<'_>) {
        let Self { root, nodes, cores, geometries, cores_by_target, .. } = self;
        let has_instances = !cores_by_target.is_empty();
        (&mut self.hierarchy, SceneStores { root: *root, nodes, cores, geometries, has_instances })
    }

    /// The objects that a hierarchy is built from.
    pub(super) fn stores(&self) -> SceneStores<'_> {
        let has_instances = !self.cores_by_target.is_empty();
        SceneStores {
            root: self.root,
            nodes: &self.nodes,
            cores: &self.cores,
            geometries: &self.geometries,
            has_instances,
        }
    }

    /// Counts and logs one change, after it was made.
    pub(super) fn record(&mut self, object: impl Into<ObjectKey>, change: Change) {
        let object = object.into();
        self.revision += 1;
        self.log.record(object, change);
        // Creation and removal also concern the journal; other edits saved their prior state before.
        match change {
            Change::ADDED => self.save_as_absent(object),
            Change::REMOVED => self.discard_transient(object),
            _ => {}
        }
    }

    pub(super) fn node(&self, key: NodeKey) -> Result<&Node> {
        self.nodes.require(key)
    }

    pub(super) fn core_slot(&self, key: CoreKey) -> Result<&CoreSlot> {
        self.cores.require(key)
    }
}
