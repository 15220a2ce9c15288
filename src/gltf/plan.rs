//! Everything an import will add to a scene, complete before the scene is touched: so an import that fails has changed nothing.

use std::collections::HashMap;

use ::gltf::json::Index;
use serde_json::Value;

use super::material::{MaterialConverter, PlannedMaterial};
use super::node_forest::children;
use super::primitives::{PrimitiveRequests, PrimitiveUse};
use super::texture::ImageRequests;
use super::warnings::Warnings;
use super::{
    Accessors, Budget, Buffers, Document, ImportCounts, ImportOptions, SceneSelector, camera, instancing, light,
};
use crate::Result;
use crate::graph::{Camera, Geometry, Light, Texture, Transform};

/// The memory that one node takes in the scene, roughly.
const BYTES_PER_NODE: usize = 512;

/// What an import will add, in the order of addition.
pub(super) struct ImportPlan {
    /// The name of the root node.
    pub(super) name: String,
    /// The index of the glTF scene.
    pub(super) scene: Option<usize>,
    /// Parents before children.
    pub(super) nodes: Vec<PlannedNode>,
    pub(super) cores: Vec<PlannedCore>,
    pub(super) geometries: Vec<Geometry>,
    pub(super) materials: Vec<PlannedMaterial>,
    pub(super) textures: Vec<Texture>,
    pub(super) counts: ImportCounts,
    pub(super) notes: Warnings,
}

/// A node to be added.
pub(super) struct PlannedNode {
    /// An earlier node; `None` for the import's root.
    pub(super) parent: Option<usize>,
    pub(super) name: String,
    pub(super) content: NodeContent,
    pub(super) visible: bool,
    /// The index of the node in the file, for a node of the file.
    pub(super) file_node: Option<usize>,
}

/// What a node is.
#[derive(Clone, Copy)]
pub(super) enum NodeContent {
    /// A transform of its own.
    Transform(Transform),
    /// One of [`ImportPlan::cores`], which other nodes may share.
    Core(usize),
}

/// A core that nodes share.
#[derive(Clone, Copy)]
pub(super) enum PlannedCore {
    /// Indices into [`ImportPlan::geometries`] and [`ImportPlan::materials`].
    Geometry { geometry: usize, material: usize },
    /// A camera and its index in the file.
    Camera(Camera, usize),
    /// A light and its index in the file.
    Light(Light, usize),
}

/// What makes two nodes share a core.
#[derive(PartialEq, Eq, Hash)]
enum CoreIdentity {
    Primitive { mesh: usize, primitive: usize, geometry: usize },
    Camera(usize),
    Light(usize),
}

impl ImportPlan {
    /// Plans the import of a document. O(data used).
    pub(super) fn new(
        document: &Document,
        buffers: &Buffers,
        options: &ImportOptions,
        bytes_read: u64,
    ) -> Result<Self> {
        let mut budget = Budget::new(bytes_read);
        let mut notes = Warnings::of(document);
        let accessors = Accessors::new(document, buffers, &mut budget)?;
        let primitives = PrimitiveRequests::new(document, buffers, &accessors, &mut notes)?;

        let scene = choose_scene(document, options)?;
        let mut planner = Planner {
            document,
            accessors: &accessors,
            primitives,
            images: ImageRequests::default(),
            scene_from_node: document.hierarchy.scene_from_node(&document.transforms),
            budget,
            notes,
            nodes: Vec::new(),
            cores: Vec::new(),
            core_slots: HashMap::new(),
            materials: Vec::new(),
            material_slots: HashMap::new(),
            mesh_triangles: HashMap::new(),
            counts: ImportCounts::default(),
        };
        planner.plan_nodes(scene)?;

        let Planner {
            primitives,
            images,
            mut budget,
            mut notes,
            nodes,
            cores,
            materials,
            mesh_triangles,
            mut counts,
            ..
        } = planner;
        let geometries = primitives.build(document, &accessors, &mut budget)?;
        let textures = images.decode(document, buffers, bytes_read, &mut notes)?;
        counts.mesh_triangles = mesh_triangles.values().sum();
        counts.geometry_triangles = geometries.iter().map(|g| g.indices.len() as u64).sum();
        let name = scene.and_then(|s| document.scenes[s].name.clone()).filter(|name| !name.is_empty());
        let name = name.or_else(|| Some(document.path.file_stem()?.to_string_lossy().into_owned())).unwrap_or_default();
        Ok(Self { name, scene, nodes, cores, geometries, materials, textures, counts, notes })
    }
}

