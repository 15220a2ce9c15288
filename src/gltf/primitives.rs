//! The mesh primitives of a document: validated, and converted to geometries that equal primitives share.

use std::collections::{HashMap, HashSet};

use ::gltf::json;
use glam::DAffine3;
use json::mesh::Semantic;
use json::validation::Checked::Valid;
use rayon::prelude::*;

use super::geometry::{GeometrySource, SkipReason};
use super::pose::check_joints;
use super::warnings::{Forgivable, Warnings};
use super::{Accessors, Budget, Buffers, Document, Pose, WarningKind, skin};
use crate::Result;
use crate::graph::Geometry;

/// The geometry sources of all primitives, and the set of geometries that nodes request.
pub(super) struct PrimitiveRequests {
    /// For each mesh and primitive its source without pose; `None` if it is not drawn.
    sources: Vec<Vec<Option<GeometrySource>>>,
    /// For each accessor the first equal one.
    canonical_accessor: Vec<usize>,
    /// The requested geometries, each once, with the JSON pointer of the first primitive that has it.
    requested: Vec<(GeometrySource, String)>,
    /// The index of each source in `requested`.
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
    /// Whether it hangs on the joints of the node's skin.
    pub(super) is_skinned: bool,
}

impl PrimitiveRequests {
    /// Validates every primitive, used or not, except for the accessor data.
    pub(super) fn new(
        document: &Document,
        buffers: &Buffers,
        accessors: &Accessors,
        warnings: &mut Warnings,
    ) -> Result<Self> {
        let canonical_accessor = accessors.canonical_indices(document, buffers);
        let mut sources = Vec::with_capacity(document.meshes.len());
        // Find the source of every primitive's geometry, and warn of primitives that are not drawn.
        for (m, mesh) in document.meshes.iter().enumerate() {
            document.cancel.check()?;
            let mut mesh_sources = Vec::with_capacity(mesh.primitives.len());
            for (p, primitive) in mesh.primitives.iter().enumerate() {
                let pointer = pointer(m, p);
                let source =
                    GeometrySource::new(document, accessors, &canonical_accessor, primitive, &pointer, warnings)?;
                mesh_sources.push(source.map_err(|reason| warn_of_skip(document, &reason, pointer, warnings)).ok());
            }
            sources.push(mesh_sources);
        }
        Ok(Self {
            sources,
            canonical_accessor,
            requested: Vec::new(),
            requested_index: HashMap::new(),
            palettes: Vec::new(),
        })
    }

    /// Requests the geometries of a node's mesh, in the node's rest pose. `scene_from_node` are the matrices of all
    /// nodes. Skinned primitives are in the space of the node or, if nothing can be seen in that, of the scene.
    pub(super) fn request(
        &mut self,
        document: &Document,
        accessors: &Accessors,
        budget: &mut Budget,
        scene_from_node: &[DAffine3],
        (node, mesh): (usize, usize),
        warnings: &mut Warnings,
    ) -> Result<Vec<PrimitiveUse>> {
        // 1. The joint matrices and the weights of the morph targets, which determine the pose.
        let palette = match document.nodes[node].skin {
            Some(skin) => {
                let matrices =
                    skin::palette(document, accessors, budget, scene_from_node, (node, skin.value()), warnings)?;
                matrices.map(|matrices| {
                    self.palettes.push(matrices);
                    self.palettes.len() - 1
                })
            }
            None => None,
        };
        let weights = weights(document, node, mesh);

        let mut uses = Vec::new();
        for (p, primitive) in document.meshes[mesh].primitives.iter().enumerate() {
            // Charge even if the primitive is skipped: this bounds the work, nodes x primitives x morph targets.
            let work = 1 + primitive.targets.as_ref().map_or(0, Vec::len);
            budget.charge(work, size_of::<PrimitiveUse>(), document, || pointer(mesh, p))?;

            // 2. The source of the primitive's geometry in that pose.
            let Some(source) = self.sources[mesh][p].clone() else { continue };
            let pointer = pointer(mesh, p);
            let positions = (source.positions(), &*pointer);
            let pose =
                Pose::new(document, accessors, &self.canonical_accessor, primitive, (weights, palette), positions)?;
            // A skin has no effect on a mesh without joints and weights.
            if document.nodes[node].skin.is_some() && !pose.is_skinned() {
                // The primitive may also lack them only in effect: the skin's own matrices are missing.
                let fallback = if palette.is_some() {
                    format!("that of node {node} is not applied: the primitive lacks JOINTS_0 or WEIGHTS_0")
                } else {
                    format!("that of node {node} is not applied: its matrices are missing")
                };
                warnings.add(document, WarningKind::Data, "skin", &*pointer, fallback);
            }
            let is_skinned = pose.is_skinned();
            let source = source.with_pose(pose);

            // 3. The geometry that was requested for an equal source, or a new one.
            let (triangle_count, has_tex_coords) = (source.triangle_count(accessors), source.has_tex_coords());
            let geometry = match self.requested_index.get(&source) {
                Some(&index) => index,
                None => {
                    // Charge now for what building it will allocate.
                    source.charge(document, accessors, budget, &pointer)?;
                    self.requested_index.insert(source.clone(), self.requested.len());
                    self.requested.push((source, pointer));
                    self.requested.len() - 1
                }
            };
            uses.push(PrimitiveUse { geometry, primitive: p, triangle_count, has_tex_coords, is_skinned });
        }
        Ok(uses)
    }

