//! The mesh primitives of a document: checked, and turned into geometries that equal primitives share.

use std::collections::{HashMap, HashSet};

use ::gltf::json;
use glam::DAffine3;
use json::mesh::Semantic;
use json::validation::Checked::Valid;
use rayon::prelude::*;

use super::geometry::{GeometrySource, SkipReason};
use super::pose::check_joints;
use super::warnings::Warnings;
use super::{Accessors, Budget, Buffers, Document, Pose, skin};
use crate::Result;
use crate::graph::Geometry;

/// Every primitive of every mesh, and the geometries that were asked for.
pub(super) struct PrimitiveRequests {
    /// For each mesh and primitive its recipe without pose; `None` if it is not drawn.
    recipes: Vec<Vec<Option<GeometrySource>>>,
    canonical_accessor: Vec<usize>,
    /// The geometries asked for, each once, and a primitive that has it.
    requested: Vec<(GeometrySource, String)>,
    requested_index: HashMap<GeometrySource, usize>,
    /// Joint matrices of each skinned node.
    palettes: Vec<Vec<DAffine3>>,
}

/// A primitive of a mesh as one node shows it.
pub(super) struct PrimitiveUse {
    /// The index of its geometry in what [`PrimitiveRequests::build`] returns.
    pub(super) geometry: usize,
    /// The index of the primitive in its mesh.
    pub(super) primitive: usize,
    /// Its number of triangles.
    pub(super) triangle_count: usize,
    /// Which sets of texture coordinates it has.
    pub(super) has_tex_coords: [bool; 2],
}

impl PrimitiveRequests {
    /// Checks every primitive of the document, shown or not, but for the data of its accessors.
    pub(super) fn new(
        document: &Document,
        buffers: &Buffers,
        accessors: &Accessors,
        notes: &mut Warnings,
    ) -> Result<Self> {
        let same_as = accessors.canonical_indices(document, buffers);
        let mut recipes = Vec::with_capacity(document.meshes.len());
        for (m, mesh) in document.meshes.iter().enumerate() {
            let mut of_mesh = Vec::with_capacity(mesh.primitives.len());
            for (p, primitive) in mesh.primitives.iter().enumerate() {
                let pointer = pointer(m, p);
                let recipe = GeometrySource::new(document, accessors, &same_as, primitive, &pointer)?;
                of_mesh.push(recipe.map_err(|skip| note_skip(document, &skip, pointer, notes)).ok());
            }
            recipes.push(of_mesh);
        }
        Ok(Self {
            recipes,
            canonical_accessor: same_as,
            requested: Vec::new(),
            requested_index: HashMap::new(),
            palettes: Vec::new(),
        })
    }

    /// Asks for the geometries of a node's mesh, in the node's rest pose. `scene_from_node` are the matrices of all nodes.
    pub(super) fn request(
        &mut self,
        document: &Document,
        accessors: &Accessors,
        budget: &mut Budget,
        scene_from_node: &[DAffine3],
        (node, mesh): (usize, usize),
        notes: &mut Warnings,
    ) -> Result<Vec<PrimitiveUse>> {
        let palette = match document.nodes[node].skin {
            Some(skin) => {
                let matrices =
                    skin::palette(document, accessors, budget, scene_from_node, (node, skin.value()), notes)?;
                matrices.map(|matrices| {
                    self.palettes.push(matrices);
                    self.palettes.len() - 1
                })
            }
            None => None,
        };
        let weights = weights(document, node, mesh);
        let mut shown = Vec::new();
        for (p, primitive) in document.meshes[mesh].primitives.iter().enumerate() {
            // Also where nothing comes of it: nodes times primitives times targets is work, if not memory.
            let work = 1 + primitive.targets.as_ref().map_or(0, Vec::len);
            budget.charge(work, size_of::<PrimitiveUse>(), document, || pointer(mesh, p))?;
            let Some(recipe) = self.recipes[mesh][p].clone() else { continue };
            let pointer = pointer(mesh, p);
            let place = (recipe.positions(), &*pointer);
            let pose = Pose::new(document, accessors, &self.canonical_accessor, primitive, (weights, palette), place)?;
            if document.nodes[node].skin.is_some() && !pose.is_skinned() {
                notes.add(
                    document,
                    "skin",
                    format!("/nodes/{node}"),
                    "not applied: the mesh does not hang on its joints",
                );
            }
            let recipe = recipe.with_pose(pose);
            let (triangle_count, has_tex_coords) = (recipe.triangle_count(accessors), recipe.has_tex_coords());
            let geometry = match self.requested_index.get(&recipe) {
                Some(&slot) => slot,
                None => {
                    recipe.charge(document, accessors, budget, &pointer)?;
                    self.requested_index.insert(recipe.clone(), self.requested.len());
                    self.requested.push((recipe, pointer));
                    self.requested.len() - 1
                }
            };
            shown.push(PrimitiveUse { geometry, primitive: p, triangle_count, has_tex_coords });
        }
        Ok(shown)
    }

