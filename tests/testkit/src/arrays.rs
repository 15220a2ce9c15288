//! Device arrays of meshes under transforms.

use bytemuck::Zeroable as _;
use glam::{DAffine3, DMat3, Vec3};
use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{
    GeometryRecord, InstanceFlags, InstanceRecord, MaterialRecord, NONE, Node, PrimitiveRange, Triangle, WideNode,
};
use ropewalk::graph::Geometry;
use ropewalk::math::Aabb;

use super::Mesh;

/// An instance of a mesh.
#[derive(Clone)]
pub struct Placed {
    /// Index into the meshes.
    pub mesh: usize,
    pub world_from_local: DAffine3,
    pub mask: u32,
    pub flags: InstanceFlags,
}

impl Placed {
    pub fn new(mesh: usize, world_from_local: DAffine3) -> Self {
        Self { mesh, world_from_local, mask: u32::MAX, flags: InstanceFlags::empty() }
    }
}

/// The builder of bottom-level structures.
#[derive(Clone, Copy, Debug)]
pub enum Builder {
    /// Splits at the median, in code so simple that it can be trusted.
    Median,
    /// [`Blas::build`].
    Product,
}

impl Builder {
    pub const BOTH: [Self; 2] = [Self::Median, Self::Product];
}

/// The device arrays of the instances `placed`, in their order, made without the library's builders.
pub fn arrays(meshes: &[Mesh], placed: &[Placed]) -> DeviceArrays {
    arrays_by(Builder::Median, meshes, placed)
}

