//! From a mesh primitive to a [`Geometry`].
//!
//! A [`GeometrySource`] says which accessors make a geometry, and how. Primitives with equal recipes share one geometry, however many meshes
//! they are in and whatever their materials.

use std::sync::Arc;

use ::gltf::json;
use glam::{DAffine3, Vec2, Vec3, Vec4};
use json::mesh::Semantic;
use json::validation::Checked::Valid;

use super::accessor::Selection;
use super::format::{Component, Format};
use super::topology::{Topology, compact_vertices};
use super::{Accessors, Budget, Document, Pose, normals};
use crate::Result;
use crate::graph::Geometry;

/// Which accessors make a geometry. Accessors with the same content have the same number here.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct GeometrySource {
    topology: Topology,
    indices: Option<usize>,
    positions: usize,
    normals: Option<usize>,
    tex_coords: [Option<usize>; 2],
    colors: Option<usize>,
    pose: Pose,
}

/// Why a primitive makes no geometry.
pub(super) enum SkipReason {
    /// It is made of these: "points".
    NotTriangles(&'static str),
    /// It has no positions: an extension would have to make them.
    NoPositions,
    /// Its positions make no whole triangle.
    NoTriangles,
    /// The file does not hold the data of some accessor: an extension would have to bring it.
    NoData,
}

impl GeometrySource {
    /// The recipe of a primitive, checked against its accessors' formats and lengths but not their data. `same_as` names equal accessors.
    /// `pointer` is the primitive, for messages.
    pub(super) fn new(
        document: &Document,
        accessors: &Accessors,
        same_as: &[usize],
        primitive: &json::mesh::Primitive,
        pointer: &str,
    ) -> Result<Result<Self, SkipReason>> {
        let Valid(mode) = primitive.mode else {
            return Err(document.fault(format!("{pointer}/mode"), "is no mode that glTF knows"));
        };
        let Some(topology) = Topology::of(mode) else { return Ok(Err(SkipReason::NotTriangles(mode_name(mode)))) };
        let attribute = |semantic| primitive.attributes.get(&Valid(semantic)).map(|index| same_as[index.value()]);
        let Some(positions) = attribute(Semantic::Positions) else { return Ok(Err(SkipReason::NoPositions)) };
        if !all_accessors(primitive).all(|index| accessors.get(index).has_data()) {
            return Ok(Err(SkipReason::NoData));
        }
        let recipe = Self {
            topology,
            indices: primitive.indices.map(|index| same_as[index.value()]),
            positions,
            normals: attribute(Semantic::Normals),
            tex_coords: [0, 1].map(|set| attribute(Semantic::TexCoords(set))),
            colors: attribute(Semantic::Colors(0)),
            pose: Pose::default(),
        };
        recipe.check_formats(document, accessors)?;
        recipe.check_counts(document, accessors, pointer)?;
        Ok(if recipe.triangle_count(accessors) == 0 { Err(SkipReason::NoTriangles) } else { Ok(recipe) })
    }

    /// The same recipe with morph targets and skin applied.
    pub(super) fn with_pose(self, pose: Pose) -> Self {
        Self { pose, ..self }
    }

    /// How many triangles it makes.
    pub(super) fn triangle_count(&self, accessors: &Accessors) -> usize {
        self.topology.triangle_count(self.index_count(accessors))
    }

    /// Which sets of texture coordinates it has.
    pub(super) fn has_tex_coords(&self) -> [bool; 2] {
        self.tex_coords.map(|set| set.is_some())
    }

    /// The accessor of its positions.
    pub(super) fn positions(&self) -> usize {
        self.positions
    }

    /// The accessors that decide whether its indices are in range: two recipes with equal answers need one check.
    pub(super) fn index_check_key(&self) -> Option<(usize, usize)> {
        self.indices.map(|indices| (indices, self.positions))
    }

    /// Checks the indices alone, for a primitive that nothing shows. Costs the budget and memory for the indices.
    pub(super) fn check_indices(&self, document: &Document, accessors: &Accessors, budget: &mut Budget) -> Result<()> {
        let Some(indices) = self.indices else { return Ok(()) };
        budget.charge(accessors.get(indices).count, size_of::<u32>(), document, || format!("/accessors/{indices}"))?;
        self.read_indices(document, accessors).map(drop)
    }

