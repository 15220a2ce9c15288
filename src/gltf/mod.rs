//! glTF 2.0 import: a file's scene as a subtree, with its hierarchy, names and sharing.
//!
//! - Each node of the file becomes one node with a [`Transform`](crate::graph::Transform) core. Its mesh primitives,
//!   its camera and its light become child nodes, one each.
//! - A mesh that several nodes show is one core for each of its primitives, shared. Primitives that read the same data
//!   share one geometry, whatever their materials. A node with `EXT_mesh_gpu_instancing` has one transform child for
//!   each instance.
//! - Morph targets (at their default weights) and skins (in the rest pose of their joints) are applied to the geometry
//!   at import. Animations are not played. A skinned mesh is placed by its joints, whatever scales its node: where that
//!   node is scaled to zero, so that nothing below it could be seen, the mesh is a child of the import's root.
//! - Extensions supported: `EXT_mesh_gpu_instancing`, `KHR_lights_punctual`, `KHR_materials_emissive_strength`,
//!   `KHR_materials_ior`, `KHR_materials_transmission`, `KHR_materials_unlit`, `KHR_materials_volume`,
//!   `KHR_mesh_quantization`, `KHR_node_visibility`, `KHR_texture_transform`. A file that requires another one is
//!   refused. Other extensions and features are ignored and listed in the [`ImportReport`].
//! - Of `KHR_materials_volume` the thickness decides whether a transmissive surface bounds a solid or is a thin wall;
//!   light passes through the solid without loss. Without that extension the specification has thin walls only, of
//!   which a glass ball would be a soap bubble: [`ImportOptions::wall`] says what is taken instead, by default what the
//!   geometry looks like, with a note in the report.
//!
//! # Malformed and hostile files
//!
//! No file makes an import panic, hang, overflow the stack, or allocate more than its size justifies. All that an
//! import makes of a file counts together: parsed JSON, nodes, geometry, images, notes, and what is added to the scene.
//! It is at most 48 MiB (and 256 MiB more for images), and 80 times the JSON text, and 256 times all other bytes read
//! (binary chunk, buffers, images), or [`ImportOptions::memory_limit`] if that is less. Not counted are the bytes of
//! the files themselves, which are in memory once, and what images take while they are decoded: up to twice what is
//! counted for them. External files are read only where [`ImportOptions::files`] allows it: by default in the file's
//! own folder.
//!
//! A file whose node tree, indices, lengths or numbers are invalid is refused: the error names the object by its JSON
//! pointer, and the cause as a [`GltfFault`].
//!
//! Errors that have one reading are corrected, and a broken part costs that part and not the file; each is reported as
//! a warning of kind [`WarningKind::Fault`], and [`ImportOptions::strict`] refuses all of them:
//! - A factor of 1.2 becomes 1. Integer colours are read as normalized. NUL bytes after the JSON are dropped, and so is
//!   white space in base64, which may have the letters of URLs.
//! - A node that a scene lists although it is another's child is a root of that scene, with its own transform alone,
//!   and not shown again below its parent (as in three.js).
//! - A normal that is zero or not finite is computed from the triangles around it, or all of them are left out, as if
//!   the mesh had none, where none is a direction.
//! - A vertex whose weights are all zero hangs on its first joint; a joint that is out of range is ignored where its
//!   weight is zero.
//! - A spot light without cone has the one that is the default. A camera or light below a scale of zero is left out.
//! - A broken camera, light, material extension, or stream of normals, texture coordinates or colours is left out. An
//!   image that cannot be decoded becomes a magenta checkerboard.
//!
//! What is not guaranteed: that a file which imports is valid. Use the glTF validator for that.

mod accessor;
mod budget;
mod buffers;
mod camera;
mod container;
mod document;
mod fault;
mod files;
mod format;
mod geometry;
mod insert;
mod instancing;
mod json_cost;
mod light;
mod material;
mod node_forest;
mod normals;
mod plan;
mod pose;
mod primitives;
mod printable;
mod references;
mod report;
mod schema;
mod skin;
mod texture;
mod topology;
mod uri;
mod walls;
mod warnings;

use std::path::Path;

pub use fault::{
    AccessorFault, BufferFault, ContainerFault, FileRule, GltfFault, HierarchyFault, InstancingFault, PrimitiveFault,
    SkinFault, TransformFault, UriFault,
};
pub use files::{FilePolicy, FileRequest, FileResolver};
pub use report::{ImportCounts, ImportReport, ImportWarning, ImportedNode, UnlistedWarnings, WarningKind};

use accessor::Accessors;
use budget::Budget;
use buffers::Buffers;
use container::Container;
use document::Document;
use files::ExternalFiles;
use node_forest::NodeForest;
use plan::ImportPlan;
use pose::Pose;
pub(crate) use printable::{MAX_MESSAGE, printable};
use warnings::Warnings;

use crate::graph::{NodeKey, Scene, WallKind};
use crate::{Cancel, Error, Result};

