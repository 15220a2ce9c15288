//! glTF 2.0 import: a file's scene as a subtree, with its hierarchy, names and sharing.
//!
//! - Each node of the file becomes one node with a [`Transform`](crate::graph::Transform) core. What hangs on it becomes child nodes: one for each
//!   primitive of its mesh, one for its camera, one for its light.
//! - A mesh that several nodes show is one core for each of its primitives, shared. Primitives that read the same data share one
//!   geometry, whatever their materials. A node with `EXT_mesh_gpu_instancing` has one transform child for each instance.
//! - Morph targets and skins are applied once, as the file's nodes stand. Animations are not played.
//! - Extensions honoured: `EXT_mesh_gpu_instancing`, `KHR_lights_punctual`, `KHR_materials_emissive_strength`, `KHR_materials_ior`,
//!   `KHR_materials_transmission`, `KHR_materials_unlit`, `KHR_mesh_quantization`, `KHR_node_visibility`, `KHR_texture_transform`.
//!   A file that requires another one is refused. Everything else that is met and not honoured is listed in the [`ImportReport`].
//!
//! # Malformed and hostile files
//!
//! No file makes an import panic, hang, overflow the stack, or allocate more than its size justifies: for geometry and nodes 256 times the
//! size, and 16 MiB; for images 64 times, and 256 MiB, and up to three times that while they are decoded; for the parsed JSON at worst
//! some hundred times its text. Whatever breaks the tree, an index, a length or a number is an error that names the object by its JSON
//! pointer. What does no harm is put right and reported: a factor of 1.2 becomes 1, an image that does not decode a
//! magenta checkerboard. What is not guaranteed: that a file which imports is valid. Use the glTF validator for that.

mod accessor;
mod budget;
mod buffers;
mod camera;
mod container;
mod document;
mod format;
mod geometry;
mod insert;
mod instancing;
mod light;
mod material;
mod node_forest;
mod normals;
mod plan;
mod pose;
mod primitives;
mod references;
mod report;
mod skin;
mod texture;
mod topology;
mod uri;
mod warnings;

use std::path::Path;

pub use report::{ImportCounts, ImportReport, ImportWarning, ImportedNode};

use accessor::Accessors;
use budget::Budget;
use buffers::Buffers;
use container::Container;
use document::Document;
use node_forest::NodeForest;
use plan::ImportPlan;
use pose::Pose;

use crate::graph::{NodeKey, Scene};
use crate::{Error, Result};

/// What to import.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ImportOptions {
    /// Which of the file's scenes. By default the file's default scene, or else its first; all nodes, if the file has no scene.
    pub scene: Option<SceneSelector>,
}

/// One of a file's scenes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SceneSelector {
    /// By its index in the file.
    Index(usize),
    /// By its name: the first that has it.
    Name(String),
}

/// Imports the default scene of a `.gltf` or `.glb` file below `parent`. O(size of the file).
///
/// The file and its images are read and decoded on all cores, everything is checked, and only then the scene is changed.
///
/// # Errors
/// The scene is as before.
/// - [`Error::Io`]: the file cannot be read, or is not a regular file.
/// - [`Error::Gltf`]: it is not glTF 2.0, breaks the specification, is damaged, or its external buffers cannot be read.
/// - [`Error::UnsupportedExtension`]: it requires an extension that is not honoured, such as Draco compression.
/// - [`Error::StaleKey`]: `parent` is not in the scene.
///
/// ```
/// use ropewalk::{Scene, gltf};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("robot.gltf");
/// std::fs::write(&path, r#"{"asset": {"version": "2.0"}, "nodes": [{"name": "arm", "translation": [1, 2, 3]}]}"#)?;
///
/// let mut scene = Scene::new();
/// let root = scene.root();
/// let import = gltf::import(&path, &mut scene, root)?;
/// let arm = import.node("arm").unwrap();
/// assert_eq!(scene.world(arm)?.translation.to_array(), [1.0, 2.0, 3.0]);
/// assert!(import.not_honoured.is_empty());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn import(path: impl AsRef<Path>, scene: &mut Scene, parent: NodeKey) -> Result<ImportReport> {
    import_with(path, &ImportOptions::default(), scene, parent)
}

/// As [`import`], with options.
///
/// # Errors
/// As [`import`], and [`Error::Gltf`] if there is no such scene in the file.
pub fn import_with(
    path: impl AsRef<Path>,
    options: &ImportOptions,
    scene: &mut Scene,
    parent: NodeKey,
) -> Result<ImportReport> {
    let path = path.as_ref();
    let bytes = uri::read_file(path, u64::MAX).map_err(|error| Error::io(path, error))?;
    import_from_slice(&bytes, path, options, scene, parent)
}

/// As [`import_with`], from the bytes of a file. `path` is its name in messages, and where its external files are looked for; it is not read.
///
/// # Errors
/// As [`import_with`].
pub fn import_from_slice(
    bytes: &[u8],
    path: &Path,
    options: &ImportOptions,
    scene: &mut Scene,
    parent: NodeKey,
) -> Result<ImportReport> {
    let container = Container::parse(bytes, path)?;
    let document = Document::parse(container.json, path)?;
    let buffers = Buffers::load(&document, container.bin)?;
    let bytes_read = bytes.len() as u64 + buffers.external_bytes;
    ImportPlan::new(&document, &buffers, options, bytes_read)?.insert(&document, scene, parent)
}

/// An error about an object of a file, by its JSON pointer; the empty pointer is the file itself.
fn error_at(path: &Path, object: impl Into<String>, cause: impl Into<String>) -> Error {
    let mut object = object.into();
    if object.is_empty() {
        object = "the file".into();
    }
    Error::Gltf { path: path.into(), object, cause: cause.into() }
}
