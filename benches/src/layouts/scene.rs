//! A scene in a hypothetical layout: both levels, traced by many rays.

use std::collections::{BTreeMap, HashSet};

use glam::Vec3;
use rayon::prelude::*;
use ropewalk::Geometry;
use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{InstanceRecord, NONE, Node, RayRecord, Triangle};

use super::{Counts, Layout, SlabRay, Tree, Walk};
use crate::rays::meet;
use crate::scenes::leaves;

/// A scene with its hierarchies in some layout.
pub struct LayoutScene<'a> {
    arrays: &'a DeviceArrays,
    /// The top level, whose leaves are instances.
    top: Box<dyn Walk>,
    /// By the index of the structure's first node in the device array.
    structures: BTreeMap<u32, Structure>,
}

struct Structure {
    walk: Box<dyn Walk>,
    triangles: Vec<Triangle>,
}

/// What many rays have read and tested.
#[derive(Clone, Copy, Debug, Default)]
pub struct Totals {
    /// Sums over all rays; of `stack` the maximum.
    pub counts: Counts,
    /// Rays are traced in groups of 32 that step together, a step being a node or a triangle: the share of the lanes'
    /// steps in which the lane's ray is not yet done.
    pub lockstep_efficiency: f64,
}

/// Threads of a GPU that step together.
const LANES: usize = 32;
const INSTANCE_BYTES: u64 = 128;
const TRIANGLE_BYTES: u64 = 48;

impl<'a> LayoutScene<'a> {
    /// Lays out the top level and every bottom-level structure of the arrays.
    pub fn new(arrays: &'a DeviceArrays, layout: Layout) -> Self {
        let top = layout.lay_out(&Tree::new(&arrays.tlas_nodes));
        let mut structures = BTreeMap::new();
        for instance in leaves(&arrays.tlas_nodes).map(|(first, _)| &arrays.instances[first]) {
            if structures.contains_key(&instance.first_node) {
                continue;
            }
            let (nodes, triangles) = bottom_level(arrays, instance);
            structures.insert(instance.first_node, Structure { walk: layout.lay_out(&Tree::new(nodes)), triangles });
        }
        Self { arrays, top, structures }
    }

    /// Bytes of the bottom-level nodes, for each of their triangles.
    pub fn node_bytes_a_triangle(&self) -> f64 {
        let bytes: usize = self.structures.values().map(|structure| structure.walk.node_bytes()).sum();
        let triangles: usize = self.structures.values().map(|structure| structure.triangles.len()).sum();
        bytes as f64 / triangles as f64
    }

    /// Traces every ray. Returns the distance of each ray's hit (infinity for a miss; 0 for a hit where any hit
    /// counts).
    pub fn trace(&self, rays: &[RayRecord], is_any_hit: bool) -> (Vec<f32>, Totals) {
        let traced: Vec<(f32, Counts)> = rays
            .par_iter()
            .with_min_len(LANES)
            .map(|ray| {
                let mut counts = Counts::default();
                let t = self.trace_ray(ray, is_any_hit, &mut counts);
                (t, counts)
            })
            .collect();
        let steps = |counts: &Counts| counts.nodes + counts.triangles;
        let mut totals = Totals::default();
        let mut lane_steps = 0;
        for group in traced.chunks(LANES) {
            lane_steps += LANES as u64 * group.iter().map(|(_, counts)| steps(counts)).max().unwrap_or(0);
            for (_, counts) in group {
                let sum = &mut totals.counts;
                sum.nodes += counts.nodes;
                sum.boxes += counts.boxes;
                sum.triangles += counts.triangles;
                sum.bytes += counts.bytes;
                sum.stack = sum.stack.max(counts.stack);
            }
        }
        totals.lockstep_efficiency = steps(&totals.counts) as f64 / lane_steps.max(1) as f64;
        (traced.into_iter().map(|(t, _)| t).collect(), totals)
    }

    fn trace_ray(&self, ray: &RayRecord, is_any_hit: bool, counts: &mut Counts) -> f32 {
        let [origin, direction] = [ray.origin, ray.direction].map(Vec3::from_array);
        let world = SlabRay::new(origin, direction);
        let mut leaf = |instance: u32, _: u32, t_max: f32, counts: &mut Counts| {
            let instance = &self.arrays.instances[instance as usize];
            counts.bytes += INSTANCE_BYTES;
            self.trace_instance(instance, origin, direction, t_max, is_any_hit, counts)
        };
        let t_max = self.top.walk(&world, ray.t_max, counts, &mut leaf);
        if t_max < 0.0 {
            return 0.0;
        }
        if is_any_hit || t_max == ray.t_max { f32::INFINITY } else { t_max }
    }

