//! A canonical form of compiled scenes: the same scene has the same form, whatever edits its arrays were compiled from.

use std::collections::{HashMap, HashSet};

use glam::{BVec3, DVec3, Vec3, Vec4};
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{
    GeometryRecord, InstanceFlags, InstanceRecord, LightRecord, NONE, Node, TextureInfo, Triangle, WideNode,
};

/// Everything that a kernel can reach in device arrays, with indices replaced by what they refer to. Compared bit by
/// bit.
#[derive(Debug, PartialEq)]
pub struct Canonical {
    /// The instances in the leaves of the TLAS, and those that coincide with them, sorted; the nodes above them are not
    /// compared.
    instances: Vec<CanonicalInstance>,
    /// Sorted.
    lights: Vec<Vec<u8>>,
    /// The first invariant that is violated, if any.
    fault: Option<String>,
}

#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct CanonicalInstance {
    /// The instance record without its indices.
    record: Vec<u8>,
    /// The box of the TLAS leaf, and the bottom-level nodes; both empty in forms that leave structures out.
    bounds: Vec<u8>,
    blas_nodes: Vec<u8>,
    /// In the order of leaves or, in forms that leave structures out, in that of the geometry, without duplicates.
    triangles: Vec<u8>,
    /// Indices and streams of the geometry, one after the other.
    streams: Vec<Vec<u8>>,
    material: Vec<u8>,
    textures: Vec<(Vec<u8>, Vec<u32>)>,
}

impl Canonical {
    /// The canonical form of compiled arrays. Structures above the triangles are left out, but checked.
    pub fn of(arrays: &DeviceArrays) -> Self {
        Self::new(arrays, false)
    }

    /// The same with all nodes of bottom-level structures and the boxes of instances.
    pub fn exactly(arrays: &DeviceArrays) -> Self {
        Self::new(arrays, true)
    }

    fn new(arrays: &DeviceArrays, exact: bool) -> Self {
        let leaves = instance_leaves(arrays);
        let mut instances: Vec<CanonicalInstance> = (0..)
            .zip(arrays.instances.iter())
            .filter_map(|(index, record)| Some(canonical_instance(arrays, record, leaves.get(&index)?, exact)))
            .collect();
        instances.sort();
        let lights: &[LightRecord] = &arrays.lights;
        let mut lights: Vec<Vec<u8>> = lights.iter().map(|light| bytes(&[*light])).collect();
        lights.sort();
        Self { instances, lights, fault: fault(arrays) }
    }

    /// The first part that differs, by name; `None` if nothing does.
    pub fn difference(&self, other: &Self) -> Option<String> {
        if let Some(fault) = self.fault.as_ref().or(other.fault.as_ref()) {
            return Some(fault.clone());
        }
        if self.lights != other.lights {
            return Some("lights".to_owned());
        }
        if self.instances.len() != other.instances.len() {
            return Some(format!("{} or {} instances", self.instances.len(), other.instances.len()));
        }
        let (i, (a, b)) = self.instances.iter().zip(&other.instances).enumerate().find(|(_, (a, b))| a != b)?;
        let part = match () {
            () if a.record != b.record => "record",
            () if a.bounds != b.bounds => "box",
            () if a.blas_nodes != b.blas_nodes => "blas_nodes",
            () if a.triangles != b.triangles => "triangles",
            () if a.streams != b.streams => "streams",
            () if a.material != b.material => "material",
            () => "textures",
        };
        let records = [a, b].map(|instance| bytemuck::pod_read_unaligned::<InstanceRecord>(&instance.record));
        Some(format!("instance {i}: {part} of {records:?}"))
    }

    /// How many instances can be reached.
    pub fn instance_count(&self) -> usize {
        self.instances.len()
    }
}

/// By the index of each instance that has one, its leaf of the TLAS: its own, or that of the one that stands for it.
fn instance_leaves(arrays: &DeviceArrays) -> HashMap<u32, &Node> {
    let leaves = arrays.tlas_nodes.iter().filter(|node| node.primitives.primitive_count() > 0);
    let mut leaves: HashMap<u32, &Node> = leaves.map(|leaf| (leaf.primitives.first_primitive(), leaf)).collect();
    let content = |record: &InstanceRecord| bytes(&[InstanceRecord { node_key: [0; 2], ..*record }]);
    let records = (0..).zip(arrays.instances.iter());
    let leaf_of_content: HashMap<Vec<u8>, &Node> =
        records.clone().filter_map(|(index, record)| Some((content(record), *leaves.get(&index)?))).collect();
    for (index, record) in records {
        if let Some(leaf) = leaf_of_content.get(&content(record)) {
            leaves.entry(index).or_insert(leaf);
        }
    }
    leaves
}

