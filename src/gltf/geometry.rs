//! Conversion of a mesh primitive to a [`Geometry`].
//!
//! A [`GeometrySource`] is what determines a geometry: accessors, topology and pose. Primitives with equal sources
//! share one geometry, however many meshes they are in and whatever their materials.

use std::sync::Arc;

use ::gltf::json;
use glam::{DAffine3, Vec2, Vec3, Vec4};
use json::mesh::Semantic;
use json::validation::Checked::Valid;

use super::accessor::Selection;
use super::format::{Component, Format};
use super::topology::{Topology, compact_vertices};
use super::warnings::{BYTES_PER_FORGIVABLE, Forgivable, Warnings, cause_of};
use super::{AccessorFault, Accessors, Budget, Document, GltfFault, Pose, PrimitiveFault, normals};
use crate::graph::Geometry;
use crate::{Error, Result};

/// What determines a geometry. Accessors are given by their canonical index, so that equal content compares equal.
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

/// Why a primitive has no geometry.
pub(super) enum SkipReason {
    /// It consists of "points" or "lines".
    NotTriangles(&'static str),
    /// It has no positions: an unsupported extension would generate them.
    NoPositions,
    /// It has too few vertices for a triangle.
    NoTriangles,
    /// The file does not hold the data of some accessor: an unsupported extension would provide it.
    NoData,
}

impl GeometrySource {
    /// The source of a primitive, checked against its accessors' formats and lengths but not their data.
    /// `canonical_accessor` maps each accessor to the first equal one. `pointer` is the primitive's, for messages.
    ///
    /// Streams of normals, texture coordinates and colours whose format or length is wrong are left out.
    pub(super) fn new(
        document: &Document,
        accessors: &Accessors,
        canonical_accessor: &[usize],
        primitive: &json::mesh::Primitive,
        pointer: &str,
        warnings: &mut Warnings,
    ) -> Result<Result<Self, SkipReason>> {
        // Find how vertices form triangles; points and lines are not drawn.
        let Valid(mode) = primitive.mode else {
            return Err(document.error_at(format!("{pointer}/mode"), GltfFault::UnknownMode));
        };
        let Some(topology) = Topology::of(mode) else { return Ok(Err(SkipReason::NotTriangles(mode_name(mode)))) };
        // Find the positions, without which nothing can be drawn, and check that no data is missing.
        let attribute =
            |semantic| primitive.attributes.get(&Valid(semantic)).map(|index| canonical_accessor[index.value()]);
        let Some(positions) = attribute(Semantic::Positions) else { return Ok(Err(SkipReason::NoPositions)) };
        if !all_accessors(primitive).all(|index| accessors.get(index).has_data()) {
            return Ok(Err(SkipReason::NoData));
        }
        // Refer to every attribute by its canonical accessor, so that equal primitives have equal sources.
        let mut source = Self {
            topology,
            indices: primitive.indices.map(|index| canonical_accessor[index.value()]),
            positions,
            normals: attribute(Semantic::Normals),
            tex_coords: [0, 1].map(|set| attribute(Semantic::TexCoords(set))),
            colors: attribute(Semantic::Colors(0)),
            pose: Pose::default(),
        };
        // Check formats and lengths.
        source.check_formats(document, accessors)?;
        source.check_counts(document, accessors, pointer)?;
        source.leave_out_broken_streams(document, accessors, pointer, warnings)?;
        Ok(if source.triangle_count(accessors) == 0 { Err(SkipReason::NoTriangles) } else { Ok(source) })
    }

    /// The same source with morph targets and skin.
    pub(super) fn with_pose(self, pose: Pose) -> Self {
        Self { pose, ..self }
    }

    /// The number of triangles.
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

    /// The accessors that decide whether its indices are in range; equal values need only one check.
    pub(super) fn index_check_key(&self) -> Option<(usize, usize)> {
        self.indices.map(|indices| (indices, self.positions))
    }

    /// Checks the indices alone, for a primitive that no node uses. Charges the budget for the indices.
    pub(super) fn check_indices(&self, document: &Document, accessors: &Accessors, budget: &mut Budget) -> Result<()> {
        let Some(indices) = self.indices else { return Ok(()) };
        budget.charge(accessors.get(indices).count, size_of::<u32>(), document, || format!("/accessors/{indices}"))?;
        self.read_indices(document, accessors).map(drop)
    }

