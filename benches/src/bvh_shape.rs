//! A triangle in the form that the crate `bvh` requires.

use glam::Vec3;
use nalgebra::Point3;

/// A triangle and its place in the tree.
pub struct Shape {
    /// The triangle's.
    pub corners: [Vec3; 3],
    /// Its index.
    pub triangle: u32,
    node: usize,
}

impl Shape {
    /// Triangles that are not in a tree yet.
    pub fn all(triangles: &[[Vec3; 3]]) -> Vec<Self> {
        (0..).zip(triangles).map(|(triangle, &corners)| Self { corners, triangle, node: 0 }).collect()
    }
}

impl bvh::aabb::Bounded<f32, 3> for Shape {
    fn aabb(&self) -> bvh::aabb::Aabb<f32, 3> {
        let [a, b, c] = self.corners;
        let point = |p: Vec3| Point3::new(p.x, p.y, p.z);
        bvh::aabb::Aabb::with_bounds(point(a.min(b).min(c)), point(a.max(b).max(c)))
    }
}

impl bvh::bounding_hierarchy::BHShape<f32, 3> for Shape {
    fn set_bh_node_index(&mut self, node: usize) {
        self.node = node;
    }

    fn bh_node_index(&self) -> usize {
        self.node
    }
}