    /// Charges the budget for everything that [`build`](Self::build) allocates, as if it held all of it at once.
    pub(super) fn charge(
        &self,
        document: &Document,
        accessors: &Accessors,
        budget: &mut Budget,
        pointer: &str,
    ) -> Result<()> {
        let vertex_count = accessors.get(self.positions).count;
        let index_count = self.index_count(accessors);
        let triangle_size = 2 * size_of::<[u32; 3]>();
        let object = || pointer.to_owned();

        budget.charge(index_count, size_of::<u32>(), document, object)?;
        budget.charge(self.triangle_count(accessors), triangle_size, document, object)?;
        budget.charge(vertex_count.min(index_count), self.bytes_per_vertex(), document, object)?;
        // The bits and ranks of `compact_vertices`: 12 bytes for 64 vertices.
        budget.charge(vertex_count / 4, 1, document, object)
    }

    /// What [`build`](Self::build) allocates for a used vertex, at most. Every stream is there twice: as read, and as kept.
    fn bytes_per_vertex(&self) -> usize {
        let selection = size_of::<u32>();
        let positions = 2 * size_of::<Vec3>();
        let normals = self.normals.map_or(0, |_| 2 * size_of::<Vec3>() + normals::BYTES_PER_NORMAL);
        let tex_coords = self.tex_coords.iter().flatten().count() * 2 * size_of::<Vec2>();
        // RGB is read before it becomes RGBA.
        let colors = self.colors.map_or(0, |_| size_of::<Vec3>() + 2 * size_of::<Vec4>());
        selection + positions + normals + tex_coords + colors + self.pose.bytes_per_vertex()
    }

    /// Reads the accessors and makes the geometry. `palettes` are the joint matrices that the pose refers to. O(indices).
    pub(super) fn build(
        &self,
        document: &Document,
        accessors: &Accessors,
        palettes: &[Vec<DAffine3>],
    ) -> Result<Geometry> {
        // 1. Which vertices are used.
        let mut indices = self.read_indices(document, accessors)?;
        let used = compact_vertices(&mut indices, accessors.get(self.positions).count);
        let selection = used.as_deref().map_or(Selection::All, Selection::Indices);
        let triangles = self.topology.triangles(&indices);

        // 2. Their attributes.
        let mut positions: Vec<Vec3> = accessors.get(self.positions).floats(document, selection)?;
        let mut normals = self.normals.map(|n| accessors.get(n).floats::<Vec3, 3>(document, selection)).transpose()?;
        let tex_coords = |set: usize| {
            let read = |index| accessors.get(index).floats::<Vec2, 2>(document, selection);
            self.tex_coords[set].map(read).transpose()
        };
        let tex_coords = [tex_coords(0)?, tex_coords(1)?];
        let colors = self.colors.map(|index| read_colors(document, accessors, index, selection)).transpose()?;

        // 3. The rest pose.
        self.pose.apply(document, accessors, palettes, selection, &mut positions, normals.as_deref_mut())?;
        if let Some(normals) = &mut normals {
            normals::normalize(normals, &positions, &triangles);
        }
        Ok(Geometry {
            positions: positions.into(),
            indices: triangles.into(),
            normals: normals.map(Arc::from),
            tex_coords: tex_coords.map(|set| set.map(Arc::from)),
            colors: colors.map(Arc::from),
            blas_kind: None,
        })
    }

    fn index_count(&self, accessors: &Accessors) -> usize {
        accessors.get(self.indices.unwrap_or(self.positions)).count
    }

    /// The vertices in their order, each in range.
    fn read_indices(&self, document: &Document, accessors: &Accessors) -> Result<Vec<u32>> {
        let vertex_count = accessors.get(self.positions).count;
        let Some(accessor) = self.indices else {
            // check_counts has shown that this fits.
            return Ok((0..vertex_count as u32).collect());
        };
        let indices: Vec<[u32; 1]> = accessors.get(accessor).integers(document, Selection::All)?;
        let indices: Vec<u32> = bytemuck::cast_vec(indices);
        if let Some(i) = indices.iter().position(|&index| index as usize >= vertex_count) {
            let cause = format!("index {i} is {}, but there are {vertex_count} vertices", indices[i]);
            return Err(document.fault(format!("/accessors/{accessor}"), cause));
        }
        let restart = accessors.get(accessor).largest_integer();
        if let Some(i) = indices.iter().position(|&index| Some(index) == restart) {
            let cause =
                format!("index {i} is {}, which restarts primitives in some renderers: glTF forbids it", indices[i]);
            return Err(document.fault(format!("/accessors/{accessor}"), cause));
        }
        Ok(indices)
    }