    /// Charges the budget for everything that [`build`](Self::build) allocates, as if all of it were held at once.
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
        let at = || pointer.to_owned();

        // The source is kept twice, in a list and in a map, with its pointer.
        budget.charge(6, size_of::<Self>() + 64, document, at)?;
        budget.charge(index_count, size_of::<u32>(), document, at)?;
        // Triangles are held twice: as built, and as kept.
        budget.charge(self.triangle_count(accessors), triangle_size, document, at)?;
        // Only used vertices are read: no more than there are indices.
        budget.charge(vertex_count.min(index_count), self.bytes_per_vertex(), document, at)?;
        // The bits and ranks of `compact_vertices`: 12 bytes for 64 vertices.
        budget.charge(vertex_count / 4, 1, document, at)?;
        // Each stream but the positions can have a fault, which is told of when all geometries are built.
        let fault = BYTES_PER_FORGIVABLE + 2 * document.path.as_os_str().len();
        budget.charge(self.max_faults(), fault, document, at)
    }

    /// The most faults that [`build`](Self::build) adds.
    fn max_faults(&self) -> usize {
        let streams = [self.normals, self.tex_coords[0], self.tex_coords[1], self.colors];
        streams.iter().flatten().count() + self.pose.max_faults()
    }

    /// Upper bound of the bytes that [`build`](Self::build) allocates for a used vertex. Every stream is held twice: as
    /// read, and as kept.
    fn bytes_per_vertex(&self) -> usize {
        let selection = size_of::<u32>();
        let positions = 2 * size_of::<Vec3>();
        let normals = self.normals.map_or(0, |_| 2 * size_of::<Vec3>() + normals::BYTES_PER_NORMAL);
        let tex_coords = self.tex_coords.iter().flatten().count() * 2 * size_of::<Vec2>();
        // RGB is read before it becomes RGBA.
        let colors = self.colors.map_or(0, |_| size_of::<Vec3>() + 2 * size_of::<Vec4>());
        selection + positions + normals + tex_coords + colors + self.pose.bytes_per_vertex()
    }

    /// Reads the accessors and builds the geometry. `palettes` are the joint matrices that the pose refers to,
    /// `pointer` is the primitive's, for messages, and what is wrong but was corrected is added to `faults`.
    /// O(indices).
    pub(super) fn build(
        &self,
        document: &Document,
        accessors: &Accessors,
        palettes: &[Vec<DAffine3>],
        pointer: &str,
        faults: &mut Vec<Forgivable>,
    ) -> Result<Geometry> {
        // 1. Read the indices, and compact them to the vertices that are used.
        let mut indices = self.read_indices(document, accessors)?;
        let used = compact_vertices(&mut indices, accessors.get(self.positions).count);
        let selection = used.as_deref().map_or(Selection::All, Selection::Indices);
        let triangles = self.topology.triangles(&indices);

        // 2. Read the attributes of these vertices.
        let mut positions: Vec<Vec3> = accessors.get(self.positions).floats(document, selection)?;
        let mut normals = match self.normals {
            Some(index) => read_normals(document, accessors, index, selection, faults)?,
            None => None,
        };
        // A stream with a number that is not finite is left out as a whole.
        let mut leave_out = |feature: &'static str, error: Error| {
            let fallback = format!("{}: all of them are left out", cause_of(&error));
            faults.push(Forgivable { error, feature, fallback });
        };
        let mut tex_coords = [None, None];
        for ((set, index), role) in tex_coords.iter_mut().zip(self.tex_coords).zip(TEX_COORD_ROLES) {
            let read = index.map(|index| accessors.get(index).floats::<Vec2, 2>(document, selection)).transpose();
            *set = read.unwrap_or_else(|error| {
                leave_out(role, error);
                None
            });
        }
        let colors = self.colors.map(|index| read_colors(document, accessors, index, selection)).transpose();
        let colors = colors.unwrap_or_else(|error| {
            leave_out("COLOR_0", error);
            None
        });

