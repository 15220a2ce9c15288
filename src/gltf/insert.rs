//! Adds a complete plan to a scene.

use std::collections::BTreeMap;

use super::plan::{ImportPlan, NodeContent, PlannedCore, PlannedNode};
use super::{Document, ImportReport, ImportedNode};
use crate::Result;
use crate::graph::{Core, CoreKey, CoreSource, GeometryKey, MaterialKey, NodeKey, Scene, TextureKey, Transform};

/// The assets that were added to the scene so far, in the order of the plan.
#[derive(Default)]
struct AddedAssets {
    textures: Vec<TextureKey>,
    materials: Vec<MaterialKey>,
    geometries: Vec<GeometryKey>,
}

impl ImportPlan {
    /// Adds everything below `parent`. O(nodes + geometry, to check it).
    ///
    /// # Errors
    /// [`Error::StaleKey`](crate::Error::StaleKey) for the parent, and
    /// [`Error::Cancelled`](crate::Error::Cancelled); everything else was checked by the plan. Whatever
    /// the error, everything that was added is removed again.
    pub(super) fn insert(mut self, document: &Document, scene: &mut Scene, parent: NodeKey) -> Result<ImportReport> {
        // Add everything below one root, so that a failed import can remove all nodes at once.
        let root = scene.add(parent, Transform::IDENTITY)?;
        let mut added = AddedAssets::default();
        match self.insert_below(document, scene, root, &mut added) {
            Ok(report) => Ok(report),
            Err(error) => {
                scene.remove(root)?;
                // The assets that no node of the import uses yet.
                scene.remove_unused_among(&added.geometries, &added.materials, &added.textures);
                Err(error)
            }
        }
    }