fn canonical_instance(arrays: &DeviceArrays, instance: &InstanceRecord, leaf: &Node, exact: bool) -> CanonicalInstance {
    let (nodes, triangles) = structure(arrays, instance);
    let mut triangles = triangles.to_vec();
    if !exact {
        triangles.sort_by_key(|triangle| triangle.primitive);
        triangles.dedup_by_key(|triangle| triangle.primitive);
    }
    let material = arrays.materials[instance.material as usize];
    let texture_indices = [
        material.base_color_texture,
        material.metallic_roughness_texture,
        material.emissive_texture,
        material.transmission_texture,
        material.normal_texture,
    ];
    // Whether there are duplicate triangles depends on the structure.
    let flags = if exact { instance.flags } else { instance.flags & !InstanceFlags::HAS_DUPLICATES.bits() };
    let record = InstanceRecord { first_node: 0, first_triangle: 0, geometry: 0, material: 0, flags, ..*instance };
    let mut material = material;
    material.base_color_texture = 0;
    material.metallic_roughness_texture = 0;
    material.emissive_texture = 0;
    material.transmission_texture = 0;
    material.normal_texture = 0;
    CanonicalInstance {
        record: bytes(&[record]),
        bounds: if exact { bytes(&[leaf.min, leaf.max]) } else { Vec::new() },
        blas_nodes: if exact { bytes(nodes) } else { Vec::new() },
        triangles: bytes(&triangles),
        streams: canonical_streams(arrays, &arrays.geometries[instance.geometry as usize], &triangles),
        material: bytes(&[material]),
        textures: texture_indices.iter().map(|&i| canonical_texture(arrays, i)).collect(),
    }
}

/// The nodes and triangles of an instance.
fn structure<'a>(arrays: &'a DeviceArrays, instance: &InstanceRecord) -> (&'a [Node], &'a [Triangle]) {
    let nodes = reachable(&arrays.blas_nodes[instance.first_node as usize..]);
    let triangle_count = nodes
        .iter()
        .map(|n| (n.primitives.first_primitive() + n.primitives.primitive_count()) as usize)
        .max()
        .unwrap_or(0);
    (nodes, &arrays.triangles[instance.first_triangle as usize..][..triangle_count])
}