        // 3. Apply the rest pose, and normalize.
        let is_finite = self.pose.apply(
            document,
            accessors,
            palettes,
            selection,
            &mut positions,
            normals.as_deref_mut(),
            faults,
        )?;
        if !is_finite {
            return Err(document.error_at(pointer, PrimitiveFault::PoseNotFinite));
        }
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

    /// The vertex indices, each checked to be in range.
    fn read_indices(&self, document: &Document, accessors: &Accessors) -> Result<Vec<u32>> {
        let vertex_count = accessors.get(self.positions).count;
        let Some(accessor) = self.indices else {
            // `check_counts` has checked that this fits.
            return Ok((0..vertex_count as u32).collect());
        };
        let indices: Vec<[u32; 1]> = accessors.get(accessor).integers(document, Selection::All)?;
        let indices: Vec<u32> = bytemuck::cast_vec(indices);
        // Check that every index is that of a vertex.
        if let Some(i) = indices.iter().position(|&index| index as usize >= vertex_count) {
            let fault = AccessorFault::VertexIndexOutOfRange { position: i, index: indices[i], vertex_count };
            return Err(document.error_at(format!("/accessors/{accessor}"), fault));
        }
        // The largest index of the type is forbidden: graphics APIs take it as a primitive restart.
        let restart = accessors.get(accessor).largest_integer();
        if let Some(i) = indices.iter().position(|&index| Some(index) == restart) {
            let fault = AccessorFault::PrimitiveRestart { position: i, index: indices[i] };
            return Err(document.error_at(format!("/accessors/{accessor}"), fault));
        }
        Ok(indices)
    }

    fn check_formats(&self, document: &Document, accessors: &Accessors) -> Result<()> {
        let require =
            |index: Option<usize>, role: &'static str, expected: &'static str, accepts: fn(Format) -> bool| match index
            {
                None => Ok(()),
                Some(index) => accessors.get(index).require_format(document, role, expected, accepts).map(drop),
            };
        // KHR_mesh_quantization allows integers; they are accepted whether or not the file declares the extension.
        require(Some(self.positions), "POSITION", "VEC3 of floats, bytes or shorts", |f| {
            f.is_vector(3) && f.component != Component::U32
        })?;
        require(self.indices, "a primitive's indices", "SCALAR of unsigned bytes, shorts or ints", |f| {
            f.is_vector(1) && matches!(f.component, Component::U8 | Component::U16 | Component::U32)
        })
    }

    fn check_counts(&self, document: &Document, accessors: &Accessors, pointer: &str) -> Result<()> {
        let vertex_count = accessors.get(self.positions).count;
        // Vertices are numbered by u32, and the triangles of a geometry are limited.
        if u32::try_from(vertex_count).is_err() || self.triangle_count(accessors) > Geometry::MAX_TRIANGLES {
            let fault = PrimitiveFault::TooLarge { max_triangles: Geometry::MAX_TRIANGLES };
            return Err(document.error_at(pointer, fault));
        }
        Ok(())
    }
}

/// The attributes that hold the two sets of texture coordinates.
const TEX_COORD_ROLES: [&str; 2] = ["TEXCOORD_0", "TEXCOORD_1"];

impl GeometrySource {
    /// Checks the streams without which a primitive can be drawn too: their formats, and that they have one element for
    /// each vertex. Leaves out those that are broken. Colours that are not normalized, but should be, are kept.
    fn leave_out_broken_streams(
        &mut self,
        document: &Document,
        accessors: &Accessors,
        pointer: &str,
        warnings: &mut Warnings,
    ) -> Result<()> {
        let vertex_count = accessors.get(self.positions).count;
        let mut check = |stream: &mut Option<usize>, role, expected, accepts: fn(Format) -> bool| {
            let Some(index) = *stream else { return Ok(()) };
            let format = accessors.get(index).require_format(document, role, expected, accepts);
            let checked = format.and_then(|_| check_vertex_count(document, accessors, index, vertex_count, pointer));
            checked.or_else(|error| {
                *stream = None;
                warnings.leave_out(&document.value, role, error)
            })
        };
        check(&mut self.normals, "NORMAL", "VEC3 of floats, or of normalized bytes or shorts", |f| {
            f.is_vector(3) && f.is_float_or_normalized()
        })?;
        // KHR_mesh_quantization allows integers here too.
        for (set, role) in self.tex_coords.iter_mut().zip(TEX_COORD_ROLES) {
            check(set, role, "VEC2 of floats, bytes or shorts", |f| f.is_vector(2) && f.component != Component::U32)?;
        }
        check(&mut self.colors, "COLOR_0", "VEC3 or VEC4 of floats, or of normalized bytes or shorts", |f| {
            (f.is_vector(3) || f.is_vector(4)) && (f.is_float_or_normalized() || largest_fraction(f).is_some())
        })?;
        // Integer colours without `normalized` have one reading, since colours go from 0 to 1.
        let Some(elements) = self.colors.map(|index| accessors.get(index)) else { return Ok(()) };
        let format = elements.require_format(document, "COLOR_0", "VEC3 or VEC4", |_| true)?;
        if largest_fraction(format).is_none() {
            return Ok(());
        }
        let fault = AccessorFault::NotNormalized { found: format.to_string() };
        let fallback = format!("{fault}: read as normalized");
        warnings.forgive(&document.value, "COLOR_0", fallback, elements.error(document, fault))
    }
}

