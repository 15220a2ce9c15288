//! Deltas: what some objects, or all, are to be.

use serde::{Deserialize, Serialize};

use super::ObjectState;
use super::check::check;
use crate::Result;
use crate::graph::{Change, ChangeCursor, Changes, ObjectKey, Scene};

/// What some objects are to be: each in a given state, or absent. Says it of all objects if it is
/// [whole](Self::is_snapshot).
///
/// It comes from [`Scene::delta_since`] or [`Scene::snapshot`], and goes to [`Scene::apply`]. In between it can cross
/// threads, where it shares the arrays of geometries and textures with its scene, or be serialised with serde.
///
/// Not guaranteed: that one from elsewhere makes sense. [`Scene::apply`] checks all of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Delta {
    /// Rising, each object once. Keys order as their slots within a kind.
    pub(super) objects: Vec<(ObjectKey, Option<ObjectState>)>,
    /// Where it is whole: what keys the scene has given out.
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
    /// Sorts what is to become of each object.
    pub(super) fn new(objects: impl IntoIterator<Item = (ObjectKey, Option<ObjectState>)>) -> Self {
        let mut objects: Vec<_> = objects.into_iter().collect();
        objects.sort_unstable_by_key(|&(object, _)| object);
        Self { objects, snapshot_generations: None }
    }

    /// Whether it says what the whole scene is to be: what it does not name is to be absent.
    pub fn is_snapshot(&self) -> bool {
        self.snapshot_generations.is_some()
    }

    /// Number of objects that it names.
    pub fn len(&self) -> usize {
        self.objects.len()
    }

    /// Whether it names no object.
    pub fn is_empty(&self) -> bool {
        self.objects.is_empty()
    }

    /// The objects that it names, by rising keys of each kind, and what each is to be: `None` for absent.
    pub fn objects(&self) -> impl Iterator<Item = (ObjectKey, Option<&ObjectState>)> {
        self.objects.iter().map(|(object, state)| (*object, state.as_ref()))
    }

    /// What an object is to be: `None` if the delta does not name it. O(log objects).
    pub(super) fn get(&self, object: ObjectKey) -> Option<&Option<ObjectState>> {
        let place = self.objects.binary_search_by_key(&object, |&(object, _)| object).ok()?;
        Some(&self.objects[place].1)
    }
}

/// State transfer.
impl Scene {
    /// The whole scene, as a delta that makes any scene equal to it. O(objects): arrays are shared, not copied.
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

    /// What has changed since the last read with this cursor, as it is now; moves the cursor to now. The first time,
    /// the whole scene. O(changes since), of which one object's many count once; O(objects) the first time.
    ///
    /// [Applied](Self::apply) to a second scene, delta after delta, they keep that one equal: a mirror, in this process
    /// or in another. Its keys are those of this scene.
    ///
    /// ```
    /// use ropewalk::{Core, Cursor, Delta, Scene};
    ///
    /// let (mut scene, mut mirror) = (Scene::new(), Scene::new());
    /// let mut cursor = Cursor::default();
    /// let node = scene.add(scene.root(), Core::Group)?;
    /// mirror.apply(&scene.delta_since(&mut cursor))?;
    ///
    /// scene.set_name(node, "arm")?;
    /// // Through any serde format, to any machine.
    /// let bytes = serde_json::to_vec(&scene.delta_since(&mut cursor)).unwrap();
    /// let delta: Delta = serde_json::from_slice(&bytes).unwrap();
    /// assert_eq!(delta.len(), 1);
    /// mirror.apply(&delta)?;
    /// assert_eq!(mirror.name(node)?, "arm");
    /// assert_eq!(mirror.snapshot(), scene.snapshot());
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// A replica in a thread of its own can be drawn while the application edits on, and neither waits for the other:
    ///
    /// ```
    /// use std::sync::mpsc;
    ///
    /// use ropewalk::{Core, Cursor, Delta, DeviceChoice, Renderer, RendererOptions, Scene, View};
    ///
    /// let (deltas, received) = mpsc::channel::<Delta>();
    /// let renderer = std::thread::spawn(move || -> ropewalk::Result<usize> {
    ///     let mut replica = Scene::new();
    ///     let mut renderer = Renderer::new(&RendererOptions { device: DeviceChoice::Cpu })?;
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
    /// let (mut scene, mut cursor) = (Scene::new(), Cursor::default());
    /// for _frame in 0..10 {
    ///     scene.add(scene.root(), Core::Group)?;
    ///     deltas.send(scene.delta_since(&mut cursor)).expect("the renderer listens");
    /// }
    /// drop(deltas);
    /// assert_eq!(renderer.join().expect("no panic")?, 11);
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// Not guaranteed: equality where the mirror is also edited itself. Keys of objects that came and went between two
    /// reads are not known to it as given out.
    pub fn delta_since(&mut self, cursor: &mut ChangeCursor) -> Delta {
        match self.changes_since(cursor) {
            Changes::Everything => self.snapshot(),
            Changes::Since(changes) => {
                // The children say themselves where they are.
                let changes = changes.into_iter().filter(|(_, change)| *change != Change::CHILDREN);
                Delta::new(changes.map(|(object, change)| {
                    let is_gone = change.contains(Change::REMOVED);
                    (object, if is_gone { None } else { self.state(object) })
                }))
            }
        }
    }

    /// Makes each object that the delta names be as it says, under the same key; if it is whole, with nothing else in
    /// the scene. O(objects in the delta, with the vertices and texels of new ones), and O(depth) to find cycles where
    /// nodes moved; O(objects) for a whole one.
    ///
    /// All of it is checked, whoever made it. What changes is logged as any edit is, undo takes it back, and an object
    /// that already is as it should be is left alone. Nothing is freed that the delta does not name: a core whose last
    /// user it removes stays, unless it removes that too.
    ///
    /// # Errors
    /// The scene stays as it was.
    /// - [`Error::Delta`](crate::Error::Delta) with the first object whose state does not fit the scene: most often
    ///   the delta was made for another state of the scene than this one is in.
    /// - [`Error::StaleKey`](crate::Error::StaleKey) for what some object is to refer to.
    /// - [`Error::Cycle`](crate::Error::Cycle), [`Error::Root`](crate::Error::Root),
    ///   [`Error::OutOfRange`](crate::Error::OutOfRange), [`Error::InvalidGeometry`](crate::Error::InvalidGeometry) as
    ///   the setters.
    /// - [`Error::Limit`](crate::Error::Limit) where a key's slot is far beyond those in use.
    pub fn apply(&mut self, delta: &Delta) -> Result<()> {
        let Some(generations) = &delta.snapshot_generations else {
            return self.apply_objects(delta);
        };
        let others = self.objects().filter(|&object| delta.get(object).is_none()).map(|object| (object, None));
        let others: Vec<_> = others.collect();
        if others.is_empty() {
            self.apply_objects(delta)?;
        } else {
            let complete = Delta::new(delta.objects.iter().cloned().chain(others));
            self.apply_objects(&Delta { snapshot_generations: delta.snapshot_generations.clone(), ..complete })?;
        }
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