    fn insert_below(
        &mut self,
        document: &Document,
        scene: &mut Scene,
        root: NodeKey,
        added: &mut AddedAssets,
    ) -> Result<ImportReport> {
        // 1. The assets.
        scene.set_name(root, std::mem::take(&mut self.name))?;
        let mut report = self.empty_report(document, root);
        self.insert_assets(document, scene, added)?;

        // 2. The nodes, parents first. The first node with a shared core adds it, the others refer to its key.
        let mut cores: Vec<Option<CoreKey>> = vec![None; self.cores.len()];
        let mut keys = Vec::with_capacity(self.nodes.len());
        for node in &self.nodes {
            document.cancel.check()?;
            let source: CoreSource = match node.content {
                NodeContent::Transform(transform) => transform.into(),
                NodeContent::Core(core) => match (cores[core], self.cores[core]) {
                    (Some(key), _) => key.into(),
                    (None, PlannedCore::Camera(camera, _)) => camera.into(),
                    (None, PlannedCore::Light(light, _)) => light.into(),
                    (None, PlannedCore::Geometry { geometry, material }) => {
                        Core::Geometry { geometry: added.geometries[geometry], material: added.materials[material] }
                            .into()
                    }
                },
            };
            // Add the node below its parent, which was added before it.
            let key = scene.add(node.parent.map_or(root, |parent| keys[parent]), source)?;
            keys.push(key);
            // Keep the key of the core for the other nodes that share it.
            if let NodeContent::Core(core) = node.content {
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

    /// Adds the assets, and records each key at once, so that a failed import can remove them.
    fn insert_assets(&mut self, document: &Document, scene: &mut Scene, added: &mut AddedAssets) -> Result<()> {
        for texture in self.textures.drain(..) {
            document.cancel.check()?;
            added.textures.push(scene.add_texture(texture)?);
        }
        for material in self.materials.drain(..) {
            added.materials.push(scene.add_material(material.resolve_textures(&added.textures))?);
        }
        for geometry in self.geometries.drain(..) {
            document.cancel.check()?;
            added.geometries.push(scene.add_geometry(geometry)?);
        }
        Ok(())
    }

    fn empty_report(&mut self, document: &Document, root: NodeKey) -> ImportReport {
        // Count the assets while the plan still has them; the root counts as a node too.
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
            unlisted_warnings: self.warnings.unlisted(),
            warnings: std::mem::take(&mut self.warnings.list),
            names: BTreeMap::new(),
        }
    }

    fn record(&self, node: &PlannedNode, key: NodeKey, report: &mut ImportReport) {
        // Record a node of the file by its index and its name. The first node of a name keeps it.
        if let Some(file_node) = node.file_node {
            report.nodes[file_node] = Some(key);
            if !node.name.is_empty() {
                report.names.entry(node.name.clone()).or_insert(key);
            }
        }
        // List cameras and lights.
        let NodeContent::Core(core) = node.content else { return };
        let (list, index) = match self.cores[core] {
            PlannedCore::Camera(_, index) => (&mut report.cameras, index),
            PlannedCore::Light(_, index) => (&mut report.lights, index),
            PlannedCore::Geometry { .. } => return,
        };
        // One without a name of its own has that of its node in the file, which is its parent.
        let parent_name = || node.parent.map(|parent| self.nodes[parent].name.clone()).unwrap_or_default();
        let name = if node.name.is_empty() { parent_name() } else { node.name.clone() };
        list.push(ImportedNode { name, index, node: key });
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use glam::Vec3;

    use super::super::{Budget, Buffers, ExternalFiles, ImportOptions, Warnings};
    use super::*;
    use crate::graph::{Camera, Geometry, Texture};

    /// A step of the insertion, and a change of the plan that makes it fail.
    type Break = (&'static str, fn(&mut ImportPlan));

    /// One triangle (of zeros) with a texture.
    const JSON: &[u8] = br#"{
        "asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], "textures": [{}],
        "accessors": [{"componentType": 5126, "type": "VEC3", "count": 3}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    }"#;

    fn triangle(corner: Vec3) -> Geometry {
        Geometry::new(vec![corner, Vec3::X, Vec3::Y], vec![[0, 1, 2]])
    }

    /// No file makes such plans, so they are broken here: each fails at a different step.
    #[test]
    fn whatever_fails_nothing_stays_and_the_caller_s_unused_assets_do() {
        let (mut budget, mut warnings) = (Budget::new(0, 0, None), Warnings::new(false));
        let document = Document::parse(JSON, Path::new("file.gltf"), &mut budget, &mut warnings).unwrap();
        let options = ImportOptions::default();
        let files = ExternalFiles::new(document.path, &options.files);
        let buffers = Buffers::load(&document, &files, None, &mut budget, &mut warnings).unwrap();
        let bad_texture =
            |plan: &mut ImportPlan| plan.textures.push(Texture { width: 1, height: 1, texels: [].into() });
        let bad_geometry = |plan: &mut ImportPlan| plan.geometries.push(triangle(Vec3::NAN));
        let bad_node = |plan: &mut ImportPlan| {
            plan.geometries.push(triangle(Vec3::ZERO));
            plan.cores.push(PlannedCore::Camera(Camera::perspective(-1.0), 0));
            let content = NodeContent::Core(plan.cores.len() - 1);
            plan.nodes.push(PlannedNode { parent: None, name: String::new(), content, visible: true, file_node: None });
        };
        let counts =
            |s: &Scene| (s.node_count(), s.core_count(), s.geometry_count(), s.material_count(), s.texture_count());

        let mut scene = Scene::new();
        let own = scene.add_geometry(triangle(Vec3::Z)).unwrap();
        let before = counts(&scene);
        let breaks: [Break; 3] = [("texture", bad_texture), ("geometry", bad_geometry), ("node", bad_node)];
        for (step, break_plan) in breaks {
            let (budget, warnings) = (Budget::new(0, 0, None), Warnings::new(false));
            let mut plan = ImportPlan::new(&document, &buffers, &files, &options, budget, warnings).unwrap();
            assert_eq!((plan.geometries.len(), plan.materials.len(), plan.textures.len()), (1, 1, 1));
            break_plan(&mut plan);
            let root = scene.root();
            assert!(plan.insert(&document, &mut scene, root).is_err(), "{step}");
            assert_eq!(counts(&scene), before, "{step}");
            scene.validate().unwrap();
        }
        assert!(scene.geometry(own).is_ok());
    }
}
