//! Deltas: target states of scene objects.

use serde::{Deserialize, Serialize};

use super::ObjectState;
use super::check::check;
use crate::Result;
use crate::graph::{Change, ChangeCursor, Changes, ObjectKey, Scene};

/// Target states (or absence) of some objects; of all objects if it is a [snapshot](Self::is_snapshot).
///
/// It is made by [`Scene::delta_since`] or [`Scene::snapshot`] and applied by [`Scene::apply`]. In between it can be
/// sent to another thread, where it shares the arrays of geometries and textures with its scene, or be serialised with
/// serde.
///
/// A delta from an untrusted source may be invalid; [`Scene::apply`] validates it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Delta {
    /// In ascending order of keys, each object once. Keys of one kind are ordered by slot.
    pub(super) objects: Vec<(ObjectKey, Option<ObjectState>)>,
    /// For a snapshot: the highest generation issued per slot.
    pub(super) snapshot_generations: Option<Generations>,
}

/// By kind and slot: the highest generation that a key of the scene ever had.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Generations {
    pub(super) nodes: Vec<u32>,
    pub(super) cores: Vec<u32>,
    pub(super) geometries: Vec<u32>,
    pub(super) materials: Vec<u32>,
    pub(super) textures: Vec<u32>,
}

impl Delta {
    /// A delta of these objects, in any order, each at most once.
    pub(super) fn new(objects: impl IntoIterator<Item = (ObjectKey, Option<ObjectState>)>) -> Self {
        let mut objects: Vec<_> = objects.into_iter().collect();
        objects.sort_unstable_by_key(|&(object, _)| object);
        Self { objects, snapshot_generations: None }
    }

    /// Whether it is a snapshot: the target state of the whole scene, in which an object that it does not name is
    /// absent.
    pub fn is_snapshot(&self) -> bool {
        self.snapshot_generations.is_some()
    }

    /// Number of objects with a target state or absence.
    pub fn len(&self) -> usize {
        self.objects.len()
    }

    /// Whether it has no objects.
    pub fn is_empty(&self) -> bool {
        self.objects.is_empty()
    }

    /// Its objects, in ascending order of keys within each kind, with their target states: `None` for absent.
    pub fn objects(&self) -> impl Iterator<Item = (ObjectKey, Option<&ObjectState>)> {
        self.objects.iter().map(|(object, state)| (*object, state.as_ref()))
    }

    /// The target state of an object: `None` if the delta does not have the object. O(log objects).
    pub(super) fn get(&self, object: ObjectKey) -> Option<&Option<ObjectState>> {
        let index = self.objects.binary_search_by_key(&object, |&(object, _)| object).ok()?;
        Some(&self.objects[index].1)
    }
}

/// State transfer.
impl Scene {
    /// The state of the whole scene, as a delta that makes any scene equal to it. O(objects): arrays are shared, not
    /// copied.
    pub fn snapshot(&self) -> Delta {
        let mut delta = Delta::new(self.objects().map(|object| (object, self.state(object))));
        delta.snapshot_generations = Some(Generations {
            nodes: self.nodes.generations().to_vec(),
            cores: self.cores.generations().to_vec(),
            geometries: self.geometries.generations().to_vec(),
            materials: self.materials.generations().to_vec(),
            textures: self.textures.generations().to_vec(),
        });
        delta
    }