    fn trace_instance(
        &self,
        instance: &InstanceRecord,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        is_any_hit: bool,
        counts: &mut Counts,
    ) -> f32 {
        let structure = &self.structures[&instance.first_node];
        let rows = instance.local_from_world;
        let turn = |v: Vec3| Vec3::from_array(rows.map(|[x, y, z, _]| Vec3::new(x, y, z).dot(v)));
        let origin = turn(origin) + Vec3::from_array(rows.map(|row| row[3]));
        let direction = turn(direction);
        let local = RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max };
        let mut leaf = |first: u32, count: u32, mut t_max: f32, counts: &mut Counts| {
            for triangle in &structure.triangles[first as usize..][..count as usize] {
                counts.triangles += 1;
                counts.bytes += TRIANGLE_BYTES;
                let corners = [triangle.v0, triangle.v1, triangle.v2].map(Vec3::from_array);
                if let Some(t) = meet(&local, &corners, t_max) {
                    t_max = if is_any_hit { -1.0 } else { t };
                    if is_any_hit {
                        break;
                    }
                }
            }
            t_max
        };
        structure.walk.walk(&SlabRay::new(origin, direction), t_max, counts, &mut leaf)
    }
}

/// The same scene with bottom-level structures as the paper has them, one triangle a leaf, and without wide nodes.
///
/// # Errors
/// As [`Blas::build`].
pub fn paper_arrays(arrays: &DeviceArrays) -> ropewalk::Result<DeviceArrays> {
    let mut paper = DeviceArrays::default();
    paper.tlas_nodes.replace(&arrays.tlas_nodes);
    paper.geometries.replace(&arrays.geometries);
    paper.indices.replace(&arrays.indices);
    paper.normals.replace(&arrays.normals);
    paper.tex_coords.replace(&arrays.tex_coords);
    paper.colors.replace(&arrays.colors);
    paper.materials.replace(&arrays.materials);
    paper.texture_infos.replace(&arrays.texture_infos);
    paper.texels.replace(&arrays.texels);
    paper.lights.replace(&arrays.lights);
    let (mut instances, mut nodes, mut triangles) = (arrays.instances.to_vec(), Vec::new(), Vec::new());
    let mut starts = BTreeMap::new();
    for (index, _) in leaves(&arrays.tlas_nodes) {
        let instance = &mut instances[index];
        let start = match starts.get(&instance.first_node) {
            Some(&start) => start,
            None => {
                let start = (nodes.len() as u32, triangles.len() as u32);
                let originals = each_once(bottom_level(arrays, instance).1);
                let blas = Blas::build(&geometry(&originals), &BlasBuildParams::PAPER)?;
                nodes.extend(blas.nodes);
                triangles.extend(blas.triangles.iter().map(|triangle| originals[triangle.primitive as usize]));
                starts.insert(instance.first_node, start);
                start
            }
        };
        (instance.first_node, instance.first_triangle) = start;
    }
    paper.instances.replace(&instances);
    paper.blas_nodes.replace(&nodes);
    paper.triangles.replace(&triangles);
    Ok(paper)
}

/// The nodes and triangles of an instance's structure.
fn bottom_level<'a>(arrays: &'a DeviceArrays, instance: &InstanceRecord) -> (&'a [Node], Vec<Triangle>) {
    let nodes = &arrays.blas_nodes[instance.first_node as usize..];
    let is_last = |node: &Node| node.primitives.primitive_count() > 0 && node.escape_index == NONE;
    let count = nodes.iter().position(is_last).map_or(0, |last| last + 1);
    let triangles = &arrays.triangles[instance.first_triangle as usize..];
    let triangle_count = leaves(nodes).map(|(first, count)| first + count).max().unwrap_or(0);
    (&nodes[..count], triangles[..triangle_count].to_vec())
}

/// The triangles without repetitions: a structure may hold one in several leaves.
fn each_once(mut triangles: Vec<Triangle>) -> Vec<Triangle> {
    let mut seen = HashSet::new();
    triangles.retain(|triangle| seen.insert(triangle.primitive));
    triangles
}

fn geometry(triangles: &[Triangle]) -> Geometry {
    let positions: Vec<Vec3> = triangles.iter().flat_map(|t| [t.v0, t.v1, t.v2].map(Vec3::from_array)).collect();
    let indices: Vec<[u32; 3]> = (0..positions.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Geometry::new(positions, indices)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::{ImageSize, SCENES};

    #[test]
    fn the_papers_structure_holds_the_same_triangles_one_a_leaf() {
        let scene = SCENES.iter().find(|recipe| recipe.name == "sphere").unwrap().load(ImageSize::Paper).unwrap();
        let paper = paper_arrays(scene.arrays()).unwrap();
        let by_primitive = |arrays: &DeviceArrays| {
            let corners = |t: &Triangle| (t.primitive, [t.v0, t.v1, t.v2].map(|corner| corner.map(f32::to_bits)));
            arrays.triangles.iter().map(corners).collect::<BTreeMap<_, _>>()
        };
        assert_eq!(paper.triangles.len(), 10_000);
        assert_eq!(by_primitive(&paper), by_primitive(scene.arrays()));
        assert!(leaves(&paper.blas_nodes).all(|(_, count)| count == 1));
        assert_eq!(leaves(&paper.blas_nodes).count(), 10_000);
    }
}
