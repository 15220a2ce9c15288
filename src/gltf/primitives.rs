//! The mesh primitives of a document: checked, and turned into geometries that equal primitives share.

use std::collections::{HashMap, HashSet};

use ::gltf::json;
use glam::DAffine3;
use json::mesh::Semantic;
use json::validation::Checked::Valid;
use rayon::prelude::*;

use super::geometry::{Recipe, Skip};
use super::notes::Notes;
use super::pose::check_joints;
use super::{Accessors, Budget, Buffers, Document, Pose, skin};
use crate::Result;
use crate::graph::Geometry;

/// Every primitive of every mesh, and the geometries that were asked for.
pub(super) struct Primitives {
    /// For each mesh and primitive its recipe without pose; `None` if it is not drawn.
    recipes: Vec<Vec<Option<Recipe>>>,
    same_as: Vec<usize>,
    /// The geometries asked for, each once, and a primitive that has it.
    wanted: Vec<(Recipe, String)>,
    slots: HashMap<Recipe, usize>,
    /// Joint matrices of each skinned node.
    palettes: Vec<Vec<DAffine3>>,
}

/// A primitive of a mesh as one node shows it.
pub(super) struct Shown {
    /// The index of its geometry in what [`Primitives::make`] returns.
    pub(super) geometry: usize,
    /// The index of the primitive in its mesh.
    pub(super) primitive: usize,
    /// Its number of triangles.
    pub(super) triangle_count: usize,
    /// Which sets of texture coordinates it has.
    pub(super) has_tex_coords: [bool; 2],
}

impl Primitives {
    /// Checks every primitive of the document, shown or not, but for the data of its accessors.
    pub(super) fn new(
        document: &Document,
        buffers: &Buffers,
        accessors: &Accessors,
        notes: &mut Notes,
    ) -> Result<Self> {
        let same_as = accessors.same_as(document, buffers);
        let mut recipes = Vec::with_capacity(document.meshes.len());
        for (m, mesh) in document.meshes.iter().enumerate() {
            let mut of_mesh = Vec::with_capacity(mesh.primitives.len());
            for (p, primitive) in mesh.primitives.iter().enumerate() {
                let pointer = pointer(m, p);
                let recipe = Recipe::new(document, accessors, &same_as, primitive, &pointer)?;
                of_mesh.push(recipe.map_err(|skip| note_skip(document, &skip, pointer, notes)).ok());
            }
            recipes.push(of_mesh);
        }
        Ok(Self { recipes, same_as, wanted: Vec::new(), slots: HashMap::new(), palettes: Vec::new() })
    }

    /// Asks for the geometries of a node's mesh, in the node's rest pose. `scene_from_node` are the matrices of all nodes.
    pub(super) fn request(
        &mut self,
        document: &Document,
        accessors: &Accessors,
        budget: &mut Budget,
        scene_from_node: &[DAffine3],
        (node, mesh): (usize, usize),
        notes: &mut Notes,
    ) -> Result<Vec<Shown>> {
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
            budget.charge(work, size_of::<Shown>(), document, || pointer(mesh, p))?;
            let Some(recipe) = self.recipes[mesh][p].clone() else { continue };
            let pointer = pointer(mesh, p);
            let place = (recipe.positions(), &*pointer);
            let pose = Pose::new(document, accessors, &self.same_as, primitive, (weights, palette), place)?;
            if document.nodes[node].skin.is_some() && !pose.is_skinned() {
                notes.add(
                    document,
                    "skin",
                    format!("/nodes/{node}"),
                    "not applied: the mesh does not hang on its joints",
                );
            }
            let recipe = recipe.posed(pose);
            let (triangle_count, has_tex_coords) = (recipe.triangle_count(accessors), recipe.has_tex_coords());
            let geometry = match self.slots.get(&recipe) {
                Some(&slot) => slot,
                None => {
                    recipe.charge(document, accessors, budget, &pointer)?;
                    self.slots.insert(recipe.clone(), self.wanted.len());
                    self.wanted.push((recipe, pointer));
                    self.wanted.len() - 1
                }
            };
            shown.push(Shown { geometry, primitive: p, triangle_count, has_tex_coords });
        }
        Ok(shown)
    }

    /// Makes all geometries that were asked for, on all cores; checks the indices and joints of the others.
    pub(super) fn make(self, document: &Document, accessors: &Accessors, budget: &mut Budget) -> Result<Vec<Geometry>> {
        let made: HashSet<_> = self.wanted.iter().map(|(recipe, _)| recipe.index_source()).collect();
        let mut checked = HashSet::new();
        for recipe in self.recipes.iter().flatten().flatten() {
            let source = recipe.index_source();
            if !made.contains(&source) && checked.insert(source) {
                recipe.check_indices(document, accessors, budget)?;
            }
        }
        check_all_joints(document, accessors, &self.same_as, budget)?;

        self.wanted.par_iter().map(|(recipe, _)| recipe.make(document, accessors, &self.palettes)).collect()
    }
}

/// The JSON pointer of a primitive.
fn pointer(mesh: usize, primitive: usize) -> String {
    format!("/meshes/{mesh}/primitives/{primitive}")
}

fn note_skip(document: &Document, skip: &Skip, pointer: String, notes: &mut Notes) {
    let (feature, effect) = match skip {
        Skip::NotTriangles(mode) => (*mode, "not drawn: only triangles are"),
        Skip::NoPositions => ("primitive without positions", "not drawn"),
        Skip::NoData => ("primitive without data", "not drawn: the file does not hold its data"),
        Skip::NoTriangles => ("primitive without a whole triangle", "not drawn"),
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