    /// Builds all requested geometries, on all cores, and checks the indices and joints of the other primitives.
    pub(super) fn build(
        self,
        document: &Document,
        accessors: &Accessors,
        budget: &mut Budget,
        warnings: &mut Warnings,
    ) -> Result<Vec<Geometry>> {
        // 1. Check what no requested geometry reads.
        let built: HashSet<_> = self.requested.iter().map(|(source, _)| source.index_check_key()).collect();
        let mut checked = HashSet::new();
        for source in self.sources.iter().flatten().flatten() {
            let key = source.index_check_key();
            if !built.contains(&key) && checked.insert(key) {
                source.check_indices(document, accessors, budget)?;
            }
        }
        check_all_joints(document, accessors, &self.canonical_accessor, budget)?;

        // 2. Build.
        let build = |(source, pointer): &(GeometrySource, String)| {
            let mut faults = Vec::new();
            let geometry = source.build(document, accessors, &self.palettes, pointer, &mut faults)?;
            Ok((geometry, faults))
        };
        let built: Vec<(Geometry, Vec<Forgivable>)> = self.requested.par_iter().map(build).collect::<Result<_>>()?;

        // 3. Forgive, in the order of the requests. Geometries that share an accessor share its faults.
        let mut told = HashSet::new();
        let mut geometries = Vec::with_capacity(built.len());
        for (geometry, faults) in built {
            for Forgivable { error, feature, fallback } in faults {
                if told.insert((error.to_string(), feature)) {
                    warnings.forgive(&document.value, feature, fallback, error)?;
                }
            }
            geometries.push(geometry);
        }
        Ok(geometries)
    }
}

/// The JSON pointer of a primitive.
fn pointer(mesh: usize, primitive: usize) -> String {
    format!("/meshes/{mesh}/primitives/{primitive}")
}

fn warn_of_skip(document: &Document, reason: &SkipReason, pointer: String, warnings: &mut Warnings) {
    use WarningKind::{Data, Feature};

    let (kind, feature, fallback) = match reason {
        SkipReason::NotTriangles(mode) => (Feature, *mode, "not drawn: only triangles are"),
        SkipReason::NoPositions => (Data, "primitive without positions", "not drawn"),
        SkipReason::NoData => (Data, "primitive without data", "not drawn: the file does not hold its data"),
        SkipReason::NoTriangles => (Data, "primitive without a whole triangle", "not drawn"),
    };
    warnings.add(document, kind, feature, pointer, fallback);
}

/// The weights of the morph targets of a node's mesh.
fn weights<'d>(document: &'d Document, node: usize, mesh: usize) -> &'d [f32] {
    let weights = document.nodes[node].weights.as_ref().or(document.meshes[mesh].weights.as_ref());
    weights.map_or(&[], Vec::as_slice)
}

/// Checks the joint indices of every skinned node, whether or not it is imported or its primitives are triangles.
fn check_all_joints(
    document: &Document,
    accessors: &Accessors,
    canonical_accessor: &[usize],
    budget: &mut Budget,
) -> Result<()> {
    let skinned = |node: &json::Node| Some((node.mesh?.value(), document.skins[node.skin?.value()].joints.len()));
    let skinned: HashSet<(usize, usize)> = document.nodes.iter().filter_map(skinned).collect();
    // Check each accessor of joints, with its weights, once for each number of joints that a skin has.
    let mut checked = HashSet::new();
    for (mesh, joint_count) in skinned {
        for primitive in &document.meshes[mesh].primitives {
            let attribute =
                |semantic| primitive.attributes.get(&Valid(semantic)).map(|index| canonical_accessor[index.value()]);
            let set = |n| Some((attribute(Semantic::Joints(n))?, attribute(Semantic::Weights(n))));
            for set in (0..).map_while(set) {
                if checked.insert((set, joint_count)) {
                    check_joints(document, accessors, set, joint_count, budget)?;
                }
            }
        }
    }
    Ok(())
}