/// The integer that stands for 1, of colours that are not marked as normalized; `None` for those that are, or are
/// floats or signed.
fn largest_fraction(format: Format) -> Option<f32> {
    match (format.component, format.normalized) {
        (Component::U8, false) => Some(u8::MAX.into()),
        (Component::U16, false) => Some(u16::MAX.into()),
        _ => None,
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
    Err(document.error_at(pointer, PrimitiveFault::AttributeCount { accessor: index, count, vertex_count }))
}

/// Linear RGBA, each component in 0 to 1; alpha is 1 if the file has RGB.
fn read_colors(document: &Document, accessors: &Accessors, index: usize, selection: Selection) -> Result<Vec<Vec4>> {
    let elements = accessors.get(index);
    let format = elements.require_format(document, "COLOR_0", "VEC3 or VEC4", |f| f.is_vector(3) || f.is_vector(4))?;
    // Read the colours, and give those without alpha an alpha of 1.
    let mut colors: Vec<Vec4> = if format.is_vector(4) {
        elements.floats(document, selection)?
    } else {
        elements.floats::<Vec3, 3>(document, selection)?.into_iter().map(|rgb| rgb.extend(1.0)).collect()
    };
    // Integers that are not marked as normalized were read as they are.
    if let Some(one) = largest_fraction(format) {
        colors
            .iter_mut()
            .for_each(|color| *color = (*color / one).with_w(if format.is_vector(4) { color.w / one } else { 1.0 }));
    }
    colors.iter_mut().for_each(|c| *c = c.clamp(Vec4::ZERO, Vec4::ONE));
    Ok(colors)
}

/// The normals; those without direction are zero, so that [`normals::normalize`] computes them. `None` if not one has a
/// direction.
fn read_normals(
    document: &Document,
    accessors: &Accessors,
    index: usize,
    selection: Selection,
    faults: &mut Vec<Forgivable>,
) -> Result<Option<Vec<Vec3>>> {
    let mut normals: Vec<Vec3> = accessors.get(index).any_floats(document, selection)?;
    let has_direction = |normal: &Vec3| normal.is_finite() && *normal != Vec3::ZERO;
    let Some(first) = normals.iter().position(|normal| !has_direction(normal)) else { return Ok(Some(normals)) };
    let without = normals.iter().filter(|normal| !has_direction(normal)).count();
    let fault = AccessorFault::NoDirection { element: selection.element(first) };
    let all = without == normals.len();
    let fallback = match without - 1 {
        _ if all => format!("{fault}, as are all others: left out, the triangles' own normals are used"),
        0 => format!("{fault}: computed from the triangles around it"),
        more => format!("{fault}, and {more} more: computed from the triangles around them"),
    };
    faults.push(Forgivable { error: accessors.get(index).error(document, fault), feature: "NORMAL", fallback });
    normals.iter_mut().filter(|normal| !has_direction(normal)).for_each(|normal| *normal = Vec3::ZERO);
    Ok((!all).then_some(normals))
}

fn mode_name(mode: json::mesh::Mode) -> &'static str {
    match mode {
        json::mesh::Mode::Points => "points",
        _ => "lines",
    }
}