/// The scene asked for, else the default scene, else the first; `None` if the file has none.
fn choose_scene(document: &Document, options: &ImportOptions) -> Result<Option<usize>> {
    let count = document.scenes.len();
    match &options.scene {
        Some(SceneSelector::Index(index)) if *index < count => Ok(Some(*index)),
        Some(SceneSelector::Index(index)) => {
            Err(document.fault("/scenes", format!("there is no scene {index}: there are {count}")))
        }
        Some(SceneSelector::Name(name)) => {
            let found = document.scenes.iter().position(|scene| scene.name.as_ref() == Some(name));
            let names = || document.scenes.iter().filter_map(|s| s.name.as_deref()).collect::<Vec<_>>().join(", ");
            let missing = || {
                let known = format!("there are {count}, with the names: {}", names());
                document.fault("/scenes", format!("there is no scene \"{name}\"; {known}"))
            };
            found.map(Some).ok_or_else(missing)
        }
        None => {
            let default = document.value.get("scene").and_then(Value::as_u64).map(|scene| scene as usize);
            Ok(default.or((count > 0).then_some(0)))
        }
    }
}

/// The plan in the making.
struct Planner<'a, 'd> {
    document: &'d Document<'d>,
    accessors: &'a Accessors<'a>,
    primitives: PrimitiveRequests,
    images: ImageRequests<'d>,
    scene_from_node: Vec<glam::DAffine3>,
    budget: Budget,
    notes: Warnings,
    nodes: Vec<PlannedNode>,
    cores: Vec<PlannedCore>,
    core_slots: HashMap<CoreIdentity, usize>,
    materials: Vec<PlannedMaterial>,
    /// By the material's index in the file; `None` is the default material.
    material_slots: HashMap<Option<usize>, usize>,
    /// Triangles of each mesh that is shown.
    mesh_triangles: HashMap<usize, u64>,
    counts: ImportCounts,
}

impl Planner<'_, '_> {
    /// Plans the nodes of a glTF scene, in preorder.
    fn plan_nodes(&mut self, scene: Option<usize>) -> Result<()> {
        let roots = match scene {
            Some(scene) => self.document.scenes[scene].nodes.iter().map(Index::value).collect(),
            None => self.document.hierarchy.roots(),
        };
        let mut pending: Vec<(usize, Option<usize>)> = roots.into_iter().rev().map(|node| (node, None)).collect();
        while let Some((node, parent)) = pending.pop() {
            let place = self.plan_node(node, parent)?;
            pending.extend(children(&self.document.nodes[node]).rev().map(|child| (child, Some(place))));
        }
        Ok(())
    }

