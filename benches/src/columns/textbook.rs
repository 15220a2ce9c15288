//! What a textbook has: boxes as they are, the slab test with reciprocals, and the test of Möller and Trumbore with an
//! absolute epsilon.

use glam::{DVec3, Vec3};
use ropewalk::device::layout::RayRecord;

use super::{Column, Hit, ray_by_ray};
use crate::Result;
use crate::exact::{Tree, TreeNode, widened};

/// A determinant below this counts as that of a triangle seen edge-on.
const EPSILON: f32 = 1e-7;

/// A hierarchy of boxes over triangles, all in f32.
pub(super) struct Textbook {
    triangles: Vec<[Vec3; 3]>,
    tree: Tree,
}

impl Textbook {
    pub(super) fn build(triangles: &[[Vec3; 3]]) -> Self {
        Self { triangles: triangles.to_vec(), tree: Tree::new(&widened(triangles)) }
    }

    fn closest(&self, ray: &RayRecord) -> Option<(u32, f32)> {
        let [origin, direction] = [ray.origin, ray.direction].map(Vec3::from_array);
        let reciprocal = direction.recip();
        let enters = |found: &Option<(u32, f32)>, node: &TreeNode| {
            let t_max = found.map_or(ray.t_max, |(_, t)| t);
            // Corners came from f32, so that nothing is rounded here.
            let [min, max] = [node.min, node.max].map(DVec3::as_vec3);
            let (a, b) = ((min - origin) * reciprocal, (max - origin) * reciprocal);
            let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
            near.max(ray.t_min) <= far.min(t_max)
        };
        let mut found = None;
        self.tree.visit(&mut found, enters, |found, item| {
            let t_max = found.map_or(ray.t_max, |(_, t)| t);
            if let Some(t) = meet([origin, direction], &self.triangles[item as usize])
                && (ray.t_min..=t_max).contains(&t)
            {
                *found = Some((item, t));
            }
        });
        found
    }
}

/// T. Möller, B. Trumbore, *Fast, Minimum Storage Ray/Triangle Intersection* (1997), without culling.
fn meet([origin, direction]: [Vec3; 2], [v0, v1, v2]: &[Vec3; 3]) -> Option<f32> {
    let (edge_1, edge_2) = (v1 - v0, v2 - v0);
    let p = direction.cross(edge_2);
    let determinant = edge_1.dot(p);
    if determinant.abs() < EPSILON {
        return None;
    }
    let to_origin = origin - v0;
    let u = to_origin.dot(p) / determinant;
    let q = to_origin.cross(edge_1);
    let v = direction.dot(q) / determinant;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then(|| edge_2.dot(q) / determinant)
}

impl Column for Textbook {
    fn closest(&self, rays: &[RayRecord]) -> Result<Vec<Hit>> {
        Ok(ray_by_ray(rays, |ray| Self::closest(self, ray)))
    }
}