/// What to import.
///
/// ```
/// use ropewalk::gltf::{ImportOptions, SceneSelector};
///
/// let options = ImportOptions::default().with_scene(SceneSelector::Index(1));
/// assert_eq!(options.scene, Some(SceneSelector::Index(1)));
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct ImportOptions {
    /// Which of the file's scenes. By default (`None`) the file's default scene, or else its first; all nodes, if the
    /// file has no scene.
    pub scene: Option<SceneSelector>,
    /// What the surfaces of a transmissive material without `KHR_materials_volume` bound. By default
    /// ([`WallKind::Auto`]) each geometry is judged by its shape, and the report says how, as
    /// [`WarningKind::Guess`]; `Thin` is what the extensions say to the letter.
    pub wall: WallKind,
    /// Which external files, buffers and images, may be read. By default those in the glTF file's own folder.
    pub files: FilePolicy,
    /// The most memory that the import may take, in bytes, if that is less than the file's size justifies: see
    /// [the module](self). An import that would need more fails with [`GltfFault::Budget`]. By default (`None`) the
    /// file's size alone decides.
    pub memory_limit: Option<u64>,
    /// The token by which another thread stops the import; `None`, the default, for none.
    pub cancel: Option<Cancel>,
    /// Whether the import fails where it would otherwise correct an error of the file that has one reading, or leave
    /// out a broken part: all that a note of kind [`WarningKind::Fault`] is about. `false` by default.
    pub strict: bool,
}

impl ImportOptions {
    /// The same options for one of the file's scenes; for `None`, the default scene.
    #[must_use]
    pub fn with_scene(mut self, scene: impl Into<Option<SceneSelector>>) -> Self {
        self.scene = scene.into();
        self
    }

    /// The same options for transmissive surfaces of which the file does not say what they bound.
    #[must_use]
    pub fn with_wall(self, wall: WallKind) -> Self {
        Self { wall, ..self }
    }

    /// The same options with another rule for external files.
    #[must_use]
    pub fn with_files(mut self, files: FilePolicy) -> Self {
        self.files = files;
        self
    }

    /// The same options with a limit of memory, in bytes; for `None`, the file's size alone decides.
    #[must_use]
    pub fn with_memory_limit(mut self, bytes: impl Into<Option<u64>>) -> Self {
        self.memory_limit = bytes.into();
        self
    }

    /// The same options with a token that stops the import.
    #[must_use]
    pub fn with_cancel(mut self, cancel: impl Into<Option<Cancel>>) -> Self {
        self.cancel = cancel.into();
        self
    }

    /// The same options, with errors refused that are otherwise corrected.
    #[must_use]
    pub fn with_strict(mut self, strict: bool) -> Self {
        self.strict = strict;
        self
    }
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
/// The file and its images are read and decoded on all cores, everything is checked, and only then the scene is
/// changed: a failed import leaves it as it was.
///
/// # Errors
/// - [`Error::Io`]: the file cannot be read, or is not a regular file.
/// - [`Error::Gltf`]: it is not glTF 2.0, breaks the specification, is damaged, or its external buffers cannot be read;
///   with the object and a [`GltfFault`].
/// - [`Error::UnsupportedExtension`]: it requires an extension that is not supported, such as Draco compression.
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
/// assert_eq!(scene.world_from_local(arm)?.translation.to_array(), [1.0, 2.0, 3.0]);
/// assert!(import.warnings.is_empty());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn import(path: impl AsRef<Path>, scene: &mut Scene, parent: NodeKey) -> Result<ImportReport> {
    import_with(path, &ImportOptions::default(), scene, parent)
}

/// As [`import`], with options.
///
/// # Errors
/// As [`import`], [`Error::Gltf`] if there is no such scene in the file, and [`Error::Cancelled`] if the token has
/// stopped it.
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

/// As [`import_with`], from the bytes of a file. `path` is its name in messages, and external files are looked for from
/// its folder on; it is not read itself. If there is no such folder, choose [`ImportOptions::files`].
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
    // Split the file into its parts, check the JSON, and read the buffers.
    let mut warnings = Warnings::new(options.strict);
    let container = Container::parse(bytes, path, &mut warnings)?;
    let json_bytes = container.json.len() as u64;
    let mut budget = Budget::new(json_bytes, bytes.len() as u64 - json_bytes, options.memory_limit);
    let mut document = Document::parse(container.json, path, &mut budget, &mut warnings)?;
    document.cancel = options.cancel.clone().unwrap_or_default();
    document.cancel.check()?;
    let files = ExternalFiles::new(path, &options.files);
    let buffers = Buffers::load(&document, &files, container.bin, &mut budget, &mut warnings)?;
    // Plan the whole import before the scene is changed.
    ImportPlan::new(&document, &buffers, &files, options, budget, warnings)?.insert(&document, scene, parent)
}

/// The error about the object of a file at a JSON pointer (RFC 6901); the empty pointer is the whole file.
fn error_at(path: &Path, pointer: impl Into<String>, cause: impl Into<GltfFault>) -> Error {
    Error::Gltf { path: path.into(), pointer: pointer.into(), cause: cause.into() }
}