/// The first fault of the arrays: a structure in which some ray would miss a triangle, or an instance whose box does
/// not contain it, or is larger than the world box of its local box.
fn fault(arrays: &DeviceArrays) -> Option<String> {
    let leaves = arrays.tlas_nodes.iter().filter(|node| node.primitives.primitive_count() > 0);
    leaves.filter_map(|leaf| Some((leaf, arrays.instances.get(leaf.primitives.first_primitive() as usize)?))).find_map(
        |(leaf, instance)| {
            let (nodes, triangles) = structure(arrays, instance);
            let Some(leaves) = rope_leaves(nodes, triangles) else { return Some("the order of nodes".to_owned()) };
            if let Some(primitive) = lost_triangle(&leaves, triangles) {
                return Some(format!("triangle {primitive} sticks out"));
            }
            let primitives: HashSet<u32> = triangles.iter().map(|triangle| triangle.primitive).collect();
            let has_duplicates =
                InstanceFlags::from_bits_retain(instance.flags).contains(InstanceFlags::HAS_DUPLICATES);
            if has_duplicates != (primitives.len() < triangles.len()) {
                return Some(format!("an instance that has duplicates: {has_duplicates}"));
            }
            let first_wide = arrays.geometries[instance.geometry as usize].first_wide_node;
            let wide_nodes = arrays.wide_nodes.get(first_wide as usize..).unwrap_or_default();
            let leaves = wide_leaves(wide_nodes, triangles);
            if let Some(primitive) = lost_triangle(&leaves, triangles) {
                return Some(format!("triangle {primitive} sticks out of wide nodes"));
            }
            let world = |p: Vec3| {
                let rows = instance.world_from_local.map(|row| Vec4::from(row).as_dvec4());
                DVec3::from(rows.map(|row| row.dot(p.extend(1.0).as_dvec4())))
            };
            let corners = || triangles.iter().flat_map(|t| [t.v0, t.v1, t.v2]).map(Vec3::from);
            let (local_min, local_max) = (corners().fold(Vec3::MAX, Vec3::min), corners().fold(Vec3::MIN, Vec3::max));
            let of_box =
                (0..8).map(|i| Vec3::select(BVec3::new(i & 1 == 0, i & 2 == 0, i & 4 == 0), local_min, local_max));
            let [least, most] = [corners().map(world).collect::<Vec<_>>(), of_box.map(world).collect()];
            let [least, most] = [least, most].map(|points| {
                let max = points.iter().copied().fold(DVec3::MIN, DVec3::max);
                (points.into_iter().fold(DVec3::MAX, DVec3::min), max)
            });
            let (min, max) = (Vec3::from(leaf.min).as_dvec3(), Vec3::from(leaf.max).as_dvec3());
            // By what rounding a ray's way to local space moves a corner of the box, as `compile` widens it: much where
            // the matrix is nearly singular, as that of a flattened instance is.
            let magnitudes = |rows: [[f32; 4]; 3], v: DVec3, w: f64| {
                DVec3::from(rows.map(|row| Vec4::from(row).abs().as_dvec4().dot(v.extend(w))))
            };
            let corner = min.abs().max(max.abs());
            let moved = magnitudes(instance.world_from_local, magnitudes(instance.local_from_world, corner, 1.0), 0.0);
            let slack = DVec3::splat(1e-4 * corner.max_element()) + moved * 1e-6;
            let is_around = min.cmple(least.0 + slack) & max.cmpge(least.1 - slack);
            let is_tight = min.cmpge(most.0 - slack) & max.cmple(most.1 + slack);
            (!(is_around & is_tight).all())
                .then(|| format!("the box of an instance, {leaf:?}, around {least:?} in {most:?}"))
        },
    )
}

/// The boxes that a ray must enter to reach a leaf, and the leaf's triangles.
type Leaf<'a> = (Vec<(DVec3, DVec3)>, &'a [Triangle]);

/// The leaves of a hierarchy of wide nodes.
fn wide_leaves<'a>(nodes: &[WideNode], triangles: &'a [Triangle]) -> Vec<Leaf<'a>> {
    let mut open = vec![(0, Vec::new())];
    let mut leaves = Vec::new();
    while let Some((index, above)) = open.pop() {
        let node: WideNode = nodes[index];
        for slot in (0..8).filter(|slot| node.child_mask() >> slot & 1 != 0) {
            let plane = |axis: usize, side: usize| {
                let step = f64::from(f32::from_bits(u32::from(node.exponents[axis]) << 23));
                f64::from(node.origin[axis]) + f64::from(node.planes[axis][side][slot]) * step
            };
            let [min, max] = [0, 1].map(|side| DVec3::from([0, 1, 2].map(|axis| plane(axis, side))));
            let around: Vec<_> = above.iter().copied().chain([(min, max)]).collect();
            let child = node.children[slot];
            if child.is_leaf() {
                let (first, count) = (child.triangles().first_primitive(), child.triangles().primitive_count());
                leaves.push((around, &triangles[first as usize..][..count as usize]));
            } else {
                open.push((child.node_index() as usize, around));
            }
        }
    }
    leaves
}

/// The leaves of a hierarchy; `None` if some subtree ends outside its parent's.
fn rope_leaves<'a>(nodes: &[Node], triangles: &'a [Triangle]) -> Option<Vec<Leaf<'a>>> {
    let end = |node: &Node| if node.escape_index == NONE { nodes.len() } else { node.escape_index as usize };
    let bounds = |&i: &usize| (Vec3::from(nodes[i].min).as_dvec3(), Vec3::from(nodes[i].max).as_dvec3());
    let mut above: Vec<usize> = Vec::new();
    let mut leaves = Vec::new();
    for (index, node) in nodes.iter().enumerate() {
        while above.last().is_some_and(|&parent| end(&nodes[parent]) <= index) {
            above.pop();
        }
        let limit = above.last().map_or(nodes.len(), |&parent| end(&nodes[parent]));
        if end(node) <= index || end(node) > limit {
            return None;
        }
        above.push(index);
        let (first, count) = (node.primitives.first_primitive() as usize, node.primitives.primitive_count() as usize);
        if count > 0 {
            leaves.push((above.iter().map(bounds).collect(), triangles.get(first..first + count)?));
        }
    }
    Some(leaves)
}

