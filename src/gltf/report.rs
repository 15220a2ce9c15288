//! What an import has done, and what it could not do.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use crate::graph::NodeKey;

/// What an import has added to a scene, and what in the file it could not honour.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImportReport {
    /// The one node above all that was imported, named after the glTF scene or, if that has no name, the file. Removing it undoes the import.
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
    /// Every extension and feature that the file uses and the import did not honour, or not to the letter.
    pub warnings: Vec<ImportWarning>,
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

/// A camera or a light in the scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ImportedNode {
    /// Its name in the file or, if it has none, that of the file's node that it is at.
    pub name: String,
    /// Its index in the file. Several nodes may share one camera or light.
    pub index: usize,
    /// The node with the camera or light core.
    pub node: NodeKey,
}

/// How much an import has added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ImportCounts {
    /// Nodes of the file that are in the imported glTF scene.
    pub file_nodes: usize,
    /// Nodes added, with the root and those for primitives, instances, cameras and lights.
    pub nodes: usize,
    /// Geometries added. Primitives that read the same data share one.
    pub geometries: usize,
    /// Triangles stored: those of each geometry once.
    pub geometry_triangles: u64,
    /// Triangles of each mesh that is shown, once.
    pub mesh_triangles: u64,
    /// Triangles shown: those of each mesh as often as it is shown.
    pub scene_triangles: u64,
    /// Materials added.
    pub materials: usize,
    /// Textures added.
    pub textures: usize,
}

/// Something in a file that an import did not honour, or not to the letter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ImportWarning {
    /// The extension or feature: "`KHR_materials_clearcoat`", "animation".
    pub feature: String,
    /// The JSON pointer of the object that has it: "/materials/3".
    pub pointer: String,
    /// The object's name; empty if it has none.
    pub name: String,
    /// What was done instead, in words.
    pub fallback: String,
}

impl fmt::Display for ImportWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.pointer)?;
        if !self.name.is_empty() {
            write!(f, " \"{}\"", self.name)?;
        }
        write!(f, ": {}: {}", self.feature, self.fallback)
    }
}