/// The device arrays of the instances `placed`, in their order.
pub fn arrays_by(builder: Builder, meshes: &[Mesh], placed: &[Placed]) -> DeviceArrays {
    let mut arrays = DeviceArrays::default();
    let (mut nodes, mut wide_nodes, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    let (mut starts, mut streams) = (Vec::new(), Vec::new());
    for mesh in meshes {
        starts.push((nodes.len() as u32, triangles.len() as u32));
        let mut record = GeometryRecord::EMPTY;
        record.first_wide_node = wide_nodes.len() as u32;
        streams.push(record);
        let blas = match builder {
            Builder::Median => median_blas(mesh),
            Builder::Product => product_blas(mesh),
        };
        nodes.extend(blas.nodes);
        wide_nodes.extend(blas.wide_nodes);
        triangles.extend(blas.triangles);
    }
    let instances: Vec<InstanceRecord> = placed.iter().map(|p| instance(p, starts[p.mesh])).collect();
    let boxes: Vec<Aabb> = placed.iter().map(|p| world_box(&meshes[p.mesh], &p.world_from_local)).collect();
    let (order, mut tlas) = hierarchy(&boxes, 1);
    for node in tlas.iter_mut().filter(|n| n.primitives != PrimitiveRange::INNER) {
        node.primitives = PrimitiveRange::leaf(order[node.primitives.first_primitive() as usize], 1);
    }
    arrays.tlas_nodes.replace(&tlas);
    arrays.instances.replace(&instances);
    arrays.blas_nodes.replace(&nodes);
    arrays.wide_nodes.replace(&wide_nodes);
    arrays.triangles.replace(&triangles);
    arrays.geometries.replace(&streams);
    arrays.materials.replace(&[gray()]);
    arrays
}

/// A bottom-level structure. If it has no wide nodes, it is traversed along escape indices.
struct Parts {
    nodes: Vec<Node>,
    wide_nodes: Vec<WideNode>,
    triangles: Vec<Triangle>,
}

/// A diffuse, opaque material without textures.
pub fn gray() -> MaterialRecord {
    let mut material = MaterialRecord::zeroed();
    material.base_color = [0.5, 0.5, 0.5, 1.0];
    material.roughness = 1.0;
    material.ior = 1.5;
    material.alpha_cutoff = 0.5;
    material.base_color_texture = NONE;
    material.metallic_roughness_texture = NONE;
    material.emissive_texture = NONE;
    material.transmission_texture = NONE;
    material.normal_texture = NONE;
    material.normal_scale = 1.0;
    material
}

fn median_blas(mesh: &Mesh) -> Parts {
    let boxes: Vec<Aabb> = (0..mesh.indices.len()).map(|i| Aabb::from_points(mesh.triangle(i))).collect();
    let (order, nodes) = hierarchy(&boxes, 2);
    let triangles = order.iter().map(|&i| triangle(i, mesh.triangle(i as usize))).collect();
    Parts { nodes, wide_nodes: Vec::new(), triangles }
}

fn product_blas(mesh: &Mesh) -> Parts {
    let geometry = Geometry::new(mesh.positions.clone(), mesh.indices.clone());
    let blas = Blas::build(&geometry, &BlasBuildParams::default()).unwrap();
    Parts { nodes: blas.nodes, wide_nodes: blas.wide_nodes, triangles: blas.triangles }
}

fn triangle(primitive: u32, [v0, v1, v2]: [Vec3; 3]) -> Triangle {
    Triangle::new([v0, v1, v2].map(|v| v.to_array()), primitive)
}

fn instance(placed: &Placed, (first_node, first_triangle): (u32, u32)) -> InstanceRecord {
    InstanceRecord {
        local_from_world: rows(&placed.world_from_local.inverse()),
        world_from_local: rows(&placed.world_from_local),
        first_node,
        first_triangle,
        geometry: placed.mesh as u32,
        material: 0,
        mask: placed.mask,
        flags: placed.flags.bits(),
        node_key: [3, 1],
    }
}

fn rows(affine: &DAffine3) -> [[f32; 4]; 3] {
    let rows: DMat3 = affine.matrix3.transpose();
    [0, 1, 2].map(|i| rows.col(i).extend(affine.translation[i]).as_vec4().to_array())
}

fn world_box(mesh: &Mesh, world_from_local: &DAffine3) -> Aabb {
    let world = |p: &Vec3| world_from_local.transform_point3(p.as_dvec3()).as_vec3();
    padded(Aabb::from_points(mesh.positions.iter().map(world)))
}

/// The box enlarged by a few ulps of its largest coordinate.
fn padded(aabb: Aabb) -> Aabb {
    let pad = aabb.min.abs().max(aabb.max.abs()).max_element() * f32::EPSILON * 4.0;
    Aabb { min: aabb.min - pad, max: aabb.max + pad }
}

/// Builds a hierarchy of median splits over the boxes. Returns the primitives in the order of the leaves, and the
/// nodes.
fn hierarchy(boxes: &[Aabb], leaf_size: usize) -> (Vec<u32>, Vec<Node>) {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut nodes = Vec::new();
    if !order.is_empty() {
        split(boxes, &mut order, 0, leaf_size, &mut nodes);
    }
    let count = nodes.len() as u32;
    for node in nodes.iter_mut().filter(|n: &&mut Node| n.escape_index == count) {
        node.escape_index = NONE;
    }
    (order, nodes)
}

/// Appends the nodes over `order`, a part of the order of leaves that starts at index `first`. The recursion is as deep
/// as the logarithm of its length.
fn split(boxes: &[Aabb], order: &mut [u32], first: u32, leaf_size: usize, nodes: &mut Vec<Node>) {
    let bounds = order.iter().fold(Aabb::EMPTY, |b, &i| b.union(boxes[i as usize]));
    let bounds = padded(bounds);
    let index = nodes.len();
    let is_leaf = order.len() <= leaf_size;
    let primitives = if is_leaf { PrimitiveRange::leaf(first, order.len() as u32) } else { PrimitiveRange::INNER };
    nodes.push(Node { min: bounds.min.to_array(), escape_index: 0, max: bounds.max.to_array(), primitives });
    if !is_leaf {
        let extent = bounds.max - bounds.min;
        let axis = extent.max_position();
        let middle = order.len() / 2;
        order.select_nth_unstable_by(middle, |&a, &b| {
            let center = |i: u32| boxes[i as usize].center()[axis];
            center(a).total_cmp(&center(b))
        });
        let (left, right) = order.split_at_mut(middle);
        split(boxes, left, first, leaf_size, nodes);
        split(boxes, right, first + middle as u32, leaf_size, nodes);
    }
    nodes[index].escape_index = nodes.len() as u32;
}