    /// Makes all geometries that were asked for, on all cores; checks the indices and joints of the others.
    pub(super) fn build(
        self,
        document: &Document,
        accessors: &Accessors,
        budget: &mut Budget,
    ) -> Result<Vec<Geometry>> {
        let made: HashSet<_> = self.requested.iter().map(|(recipe, _)| recipe.index_check_key()).collect();
        let mut checked = HashSet::new();
        for recipe in self.recipes.iter().flatten().flatten() {
            let source = recipe.index_check_key();
            if !made.contains(&source) && checked.insert(source) {
                recipe.check_indices(document, accessors, budget)?;
            }
        }
        check_all_joints(document, accessors, &self.canonical_accessor, budget)?;

        self.requested.par_iter().map(|(recipe, _)| recipe.build(document, accessors, &self.palettes)).collect()
    }
}

/// The JSON pointer of a primitive.
fn pointer(mesh: usize, primitive: usize) -> String {
    format!("/meshes/{mesh}/primitives/{primitive}")
}

fn note_skip(document: &Document, skip: &SkipReason, pointer: String, notes: &mut Warnings) {
    let (feature, effect) = match skip {
        SkipReason::NotTriangles(mode) => (*mode, "not drawn: only triangles are"),
        SkipReason::NoPositions => ("primitive without positions", "not drawn"),
        SkipReason::NoData => ("primitive without data", "not drawn: the file does not hold its data"),
        SkipReason::NoTriangles => ("primitive without a whole triangle", "not drawn"),
    };
    notes.add(document, feature, pointer, effect);
}

/// The weights of the morph targets of a node's mesh.
fn weights<'d>(document: &'d Document, node: usize, mesh: usize) -> &'d [f32] {
    let weights = document.nodes[node].weights.as_ref().or(document.meshes[mesh].weights.as_ref());
    weights.map_or(&[], Vec::as_slice)
}

/// Checks the joints of every skinned node, shown or not, triangles or not.
fn check_all_joints(document: &Document, accessors: &Accessors, same_as: &[usize], budget: &mut Budget) -> Result<()> {
    let skinned = |node: &json::Node| Some((node.mesh?.value(), document.skins[node.skin?.value()].joints.len()));
    let skinned: HashSet<(usize, usize)> = document.nodes.iter().filter_map(skinned).collect();
    let mut checked = HashSet::new();
    for (mesh, joint_count) in skinned {
        for primitive in &document.meshes[mesh].primitives {
            let joints = (0..).map_while(|set| primitive.attributes.get(&Valid(Semantic::Joints(set))));
            for joints in joints.map(|index| same_as[index.value()]) {
                if checked.insert((joints, joint_count)) {
                    check_joints(document, accessors, joints, joint_count, budget)?;
                }
            }
        }
    }
    Ok(())
}
