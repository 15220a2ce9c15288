//! Everything an import will add to a scene. The plan is complete before the scene is touched, so that a failed import
//! changes nothing.

use std::collections::HashMap;

use ::gltf::json::Index;
use glam::DAffine3;
use serde_json::Value;

use super::material::{MaterialConverter, PlannedMaterial};
use super::node_forest::children;
use super::primitives::{PrimitiveRequests, PrimitiveUse};
use super::texture::ImageRequests;
use super::walls::JudgedPrimitive;
use super::warnings::Warnings;
use super::{
    Accessors, Budget, Buffers, Document, ExternalFiles, GltfFault, ImportCounts, ImportOptions, SceneSelector,
    TransformFault, WarningKind, camera, instancing, light, skin, walls,
};
use crate::Result;
use crate::graph::{Camera, Geometry, Light, Material, Texture, Transform, WallKind};
use crate::math::MappedSpace;

/// The memory that one node takes in the plan, the scene and the report, in bytes, at most.
const BYTES_PER_NODE: usize = 1024;
/// The memory that a shared core takes in the plan, besides the node that adds it to the scene.
const BYTES_PER_CORE: usize = 4 * size_of::<(CoreIdentity, Option<usize>)>() + 3 * size_of::<PlannedCore>();
/// The memory that a material takes in the plan and in the scene.
const BYTES_PER_MATERIAL: usize = 3 * (size_of::<PlannedMaterial>() + size_of::<Material>()) + 256;

/// What an import will add, in the order in which it is added.
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
    pub(super) warnings: Warnings,
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

/// The core of a planned node.
#[derive(Clone, Copy)]
pub(super) enum NodeContent {
    /// A transform, which no other node shares.
    Transform(Transform),
    /// One of [`ImportPlan::cores`], which other nodes may share.
    Core(usize),
}

/// A core that several nodes may share.
#[derive(Clone, Copy)]
pub(super) enum PlannedCore {
    /// Indices into [`ImportPlan::geometries`] and [`ImportPlan::materials`].
    Geometry { geometry: usize, material: usize },
    /// A camera and its index in the file.
    Camera(Camera, usize),
    /// A light and its index in the file.
    Light(Light, usize),
}

/// The key by which nodes share a core.
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
        files: &ExternalFiles,
        options: &ImportOptions,
        mut budget: Budget,
        mut warnings: Warnings,
    ) -> Result<Self> {
        // 1. Check accessors and primitives, whether or not they are imported.
        warnings.inspect(document);
        let accessors = Accessors::new(document, buffers, &mut budget)?;
        let primitives = PrimitiveRequests::new(document, buffers, &accessors, &mut warnings)?;

        // 2. Walk the nodes of the scene; this plans cores and materials, and requests geometries and images.
        let scene = choose_scene(document, options)?;
        let mut is_root = vec![false; document.nodes.len()];
        scene.into_iter().flat_map(|s| &document.scenes[s].nodes).for_each(|node| is_root[node.value()] = true);
        let mut planner = Planner {
            document,
            accessors: &accessors,
            primitives,
            images: ImageRequests::new(files),
            scene_from_node: document.hierarchy.scene_from_node(&document.transforms, &is_root),
            is_root,
            budget,
            warnings,
            wall: options.wall,
            walls_to_judge: Vec::new(),
            nodes: Vec::new(),
            cores: Vec::new(),
            core_indices: HashMap::new(),
            materials: Vec::new(),
            material_indices: HashMap::new(),
            mesh_triangles: HashMap::new(),
            counts: ImportCounts::default(),
        };
        planner.warnings.charge(document, &mut planner.budget)?;
        planner.plan_nodes(scene)?;

        // 3. Build the requested geometries and decode the requested images.
        let Planner {
            primitives,
            images,
            mut budget,
            mut warnings,
            walls_to_judge,
            nodes,
            cores,
            materials,
            mesh_triangles,
            mut counts,
            ..
        } = planner;
        let geometries = primitives.build(document, &accessors, &mut budget, &mut warnings)?;
        let textures = images.decode(document, buffers, &mut budget, &mut warnings)?;
        walls::report(document, &geometries, &walls_to_judge, &mut warnings);
        warnings.charge(document, &mut budget)?;

        // 4. Count, and name the root node.
        counts.mesh_triangles = mesh_triangles.values().sum();
        counts.geometry_triangles = geometries.iter().map(|g| g.indices.len() as u64).sum();
        let name = scene.and_then(|s| document.scenes[s].name.clone()).filter(|name| !name.is_empty());
        let name = name.or_else(|| Some(document.path.file_stem()?.to_string_lossy().into_owned())).unwrap_or_default();
        Ok(Self { name, scene, nodes, cores, geometries, materials, textures, counts, warnings })
    }
}

