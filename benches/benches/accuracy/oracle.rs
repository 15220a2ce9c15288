//! Ray-triangle intersection in f64, with the values of the device arrays taken as exact.

use glam::{DMat3, DVec3};
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{InstanceRecord, Node, PrimitiveRange, RayRecord, Triangle};

/// The hit of a ray in f64.
#[derive(Clone, Copy)]
pub struct Exact {
    pub instance: u32,
    /// Index into the array of triangles.
    pub triangle: u32,
    pub primitive: u32,
    pub t: f64,
}

struct LocalRay {
    origin: DVec3,
    direction: DVec3,
}

impl LocalRay {
    fn new(ray: &RayRecord) -> Self {
        Self { origin: vector(ray.origin), direction: vector(ray.direction) }
    }

    fn within(&self, instance: &InstanceRecord) -> Self {
        let rows = instance.local_from_world.map(|row| row.map(f64::from));
        let linear = DMat3::from_cols_array_2d(&rows.map(|[x, y, z, _]| [x, y, z])).transpose();
        let translation = DVec3::from_array(rows.map(|row| row[3]));
        Self { origin: linear * self.origin + translation, direction: linear * self.direction }
    }

    /// Boxes are widened by far more than f64 rounds.
    fn meets(&self, node: &Node, t_max: f64) -> bool {
        let [min, max] = [vector(node.min), vector(node.max)];
        let slack = (min.abs().max(max.abs()).max(self.origin.abs())).max_element() * 1e-9;
        let a = (min - slack - self.origin) / self.direction;
        let b = (max + slack - self.origin) / self.direction;
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        near <= far && far >= 0.0 && near <= t_max
    }

    /// Where the ray crosses the plane of a triangle, and whether within its edges.
    fn cross(&self, triangle: &Triangle) -> (f64, bool) {
        let [a, b, c] = [triangle.v0, triangle.v1, triangle.v2].map(|v| vector(v) - self.origin);
        let normal = (b - a).cross(c - a);
        let edges = [b.cross(c), c.cross(a), a.cross(b)].map(|edge| edge.dot(self.direction));
        let is_within = edges.iter().all(|&e| e >= 0.0) || edges.iter().all(|&e| e <= 0.0);
        (normal.dot(a) / normal.dot(self.direction), is_within)
    }
}

/// The closest hit of a ray from t = 0 on, by traversing the arrays' hierarchies.
pub fn closest(arrays: &DeviceArrays, ray: &RayRecord) -> Option<Exact> {
    let world = LocalRay::new(ray);
    let mut found: Option<Exact> = None;
    visit(&arrays.tlas_nodes, &world, f64::INFINITY, |leaf, _| {
        let index = leaf.first_primitive();
        let instance = &arrays.instances[index as usize];
        let local = world.within(instance);
        let t_max = found.map_or(f64::INFINITY, |hit| hit.t);
        visit(&arrays.blas_nodes[instance.first_node as usize..], &local, t_max, |leaf, mut t_max| {
            let first = instance.first_triangle + leaf.first_primitive();
            for i in first..first + leaf.primitive_count() {
                let triangle = &arrays.triangles[i as usize];
                let (t, is_within) = local.cross(triangle);
                if is_within && t >= 0.0 && t < t_max {
                    t_max = t;
                    found = Some(Exact { instance: index, triangle: i, primitive: triangle.primitive, t });
                }
            }
            t_max
        });
        found.map_or(f64::INFINITY, |hit| hit.t)
    });
    found
}

/// Shows the leaves that the ray meets before `t_max`, which `leaf` returns anew.
fn visit(nodes: &[Node], ray: &LocalRay, mut t_max: f64, mut leaf: impl FnMut(PrimitiveRange, f64) -> f64) {
    let mut index = 0;
    while let Some(node) = nodes.get(index as usize) {
        let is_met = ray.meets(node, t_max);
        index = if is_met && node.primitives == PrimitiveRange::INNER { index + 1 } else { node.escape_index };
        if is_met && node.primitives.primitive_count() > 0 {
            t_max = leaf(node.primitives, t_max);
        }
    }
}

/// The distance in f64 to the plane of a triangle, along the ray in the world, and along the ray in the instance's
/// space as f32 represents it.
pub fn distances(arrays: &DeviceArrays, ray: &RayRecord, instance: u32, triangle: u32) -> [f64; 2] {
    let exact = LocalRay::new(ray).within(&arrays.instances[instance as usize]);
    let rounded = LocalRay::new(&local_ray(arrays, ray, instance));
    [exact, rounded].map(|ray| ray.cross(&arrays.triangles[triangle as usize]).0)
}

/// The ray in an instance, rounded as the kernel does it.
pub fn local_ray(arrays: &DeviceArrays, ray: &RayRecord, instance: u32) -> RayRecord {
    let rows = arrays.instances[instance as usize].local_from_world;
    let ([ox, oy, oz], [dx, dy, dz]) = (ray.origin, ray.direction);
    RayRecord {
        origin: rows.map(|[x, y, z, w]| (x * ox + y * oy) + z * oz + w),
        direction: rows.map(|[x, y, z, _]| (x * dx + y * dy) + z * dz),
        ..*ray
    }
}

fn vector(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}