    fn check_formats(&self, document: &Document, accessors: &Accessors) -> Result<()> {
        let require = |index: Option<usize>, role: &str, expected: &str, accepts: fn(Format) -> bool| match index {
            None => Ok(()),
            Some(index) => accessors.get(index).require_format(document, role, expected, accepts).map(drop),
        };
        // KHR_mesh_quantization allows integers for all but colours; they are accepted whether or not the file declares it.
        require(Some(self.positions), "POSITION", "VEC3 of floats, bytes or shorts", |f| {
            f.is_vector(3) && f.component != Component::U32
        })?;
        require(self.normals, "NORMAL", "VEC3 of floats, or of normalized bytes or shorts", |f| {
            f.is_vector(3) && f.is_float_or_normalized()
        })?;
        for (set, role) in self.tex_coords.into_iter().zip(["TEXCOORD_0", "TEXCOORD_1"]) {
            require(set, role, "VEC2 of floats, bytes or shorts", |f| f.is_vector(2) && f.component != Component::U32)?;
        }
        require(self.colors, "COLOR_0", "VEC3 or VEC4 of floats, or of normalized bytes or shorts", |f| {
            (f.is_vector(3) || f.is_vector(4)) && f.is_float_or_normalized()
        })?;
        require(self.indices, "a primitive's indices", "SCALAR of unsigned bytes, shorts or ints", |f| {
            f.is_vector(1) && matches!(f.component, Component::U8 | Component::U16 | Component::U32)
        })
    }

    fn check_counts(&self, document: &Document, accessors: &Accessors, pointer: &str) -> Result<()> {
        let vertex_count = accessors.get(self.positions).count;
        let streams = [self.normals, self.tex_coords[0], self.tex_coords[1], self.colors];
        for index in streams.into_iter().flatten() {
            check_vertex_count(document, accessors, index, vertex_count, pointer)?;
        }
        if u32::try_from(vertex_count).is_err() || self.triangle_count(accessors) > Geometry::MAX_TRIANGLES {
            let cause = format!("has more than {} triangles, or than 2^32 vertices", Geometry::MAX_TRIANGLES);
            return Err(document.fault(pointer, cause));
        }
        Ok(())
    }
}

/// Every accessor that a primitive refers to.
fn all_accessors(primitive: &json::mesh::Primitive) -> impl Iterator<Item = usize> {
    let targets = primitive.targets.iter().flatten().flat_map(|target| [target.positions, target.normals]);
    primitive.attributes.values().copied().chain(primitive.indices).chain(targets.flatten()).map(|index| index.value())
}

/// Checks that an attribute has one element for each position.
pub(super) fn check_vertex_count(
    document: &Document,
    accessors: &Accessors,
    index: usize,
    vertex_count: usize,
    pointer: &str,
) -> Result<()> {
    let count = accessors.get(index).count;
    if count == vertex_count {
        return Ok(());
    }
    Err(document
        .fault(pointer, format!("accessor {index} has {count} elements, but there are {vertex_count} positions")))
}

/// Linear RGBA, each in 0 to 1; opaque where the file has RGB.
fn read_colors(document: &Document, accessors: &Accessors, index: usize, selection: Selection) -> Result<Vec<Vec4>> {
    let elements = accessors.get(index);
    let format = elements.require_format(document, "COLOR_0", "VEC3 or VEC4", |f| f.is_vector(3) || f.is_vector(4))?;
    let mut colors: Vec<Vec4> = if format.is_vector(4) {
        elements.floats(document, selection)?
    } else {
        elements.floats::<Vec3, 3>(document, selection)?.into_iter().map(|rgb| rgb.extend(1.0)).collect()
    };
    colors.iter_mut().for_each(|c| *c = c.clamp(Vec4::ZERO, Vec4::ONE));
    Ok(colors)
}

fn mode_name(mode: json::mesh::Mode) -> &'static str {
    match mode {
        json::mesh::Mode::Points => "points",
        _ => "lines",
    }
}