/// The requested scene, else the default scene, else the first; `None` if the file has no scene.
fn choose_scene(document: &Document, options: &ImportOptions) -> Result<Option<usize>> {
    let count = document.scenes.len();
    match &options.scene {
        // A scene that was asked for must exist.
        Some(SceneSelector::Index(index)) if *index < count => Ok(Some(*index)),
        Some(SceneSelector::Index(index)) => {
            Err(document.error_at("/scenes", GltfFault::NoSceneIndex { index: *index, count }))
        }
        Some(SceneSelector::Name(name)) => {
            let found = document.scenes.iter().position(|scene| scene.name.as_ref() == Some(name));
            let missing = || {
                let known = document.scenes.iter().filter_map(|scene| scene.name.clone()).collect();
                document.error_at("/scenes", GltfFault::NoSceneName { name: name.clone(), count, known })
            };
            found.map(Some).ok_or_else(missing)
        }
        // None was asked for: use the default scene, else the first.
        None => {
            let default = document.value.get("scene").and_then(Value::as_u64).map(|scene| scene as usize);
            Ok(default.or((count > 0).then_some(0)))
        }
    }
}

/// Builder of an import plan.
struct Planner<'a, 'd> {
    document: &'d Document<'d>,
    accessors: &'a Accessors<'a>,
    primitives: PrimitiveRequests,
    images: ImageRequests<'d>,
    /// The nodes that the imported scene lists. One that is another node's child too is not shown below that.
    is_root: Vec<bool>,
    /// The matrix from each node's space to that of the scene.
    scene_from_node: Vec<DAffine3>,
    budget: Budget,
    warnings: Warnings,
    /// What transmissive surfaces bound where the file does not say.
    wall: WallKind,
    /// Primitives of which the geometry decides that.
    walls_to_judge: Vec<JudgedPrimitive>,
    nodes: Vec<PlannedNode>,
    cores: Vec<PlannedCore>,
    /// The index of each shared core in `cores`; `None` for one that is left out.
    core_indices: HashMap<CoreIdentity, Option<usize>>,
    materials: Vec<PlannedMaterial>,
    /// The index of each material in `materials`, by its index in the file; `None` is the default material.
    material_indices: HashMap<Option<usize>, usize>,
    /// The number of triangles of each mesh that a node uses.
    mesh_triangles: HashMap<usize, u64>,
    counts: ImportCounts,
}

impl Planner<'_, '_> {
    /// Plans the nodes of a glTF scene, in preorder.
    fn plan_nodes(&mut self, scene: Option<usize>) -> Result<()> {
        // Begin at the roots of the scene, or at all roots if the file has no scene.
        let roots = match scene {
            Some(scene) => self.document.scenes[scene].nodes.iter().map(Index::value).collect(),
            None => self.document.hierarchy.roots(),
        };
        // Keep the nodes to be planned on a stack, in reverse, so that siblings keep their order.
        let mut pending: Vec<(usize, Option<usize>)> = roots.into_iter().rev().map(|node| (node, None)).collect();
        while let Some((node, parent)) = pending.pop() {
            let planned_node = self.plan_node(node, parent)?;
            let children = children(&self.document.nodes[node]).filter(|child| !self.is_root[*child]);
            pending.extend(children.rev().map(|child| (child, Some(planned_node))));
        }
        Ok(())
    }