    /// Plans one node of the file and what hangs on it, but not its children.
    fn plan_node(&mut self, node: usize, parent: Option<usize>) -> Result<usize> {
        let document = self.document;
        let source = &document.nodes[node];
        let transform = document.transforms[node];
        if !transform.to_affine().is_finite() {
            return Err(document.fault(format!("/nodes/{node}"), "its transform is beyond the range of numbers"));
        }
        let name = source.name.as_deref().unwrap_or_default();
        let place = self.add_node(parent, name, NodeContent::Transform(transform))?;
        self.nodes[place].file_node = Some(node);
        self.nodes[place].visible = is_visible(document, node);
        self.counts.file_nodes += 1;

        if let Some(mesh) = source.mesh {
            self.plan_mesh(node, mesh.value(), place)?;
        }
        if let Some(camera) = source.camera {
            self.plan_camera(camera.value(), place)?;
        }
        if let Some(light) = source.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref()) {
            self.plan_light(light.light.value(), place)?;
        }
        Ok(place)
    }

    /// Plans the primitives of a node's mesh: once, or once for each instance.
    fn plan_mesh(&mut self, node: usize, mesh: usize, place: usize) -> Result<()> {
        let document = self.document;
        let shown = self.primitives.request(
            document,
            self.accessors,
            &mut self.budget,
            &self.scene_from_node,
            (node, mesh),
            &mut self.notes,
        )?;
        let cores = shown.iter().map(|shown| self.geometry_core(mesh, shown)).collect::<Result<Vec<_>>>()?;
        let triangles: u64 = shown.iter().map(|shown| shown.triangle_count as u64).sum();
        self.mesh_triangles.insert(mesh, triangles);

        let instances = instancing::transforms(document, self.accessors, &mut self.budget, node, &mut self.notes)?;
        let name = document.meshes[mesh].name.as_deref().unwrap_or_default();
        match instances {
            None => {
                self.counts.scene_triangles += triangles;
                cores
                    .into_iter()
                    .try_for_each(|core| self.add_node(Some(place), name, NodeContent::Core(core)).map(drop))
            }
            Some(instances) => {
                self.counts.scene_triangles += triangles * instances.len() as u64;
                for transform in instances {
                    let instance = self.add_node(Some(place), "", NodeContent::Transform(transform))?;
                    for &core in &cores {
                        self.add_node(Some(instance), name, NodeContent::Core(core))?;
                    }
                }
                Ok(())
            }
        }
    }

    /// The core of a primitive: its geometry, and its material in the file.
    fn geometry_core(&mut self, mesh: usize, shown: &PrimitiveUse) -> Result<usize> {
        let &PrimitiveUse { geometry, primitive, .. } = shown;
        let identity = CoreIdentity::Primitive { mesh, primitive, geometry };
        if let Some(&core) = self.core_slots.get(&identity) {
            return Ok(core);
        }
        let source = &self.document.meshes[mesh].primitives[primitive];
        let material = self.material(source.material.as_ref().map(Index::value))?;
        self.warn_of_missing_attributes(mesh, shown, material);
        Ok(self.add_core(identity, PlannedCore::Geometry { geometry, material }))
    }

    fn material(&mut self, index: Option<usize>) -> Result<usize> {
        if let Some(&slot) = self.material_slots.get(&index) {
            return Ok(slot);
        }
        let material = match index {
            None => PlannedMaterial::gltf_default(),
            Some(index) => {
                let (images, notes) = (&mut self.images, &mut self.notes);
                MaterialConverter { document: self.document, images, notes }.convert(index)?
            }
        };
        self.materials.push(material);
        self.material_slots.insert(index, self.materials.len() - 1);
        Ok(self.materials.len() - 1)
    }

    fn warn_of_missing_attributes(&mut self, mesh: usize, shown: &PrimitiveUse, material: usize) {
        use ::gltf::json::{mesh::Semantic, validation::Checked::Valid};

        let material = &self.materials[material];
        let pointer = format!("/meshes/{mesh}/primitives/{}", shown.primitive);
        let attributes = &self.document.meshes[mesh].primitives[shown.primitive].attributes;
        let missing = material.tex_coords_needed().iter().zip(shown.has_tex_coords).any(|(need, has)| *need && !has);
        if missing {
            let effect = "its material's textures need them: the texel at (0, 0) is used";
            self.notes.add(self.document, "missing texture coordinates", &*pointer, effect);
        }
        if material.has_normal_texture() && attributes.contains_key(&Valid(Semantic::Tangents)) {
            let effect = "not used: tangents follow from the texture coordinates";
            self.notes.add(self.document, "TANGENT", &*pointer, effect);
        }
    }

    fn plan_camera(&mut self, camera: usize, place: usize) -> Result<()> {
        let identity = CoreIdentity::Camera(camera);
        let core = match self.core_slots.get(&identity) {
            Some(&core) => core,
            None => match camera::convert(self.document, camera, &mut self.notes)? {
                None => return Ok(()),
                Some(value) => self.add_core(identity, PlannedCore::Camera(value, camera)),
            },
        };
        let name = self.document.cameras[camera].name.as_deref().unwrap_or_default();
        self.add_node(Some(place), name, NodeContent::Core(core)).map(drop)
    }

    fn plan_light(&mut self, light: usize, place: usize) -> Result<()> {
        let identity = CoreIdentity::Light(light);
        let core = match self.core_slots.get(&identity) {
            Some(&core) => core,
            None => match light::convert(self.document, light, &mut self.notes)? {
                None => return Ok(()),
                Some(value) => self.add_core(identity, PlannedCore::Light(value, light)),
            },
        };
        let name = self.document.lights[light].name.as_deref().unwrap_or_default();
        self.add_node(Some(place), name, NodeContent::Core(core)).map(drop)
    }

    fn add_core(&mut self, identity: CoreIdentity, core: PlannedCore) -> usize {
        self.cores.push(core);
        self.core_slots.insert(identity, self.cores.len() - 1);
        self.cores.len() - 1
    }

    fn add_node(&mut self, parent: Option<usize>, name: &str, content: NodeContent) -> Result<usize> {
        self.budget.charge(1, BYTES_PER_NODE + name.len(), self.document, || "/nodes".into())?;
        self.nodes.push(PlannedNode { parent, name: name.into(), content, visible: true, file_node: None });
        Ok(self.nodes.len() - 1)
    }
}

/// `KHR_node_visibility`.
fn is_visible(document: &Document, node: usize) -> bool {
    let extension = document.node_extension(node, "KHR_node_visibility");
    extension.and_then(|e| e.get("visible")).and_then(Value::as_bool).unwrap_or(true)
}