    /// The current state of every object changed since the cursor's last read; a snapshot at the first read. Advances
    /// the cursor. O(objects changed since); O(objects) the first time.
    ///
    /// [Applied](Self::apply) to a second scene, delta after delta, they keep that scene equal: a replica, in this
    /// process or in another. Its keys are those of this scene.
    ///
    /// ```
    /// use ropewalk::graph::{ChangeCursor, Delta};
    /// use ropewalk::{Core, Scene};
    ///
    /// let (mut scene, mut replica) = (Scene::new(), Scene::new());
    /// let mut cursor = ChangeCursor::default();
    /// let node = scene.add(scene.root(), Core::Group)?;
    /// replica.apply(&scene.delta_since(&mut cursor))?;
    ///
    /// scene.set_name(node, "arm")?;
    /// // Through any serde format, to any machine.
    /// let bytes = serde_json::to_vec(&scene.delta_since(&mut cursor)).unwrap();
    /// let delta: Delta = serde_json::from_slice(&bytes).unwrap();
    /// assert_eq!(delta.len(), 1);
    /// replica.apply(&delta)?;
    /// assert_eq!(replica.name(node)?, "arm");
    /// assert_eq!(replica.snapshot(), scene.snapshot());
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// A replica in another thread can be rendered while the application keeps editing, without locking:
    ///
    /// ```
    /// use std::sync::mpsc;
    ///
    /// use ropewalk::graph::{ChangeCursor, Delta};
    /// use ropewalk::{Core, DeviceChoice, Renderer, RendererOptions, Scene, View};
    ///
    /// let (deltas, received) = mpsc::channel::<Delta>();
    /// let renderer = std::thread::spawn(move || -> ropewalk::Result<usize> {
    ///     let mut replica = Scene::new();
    ///     let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
    ///     while let Ok(delta) = received.recv() {
    ///         replica.apply(&delta)?;
    ///         for delta in received.try_iter() {
    ///             replica.apply(&delta)?;
    ///         }
    ///         let view = View::framing(&mut replica, 8, 8)?;
    ///         renderer.render(&mut replica, &view)?;
    ///     }
    ///     Ok(replica.node_count())
    /// });
    ///
    /// let (mut scene, mut cursor) = (Scene::new(), ChangeCursor::default());
    /// for _frame in 0..10 {
    ///     scene.add(scene.root(), Core::Group)?;
    ///     deltas.send(scene.delta_since(&mut cursor)).expect("the renderer listens");
    /// }
    /// drop(deltas);
    /// assert_eq!(renderer.join().expect("no panic")?, 11);
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// Limits: the replica must not be edited itself; and it may reissue keys of objects that were created and freed
    /// between two reads.
    pub fn delta_since(&mut self, cursor: &mut ChangeCursor) -> Delta {
        match self.changes_since(cursor) {
            Changes::Everything => self.snapshot(),
            Changes::Since(changes) => {
                // CHILDREN needs no entry: the states of the children name their parent and previous sibling.
                let changes = changes.into_iter().filter(|(_, change)| *change != Change::CHILDREN);
                Delta::new(changes.map(|(object, change)| {
                    let is_removed = change.contains(Change::REMOVED);
                    (object, if is_removed { None } else { self.state(object) })
                }))
            }
        }
    }

    /// Applies the delta atomically: each object gets its target state under the same key; with a snapshot, all other
    /// objects are removed. O(objects in the delta, with the vertices and texels of new ones), and O(depth) to find
    /// cycles if nodes moved; O(objects) for a snapshot.
    ///
    /// The delta is validated, whatever its source. Changes are logged and can be undone like any edit; an object that
    /// has its target state already is not changed. Objects that lose their last user are freed only if the delta says
    /// so.
    ///
    /// # Errors
    /// The scene stays as it was.
    /// - [`Error::Delta`](crate::Error::Delta) with the first object whose target state does not fit the scene: most
    ///   often the delta was made for another state of the scene.
    /// - [`Error::StaleKey`](crate::Error::StaleKey) for a key in a target state.
    /// - [`Error::Cycle`](crate::Error::Cycle), [`Error::Root`](crate::Error::Root),
    ///   [`Error::OutOfRange`](crate::Error::OutOfRange), [`Error::InvalidGeometry`](crate::Error::InvalidGeometry) as
    ///   the setters.
    /// - [`Error::Limit`](crate::Error::Limit) if a key's slot is far beyond those in use.
    pub fn apply(&mut self, delta: &Delta) -> Result<()> {
        let Some(generations) = &delta.snapshot_generations else {
            return self.apply_objects(delta);
        };
        // A snapshot removes what it does not name: complete it with those objects as absent.
        let others = self.objects().filter(|&object| delta.get(object).is_none()).map(|object| (object, None));
        let others: Vec<_> = others.collect();
        if others.is_empty() {
            self.apply_objects(delta)?;
        } else {
            let complete = Delta::new(delta.objects.iter().cloned().chain(others));
            self.apply_objects(&Delta { snapshot_generations: delta.snapshot_generations.clone(), ..complete })?;
        }
        // Never issue a key that the other scene has issued.
        self.nodes.raise_generations(&generations.nodes);
        self.cores.raise_generations(&generations.cores);
        self.geometries.raise_generations(&generations.geometries);
        self.materials.raise_generations(&generations.materials);
        self.textures.raise_generations(&generations.textures);
        Ok(())
    }

    pub(super) fn apply_objects(&mut self, delta: &Delta) -> Result<()> {
        let order = check(self, delta)?;
        self.write_states(delta, &order);
        Ok(())
    }
}