    /// Plans one node of the file with its mesh, camera and light, without its children; returns its index in `nodes`.
    fn plan_node(&mut self, node: usize, parent: Option<usize>) -> Result<usize> {
        let document = self.document;
        document.cancel.check()?;
        let source = &document.nodes[node];
        let transform = document.transforms[node];
        // The numbers of the file are finite, but the products in a matrix can overflow.
        if !transform.to_affine().is_finite() {
            return Err(document.error_at(format!("/nodes/{node}"), GltfFault::NotFinite { what: "its transform" }));
        }
        // Add the node with its transform.
        let name = source.name.as_deref().unwrap_or_default();
        let planned_node = self.add_node(node, parent, name, NodeContent::Transform(transform))?;
        self.nodes[planned_node].file_node = Some(node);
        self.nodes[planned_node].visible = is_visible(document, node);
        self.counts.file_nodes += 1;

        // Add mesh, camera and light as its children.
        if let Some(mesh) = source.mesh {
            self.plan_mesh(node, mesh.value(), planned_node)?;
        }
        if let Some(camera) = source.camera {
            self.plan_camera(node, camera.value(), planned_node)?;
        }
        if let Some(light) = source.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref()) {
            self.plan_light(node, light.light.value(), planned_node)?;
        }
        Ok(planned_node)
    }

    /// Plans the primitives of a node's mesh: once, or once for each instance.
    fn plan_mesh(&mut self, node: usize, mesh: usize, planned_node: usize) -> Result<()> {
        let document = self.document;
        // Request the mesh's geometries, in the rest pose of this node.
        let uses = self.primitives.request(
            document,
            self.accessors,
            &mut self.budget,
            &self.scene_from_node,
            (node, mesh),
            &mut self.warnings,
        )?;
        // Find or plan the core of each primitive.
        let cores =
            uses.iter().map(|primitive_use| self.geometry_core(mesh, primitive_use)).collect::<Result<Vec<_>>>()?;
        let triangles: u64 = uses.iter().map(|primitive_use| primitive_use.triangle_count as u64).sum();
        self.mesh_triangles.insert(mesh, triangles);

        // Read the transforms of the instances, if there are any.
        let instances = instancing::transforms(document, self.accessors, &mut self.budget, node, &mut self.warnings)?;
        let name = document.meshes[mesh].name.as_deref().unwrap_or_default();
        match instances {
            // Without instances, the primitives are children of the node; except those that their joints place, if the
            // node flattens what is below it.
            None => {
                self.counts.scene_triangles += triangles;
                let flattens = skin::node_from_scene(&self.scene_from_node[node]).is_none();
                for (primitive_use, core) in uses.iter().zip(cores) {
                    if flattens && primitive_use.is_skinned {
                        let is_visible = self.is_shown(planned_node);
                        let root_child = self.add_node(node, None, name, NodeContent::Core(core))?;
                        self.nodes[root_child].visible = is_visible;
                    } else {
                        self.add_node(node, Some(planned_node), name, NodeContent::Core(core))?;
                    }
                }
                if uses.iter().any(|primitive_use| !primitive_use.is_skinned) {
                    self.warn_of_lost_area(node, &[Transform::IDENTITY], format!("/nodes/{node}"));
                }
                Ok(())
            }
            // With instances, each is a node for its transform, and below it are nodes with the shared cores.
            Some(instances) => {
                self.counts.scene_triangles += triangles * instances.len() as u64;
                self.warn_of_lost_area(node, &instances, format!("/nodes/{node}/extensions/EXT_mesh_gpu_instancing"));
                for transform in instances {
                    let instance = self.add_node(node, Some(planned_node), "", NodeContent::Transform(transform))?;
                    for &core in &cores {
                        self.add_node(node, Some(instance), name, NodeContent::Core(core))?;
                    }
                }
                Ok(())
            }
        }
    }

    /// Whether a planned node and all above it are visible.
    fn is_shown(&self, planned_node: usize) -> bool {
        let mut node_and_above = std::iter::successors(Some(planned_node), |&node| self.nodes[node].parent);
        node_and_above.all(|node| self.nodes[node].visible)
    }

    /// Warns if the mesh of a node is flattened to a line or a point, or some of its instances are.
    fn warn_of_lost_area(&mut self, node: usize, instances: &[Transform], pointer: String) {
        let world = self.scene_from_node[node].matrix3;
        let is_lost = |i: &usize| MappedSpace::of(&(world * instances[*i].to_affine().matrix3)) == MappedSpace::Line;
        let mut lost = (0..instances.len()).filter(is_lost);
        let Some(first) = lost.next() else { return };
        let fallback = match (instances.len(), lost.count()) {
            (1, _) => "is zero along at least two axes: nothing of the mesh is seen".to_owned(),
            (_, 0) => format!("of instance {first} is zero along at least two axes: nothing of it is seen"),
            (_, more) => {
                format!("of instance {first} and {more} more is zero along at least two axes: nothing of them is seen")
            }
        };
        self.warnings.add(self.document, WarningKind::Value, "scale", pointer, fallback);
    }

    /// Whether a node keeps all directions. If not, warns that its camera or light is left out.
    fn has_directions(&mut self, node: usize, what: String) -> Result<bool> {
        if MappedSpace::of(&self.scene_from_node[node].matrix3) == MappedSpace::Space {
            return Ok(true);
        }
        let error = self.document.error_at(format!("/nodes/{node}"), TransformFault::ZeroScale);
        self.warnings.leave_out(&self.document.value, what, error)?;
        Ok(false)
    }

    /// Plans the core of a primitive, its geometry and material, once; returns its index in `cores`.
    fn geometry_core(&mut self, mesh: usize, primitive_use: &PrimitiveUse) -> Result<usize> {
        let &PrimitiveUse { geometry, primitive, .. } = primitive_use;
        let identity = CoreIdentity::Primitive { mesh, primitive, geometry };
        if let Some(&Some(core)) = self.core_indices.get(&identity) {
            return Ok(core);
        }
        // Plan the primitive's material, and warn of what it needs and the primitive lacks.
        let source = &self.document.meshes[mesh].primitives[primitive];
        let material = self.material(source.material.as_ref().map(Index::value))?;
        self.warn_of_missing_attributes(mesh, primitive_use, material);
        if self.materials[material].is_judged_by_geometry() {
            self.walls_to_judge.push(JudgedPrimitive { mesh, primitive, geometry });
        }
        self.add_core(identity, PlannedCore::Geometry { geometry, material })
    }

    /// Plans a material of the file, or the default material, once; returns its index in `materials`.
    fn material(&mut self, index: Option<usize>) -> Result<usize> {
        if let Some(&slot) = self.material_indices.get(&index) {
            return Ok(slot);
        }
        let material = match index {
            None => PlannedMaterial::gltf_default(),
            Some(index) => {
                let (images, warnings) = (&mut self.images, &mut self.warnings);
                MaterialConverter { document: self.document, images, warnings, wall: self.wall }.convert(index)?
            }
        };
        self.budget.charge(1, BYTES_PER_MATERIAL, self.document, || "/materials".to_owned())?;
        self.materials.push(material);
        self.material_indices.insert(index, self.materials.len() - 1);
        Ok(self.materials.len() - 1)
    }

    fn warn_of_missing_attributes(&mut self, mesh: usize, primitive_use: &PrimitiveUse, material: usize) {
        use ::gltf::json::{mesh::Semantic, validation::Checked::Valid};

        let material = &self.materials[material];
        let pointer = format!("/meshes/{mesh}/primitives/{}", primitive_use.primitive);
        let attributes = &self.document.meshes[mesh].primitives[primitive_use.primitive].attributes;
        // Warn if a texture uses a set of texture coordinates that the primitive does not have.
        let missing =
            material.tex_coords_needed().iter().zip(primitive_use.has_tex_coords).any(|(need, has)| *need && !has);
        if missing {
            let fallback = "its material's textures need them: the texel at (0, 0) is used";
            self.warnings.add(self.document, WarningKind::Data, "missing texture coordinates", &*pointer, fallback);
        }
        // Warn if a normal texture was made for tangents of the file.
        if material.has_normal_texture() && attributes.contains_key(&Valid(Semantic::Tangents)) {
            let fallback = "not used: tangents follow from the texture coordinates";
            self.warnings.add(self.document, WarningKind::Feature, "TANGENT", &*pointer, fallback);
        }
    }

    fn plan_camera(&mut self, node: usize, camera: usize, planned_node: usize) -> Result<()> {
        if !self.has_directions(node, format!("camera {camera}"))? {
            return Ok(());
        }
        let core = self.shared_core(CoreIdentity::Camera(camera), "camera", |document, warnings| {
            Ok(camera::convert(document, camera, warnings)?.map(|value| PlannedCore::Camera(value, camera)))
        })?;
        let Some(core) = core else { return Ok(()) };
        let name = self.document.cameras[camera].as_ref().and_then(|camera| camera.name.as_deref()).unwrap_or_default();
        self.add_node(node, Some(planned_node), name, NodeContent::Core(core)).map(drop)
    }

    fn plan_light(&mut self, node: usize, light: usize, planned_node: usize) -> Result<()> {
        if !self.has_directions(node, format!("light {light}"))? {
            return Ok(());
        }
        let core = self.shared_core(CoreIdentity::Light(light), "light", |document, warnings| {
            Ok(light::convert(document, light, warnings)?.map(|value| PlannedCore::Light(value, light)))
        })?;
        let Some(core) = core else { return Ok(()) };
        let name = self.document.lights[light].as_ref().and_then(|light| light.name.as_deref()).unwrap_or_default();
        self.add_node(node, Some(planned_node), name, NodeContent::Core(core)).map(drop)
    }

    /// The core of a camera or light, which all nodes that refer to it share. `None` for one of an unknown type, and,
    /// with a warning that names `what` it is, for one that is broken.
    fn shared_core(
        &mut self,
        identity: CoreIdentity,
        what: &str,
        convert: impl FnOnce(&Document, &mut Warnings) -> Result<Option<PlannedCore>>,
    ) -> Result<Option<usize>> {
        if let Some(&core) = self.core_indices.get(&identity) {
            return Ok(core);
        }
        let core = convert(self.document, &mut self.warnings).or_else(|error| {
            self.warnings.leave_out(&self.document.value, what, error)?;
            Ok(None)
        })?;
        self.add_or_leave_out(identity, core)
    }

    /// Adds a core to the plan, which nodes can share; returns its index in `cores`.
    fn add_core(&mut self, identity: CoreIdentity, core: PlannedCore) -> Result<usize> {
        self.budget.charge(1, BYTES_PER_CORE, self.document, String::new)?;
        self.cores.push(core);
        self.core_indices.insert(identity, Some(self.cores.len() - 1));
        Ok(self.cores.len() - 1)
    }

    /// As [`add_core`](Self::add_core); `None` for one that is left out.
    fn add_or_leave_out(&mut self, identity: CoreIdentity, core: Option<PlannedCore>) -> Result<Option<usize>> {
        if let Some(core) = core {
            return self.add_core(identity, core).map(Some);
        }
        self.budget.charge(1, BYTES_PER_CORE, self.document, String::new)?;
        self.core_indices.insert(identity, None);
        Ok(None)
    }

    /// Adds a node to the plan, on behalf of a node of the file; returns its index in `nodes`.
    fn add_node(&mut self, node: usize, parent: Option<usize>, name: &str, content: NodeContent) -> Result<usize> {
        // The name is in the plan, in the scene and in the report.
        self.budget.charge(1, BYTES_PER_NODE + 3 * name.len(), self.document, || format!("/nodes/{node}"))?;
        self.nodes.push(PlannedNode { parent, name: name.into(), content, visible: true, file_node: None });
        Ok(self.nodes.len() - 1)
    }
}

/// `KHR_node_visibility`.
fn is_visible(document: &Document, node: usize) -> bool {
    let extension = document.node_extension(node, "KHR_node_visibility");
    extension.and_then(|e| e.get("visible")).and_then(Value::as_bool).unwrap_or(true)
}
