//! The crates `obvhs`, `bvh` and `parry3d`: a structure of each over triangles, and one ray through it.

use std::time::Duration;

use glam::Vec3;
use nalgebra::{Point3, Vector3};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::RayHit;
use obvhs::rt_triangle::RtTriangle;
use parry3d::shape::{CompositeShapeRef, TriMesh};
use ropewalk::device::layout::RayRecord;

use crate::Result;
use crate::bvh_shape::Shape;
use crate::rays::meet;

/// The eight-wide compressed BVH of `obvhs`.
pub struct Obvhs {
    bvh: CwBvh,
    /// In the order of the leaves.
    triangles: Vec<RtTriangle>,
}

impl Obvhs {
    /// With the preset "medium".
    pub fn build(triangles: &[[Vec3; 3]]) -> Self {
        Self::build_with(triangles, BvhBuildParams::medium_build())
    }

    /// With any preset.
    pub fn build_with(triangles: &[[Vec3; 3]], params: BvhBuildParams) -> Self {
        let triangles: Vec<_> = triangles
            .iter()
            .map(|corners| {
                let [v0, v1, v2] = corners.map(Into::into);
                obvhs::triangle::Triangle { v0, v1, v2 }
            })
            .collect();
        let bvh = build_cwbvh_from_tris(&triangles, params, &mut Duration::default());
        let triangles = bvh.primitive_indices.iter().map(|&i| (&triangles[i as usize]).into()).collect();
        Self { bvh, triangles }
    }

    /// A ray as it takes it.
    pub fn ray(ray: &RayRecord) -> obvhs::ray::Ray {
        let [origin, direction] = [ray.origin, ray.direction].map(Vec3::from_array);
        obvhs::ray::Ray::new(origin.into(), direction.into(), ray.t_min, ray.t_max)
    }

    /// The triangle that is hit first, and where.
    pub fn closest(&self, ray: &obvhs::ray::Ray) -> Option<(u32, f32)> {
        let mut hit = RayHit::none();
        let is_hit = self.bvh.ray_traverse(*ray, &mut hit, |ray, i| self.triangles[i].intersect(ray));
        is_hit.then(|| (self.bvh.primitive_indices[hit.primitive_id as usize], hit.t))
    }

    /// Whether there is a hit.
    pub fn any(&self, ray: &obvhs::ray::Ray) -> bool {
        !self.bvh.ray_traverse_miss(*ray, |ray, i| self.triangles[i].intersect(ray))
    }
}

/// The crate `bvh`: its own triangle test culls back faces and misses small triangles, so that of Möller and Trumbore
/// is used.
pub struct Bvh {
    bvh: bvh::bvh::Bvh<f32, 3>,
    shapes: Vec<Shape>,
}

impl Bvh {
    /// With its defaults.
    pub fn build(triangles: &[[Vec3; 3]]) -> Self {
        let mut shapes = Shape::all(triangles);
        Self { bvh: bvh::bvh::Bvh::build(&mut shapes), shapes }
    }

    /// A ray as it takes it.
    pub fn ray(ray: &RayRecord) -> bvh::ray::Ray<f32, 3> {
        bvh::ray::Ray::new(Point3::from(ray.origin), Vector3::from(ray.direction))
    }

    /// The triangle that is hit first, and where. The ray is given in both formats.
    pub fn closest(&self, ray: &RayRecord, own: &bvh::ray::Ray<f32, 3>) -> Option<(u32, f32)> {
        let mut best = None;
        // `meet` excludes the end of the range.
        let mut t_max = ray.t_max.next_up();
        for shape in self.bvh.nearest_traverse_iterator(own, &self.shapes) {
            let entry = own.intersection_slice_for_aabb(&bvh::aabb::Bounded::aabb(shape));
            if entry.is_some_and(|(t, _)| t > t_max) {
                break;
            }
            if let Some(t) = meet(ray, &shape.corners, t_max) {
                (best, t_max) = (Some((shape.triangle, t)), t);
            }
        }
        best
    }

    /// Whether there is a hit.
    pub fn any(&self, ray: &RayRecord, own: &bvh::ray::Ray<f32, 3>) -> bool {
        self.bvh.traverse_iterator(own, &self.shapes).any(|shape| meet(ray, &shape.corners, ray.t_max).is_some())
    }
}

/// The triangle mesh of `parry3d`. Its rays start at t = 0, and it knows no any-hit ray.
pub struct Parry(TriMesh);

impl Parry {
    /// With its defaults.
    ///
    /// # Errors
    /// That of the crate.
    pub fn build(triangles: &[[Vec3; 3]]) -> Result<Self> {
        let corner = |p: &Vec3| parry3d::math::Vector::new(p.x, p.y, p.z);
        let corners = triangles.iter().flatten().map(corner).collect();
        let indices = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Ok(Self(TriMesh::new(corners, indices).map_err(|error| format!("parry3d: {error}"))?))
    }

    /// A ray as it takes it.
    pub fn ray(ray: &RayRecord) -> parry3d::query::Ray {
        let [origin, direction] = [ray.origin, ray.direction].map(|[x, y, z]| parry3d::math::Vector::new(x, y, z));
        parry3d::query::Ray::new(origin, direction)
    }

    /// The triangle that is hit first, and where.
    pub fn closest(&self, ray: &parry3d::query::Ray, t_max: f32) -> Option<(u32, f32)> {
        CompositeShapeRef(&self.0).cast_local_ray(ray, t_max, false)
    }
}