/// A triangle that some ray would not reach: one in no leaf, or of which a point (a corner, the middle of an edge or
/// the centroid) is within the boxes of none of its leaves.
fn lost_triangle(leaves: &[Leaf<'_>], triangles: &[Triangle]) -> Option<u32> {
    let mut places: HashMap<u32, Vec<&[(DVec3, DVec3)]>> = HashMap::new();
    for (around, held) in leaves {
        held.iter().for_each(|triangle| places.entry(triangle.primitive).or_default().push(around));
    }
    let is_lost = |triangle: &&Triangle| {
        let corners = [triangle.v0, triangle.v1, triangle.v2].map(|corner| Vec3::from(corner).as_dvec3());
        let [a, b, c] = corners;
        let points = [a, b, c, (a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5, (a + b + c) / 3.0];
        let is_in =
            |around: &[(DVec3, DVec3)], p: DVec3| around.iter().all(|(min, max)| (p.cmpgt(*min) & p.cmplt(*max)).all());
        let places = places.get(&triangle.primitive).map_or(&[][..], Vec::as_slice);
        points.into_iter().any(|point| !places.iter().any(|around| is_in(around, point)))
    };
    triangles.iter().find(is_lost).map(|triangle| triangle.primitive)
}

/// The nodes of the hierarchy that starts at `nodes[0]`: up to the last one whose escape index is the end.
fn reachable(nodes: &[Node]) -> &[Node] {
    let mut i = 0;
    loop {
        let node = &nodes[i];
        match (node.primitives.primitive_count(), node.escape_index) {
            (0, _) => i += 1,
            (_, NONE) => return &nodes[..=i],
            (_, escape) => i = escape as usize,
        }
    }
}

fn canonical_streams(arrays: &DeviceArrays, streams: &GeometryRecord, triangles: &[Triangle]) -> Vec<Vec<u8>> {
    if streams.first_index == NONE {
        return Vec::new();
    }
    let vertex = |triangle: &Triangle, corner: u32| {
        arrays.indices[(streams.first_index + 3 * triangle.primitive + corner) as usize]
    };
    let vertices: Vec<u32> =
        triangles.iter().flat_map(|t| (0..3).map(move |c| (t, c))).map(|(t, c)| vertex(t, c)).collect();
    let gather = |first: u32, stride: u32, array: &[u32]| -> Vec<u8> {
        if first == NONE {
            return Vec::new();
        }
        let words = vertices.iter().flat_map(|v| (0..stride).map(move |k| first + v * stride + k));
        bytes(&words.map(|w| array[w as usize]).collect::<Vec<u32>>())
    };
    let normals: &[f32] = &arrays.normals;
    let pair = |first: u32| if first == NONE { NONE } else { first * 2 };
    let (tex_coords, colors): (&[[f32; 2]], &[[u32; 2]]) = (&arrays.tex_coords, &arrays.colors);
    vec![
        bytes(&vertices),
        gather(streams.first_normal, 3, bytemuck::cast_slice(normals)),
        gather(pair(streams.first_tex_coord_0), 2, bytemuck::cast_slice(tex_coords)),
        gather(pair(streams.first_tex_coord_1), 2, bytemuck::cast_slice(tex_coords)),
        gather(pair(streams.first_color), 2, bytemuck::cast_slice(colors)),
    ]
}

fn canonical_texture(arrays: &DeviceArrays, index: u32) -> (Vec<u8>, Vec<u32>) {
    if index == NONE {
        return (Vec::new(), Vec::new());
    }
    let info = arrays.texture_infos[index as usize];
    let texels = &arrays.texels[info.first_texel as usize..][..(info.width * info.height) as usize];
    (bytes(&[TextureInfo { first_texel: 0, ..info }]), texels.to_vec())
}

fn bytes<T: bytemuck::Pod>(values: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(values).to_vec()
}
