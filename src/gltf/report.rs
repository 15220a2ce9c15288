//! The report of an import.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::{MAX_MESSAGE, printable};
use crate::graph::NodeKey;

/// What an import has added to a scene, and what in the file is unsupported or only approximated.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ImportReport {
    /// The root node of the import, named after the glTF scene or, if that has no name, the file. Removing it undoes
    /// the import.
    pub root: NodeKey,
    /// For each node of the file its node in the scene; `None` for nodes outside of the imported glTF scene.
    pub nodes: Vec<Option<NodeKey>>,
    /// The cameras, in the order of their nodes.
    pub cameras: Vec<ImportedNode>,
    /// The lights, in the order of their nodes.
    pub lights: Vec<ImportedNode>,
    /// The names of the file's scenes, by index; empty where a scene has none.
    pub scenes: Vec<String>,
    /// The index of the scene that was imported; `None` if the file has none, so that all its nodes were.
    pub scene: Option<usize>,
    /// How much was imported.
    pub counts: ImportCounts,
    /// Extensions and features of the file that are unsupported or only approximated, and values and data that were
    /// corrected or replaced: the first thousand of each kind and feature, and at most ten thousand.
    pub warnings: Vec<ImportWarning>,
    /// How many more warnings there were than are listed, by kind and feature. Empty for nearly every file.
    pub unlisted_warnings: Vec<UnlistedWarnings>,
    /// The first node of each name.
    pub(super) names: BTreeMap<String, NodeKey>,
}

impl ImportReport {
    /// The node of the file's node with this name; the first in preorder if several have it.
    ///
    /// Meshes, cameras and lights have child nodes of their own, which this does not find.
    pub fn node(&self, name: &str) -> Option<NodeKey> {
        self.names.get(name).copied()
    }

    /// The first camera with this name.
    pub fn camera(&self, name: &str) -> Option<NodeKey> {
        self.cameras.iter().find(|camera| camera.name == name).map(|camera| camera.node)
    }

    /// The first light with this name.
    pub fn light(&self, name: &str) -> Option<NodeKey> {
        self.lights.iter().find(|light| light.name == name).map(|light| light.node)
    }
}

/// A node with a camera or a light.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct ImportedNode {
    /// The name of the camera or light in the file or, if it has none, of the file's node that refers to it.
    pub name: String,
    /// Its index in the file. Several nodes may share one camera or light.
    pub index: usize,
    /// The node with the camera or light core.
    pub node: NodeKey,
}

/// How much an import has added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct ImportCounts {
    /// Nodes of the file that are in the imported glTF scene.
    pub file_nodes: usize,
    /// Nodes added, including the root and those for primitives, instances, cameras and lights.
    pub nodes: usize,
    /// Geometries added. Primitives that read the same data share one.
    pub geometries: usize,
    /// Triangles stored: those of each geometry, once.
    pub geometry_triangles: u64,
    /// Triangles of each mesh that a node uses, once.
    pub mesh_triangles: u64,
    /// Triangles shown: those of each mesh, once for each node or instance that uses it.
    pub scene_triangles: u64,
    /// Materials added.
    pub materials: usize,
    /// Textures added.
    pub textures: usize,
}

/// Something in a file that is unsupported, only approximated, corrected or replaced.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct ImportWarning {
    /// What kind of thing it is, for filters.
    pub kind: WarningKind,
    /// The extension, feature, value or data: "`KHR_materials_clearcoat`", "animation", "metallicFactor". It is text,
    /// since it often comes from the file; for [`WarningKind::Extension`] it is exactly the extension's name (at most
    /// 80 characters of it).
    pub feature: String,
    /// The JSON pointer of the object that has it: "/materials/3".
    pub pointer: String,
    /// The object's name; empty if it has none.
    pub name: String,
    /// What was done instead, in words.
    pub fallback: String,
}

/// Warnings that are only counted, since there were so many of their kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct UnlistedWarnings {
    /// Their kind.
    pub kind: WarningKind,
    /// Their feature, as in [`ImportWarning::feature`]; empty for those of various features.
    pub feature: String,
    /// How many there are.
    pub count: usize,
}

/// What an [`ImportWarning`] is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[non_exhaustive]
pub enum WarningKind {
    /// An extension that is not supported, and was ignored.
    Extension,
    /// A feature of glTF, or of a supported extension, that is not supported or only approximated.
    Feature,
    /// A value that is valid, but cannot be used as it is.
    Value,
    /// Data that the file lacks; it was left out or replaced.
    Data,
    /// Something that the file does not say, and what was taken for it.
    Guess,
    /// An error of the file that has one reading and was corrected, or whose part alone was left out. An import with
    /// [`ImportOptions::strict`](super::ImportOptions::strict) fails instead.
    Fault,
}

impl fmt::Display for UnlistedWarnings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let feature = if self.feature.is_empty() { "various features" } else { &self.feature };
        // The name of an extension may hold anything.
        write!(f, "{} more: {}", self.count, printable(feature, MAX_MESSAGE))
    }
}

impl fmt::Display for ImportWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = if self.name.is_empty() { String::new() } else { format!(" \"{}\"", self.name) };
        let object = if self.pointer.is_empty() { "the file" } else { &self.pointer };
        // All of it may quote the file, which may hold anything.
        let text = format!("{object}{name}: {}: {}", self.feature, self.fallback);
        f.write_str(&printable(&text, MAX_MESSAGE))
    }
}
