//! Adds a finished plan to a scene.

use std::collections::BTreeMap;

use super::plan::{Content, Plan, PlannedCore, PlannedNode};
use super::{Document, ImportReport, ImportedObject};
use crate::Result;
use crate::graph::{Core, CoreKey, CoreSource, GeometryKey, MaterialKey, NodeKey, Scene, Transform};

impl Plan {
    /// Adds everything below `parent`. O(nodes + geometry, to check it).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey) for the parent. Then nothing has been added; everything else was checked by the plan.
    pub(super) fn insert(mut self, document: &Document, scene: &mut Scene, parent: NodeKey) -> Result<ImportReport> {
        let root = scene.add(parent, Transform::IDENTITY)?;
        match self.insert_below(document, scene, root) {
            Ok(report) => Ok(report),
            Err(error) => {
                scene.remove(root)?;
                Err(error)
            }
        }
    }

    fn insert_below(&mut self, document: &Document, scene: &mut Scene, root: NodeKey) -> Result<ImportReport> {
        scene.set_name(root, std::mem::take(&mut self.name))?;
        let mut report = self.empty_report(document, root);
        let (geometries, materials) = self.insert_assets(scene)?;

        let mut cores: Vec<Option<CoreKey>> = vec![None; self.cores.len()];
        let mut keys = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            let source: CoreSource = match node.content {
                Content::Transform(transform) => transform.into(),
                Content::Core(core) => match (cores[core], self.cores[core]) {
                    (Some(key), _) => key.into(),
                    (None, PlannedCore::Camera(camera, _)) => camera.into(),
                    (None, PlannedCore::Light(light, _)) => light.into(),
                    (None, PlannedCore::Geometry { geometry, material }) => {
                        Core::Geometry { geometry: geometries[geometry], material: materials[material] }.into()
                    }
                },
            };
            let key = scene.add(node.parent.map_or(root, |parent| keys[parent]), source)?;
            keys.push(key);
            if let Content::Core(core) = node.content {
                cores[core] = Some(scene.core_key(key)?);
            }
            if !node.name.is_empty() {
                scene.set_name(key, &*node.name)?;
            }
            scene.set_visible(key, node.visible)?;
            self.record(node, key, &mut report);
        }
        Ok(report)
    }

    fn insert_assets(&mut self, scene: &mut Scene) -> Result<(Vec<GeometryKey>, Vec<MaterialKey>)> {
        let textures = self.textures.drain(..).map(|texture| scene.add_texture(texture)).collect::<Result<Vec<_>>>()?;
        let materials =
            self.materials.drain(..).map(|m| scene.add_material(m.finish(&textures))).collect::<Result<_>>()?;
        let geometries = self.geometries.drain(..).map(|g| scene.add_geometry(g)).collect::<Result<_>>()?;
        Ok((geometries, materials))
    }

    fn empty_report(&mut self, document: &Document, root: NodeKey) -> ImportReport {
        let mut counts = self.counts;
        counts.nodes = self.nodes.len() + 1;
        counts.geometries = self.geometries.len();
        counts.materials = self.materials.len();
        counts.textures = self.textures.len();
        ImportReport {
            root,
            nodes: vec![None; document.nodes.len()],
            cameras: Vec::new(),
            lights: Vec::new(),
            scenes: document.scenes.iter().map(|scene| scene.name.clone().unwrap_or_default()).collect(),
            scene: self.scene,
            counts,
            not_honoured: std::mem::take(&mut self.notes.list),
            names: BTreeMap::new(),
        }
    }

    fn record(&self, node: &PlannedNode, key: NodeKey, report: &mut ImportReport) {
        if let Some(file_node) = node.file_node {
            report.nodes[file_node] = Some(key);
            if !node.name.is_empty() {
                report.names.entry(node.name.clone()).or_insert(key);
            }
        }
        let Content::Core(core) = node.content else { return };
        let (list, index) = match self.cores[core] {
            PlannedCore::Camera(_, index) => (&mut report.cameras, index),
            PlannedCore::Light(_, index) => (&mut report.lights, index),
            PlannedCore::Geometry { .. } => return,
        };
        let parent_name = || node.parent.map(|parent| self.nodes[parent].name.clone()).unwrap_or_default();
        let name = if node.name.is_empty() { parent_name() } else { node.name.clone() };
        list.push(ImportedObject { name, index, node: key });
    }
}
