//! Crates: `obvhs`, `bvh`, `parry3d`. None of them has packets.

use std::time::Duration;

use glam::Vec3;
use nalgebra::{Point3, Vector3};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::RayHit;
use obvhs::rt_triangle::RtTriangle;
use parry3d::query::RayCast as _;
use parry3d::shape::TriMesh;
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::Result;
use ropewalk_bench::bvh_shape::Shape;
use ropewalk_bench::rays::{RayKind, any_answer, meet};
use ropewalk_bench::runner::Runner;

use crate::peer::{Entry, Peer, RayByRay, Role};

fn entry<'a>(name: &str, runner: impl Runner + 'a) -> Entry<'a> {
    Entry { name: name.to_owned(), role: Role::Other, runner: Box::new(runner) }
}

/// The eight-wide compressed BVH of `obvhs`, with two of its presets.
pub struct Obvhs([(&'static str, CwBvh, Vec<RtTriangle>); 2]);

impl Obvhs {
    pub fn build(triangles: &[[Vec3; 3]]) -> Self {
        let triangles: Vec<_> = triangles
            .iter()
            .map(|corners| {
                let [v0, v1, v2] = corners.map(Into::into);
                obvhs::triangle::Triangle { v0, v1, v2 }
            })
            .collect();
        let presets =
            [("obvhs, medium", BvhBuildParams::medium_build()), ("obvhs, slow", BvhBuildParams::slow_build())];
        Self(presets.map(|(name, params)| {
            let bvh = build_cwbvh_from_tris(&triangles, params, &mut Duration::default());
            let in_order = bvh.primitive_indices.iter().map(|&i| (&triangles[i as usize]).into()).collect();
            (name, bvh, in_order)
        }))
    }
}

impl Peer for Obvhs {
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>> {
        let own = |ray: &RayRecord| {
            let [origin, direction] = [ray.origin, ray.direction].map(Vec3::from_array);
            obvhs::ray::Ray::new(origin.into(), direction.into(), ray.t_min, ray.t_max)
        };
        let entries = self.0.iter().map(|(name, bvh, triangles)| {
            let rays = rays.iter().map(own).collect();
            let trace = move |ray: &obvhs::ray::Ray| {
                if kind.is_any_hit() {
                    return any_answer(!bvh.ray_traverse_miss(*ray, |ray, i| triangles[i].intersect(ray)));
                }
                let mut hit = RayHit::none();
                let is_hit = bvh.ray_traverse(*ray, &mut hit, |ray, i| triangles[i].intersect(ray));
                if is_hit { hit.t } else { f32::INFINITY }
            };
            entry(name, RayByRay::new(rays, trace))
        });
        entries.collect()
    }
}

/// The crate `bvh`: its own triangle test culls back faces and misses small triangles, so ours is used.
pub struct Bvh {
    bvh: bvh::bvh::Bvh<f32, 3>,
    shapes: Vec<Shape>,
}

impl Bvh {
    pub fn build(triangles: &[[Vec3; 3]]) -> Self {
        let mut shapes: Vec<Shape> = triangles.iter().copied().map(Shape::new).collect();
        Self { bvh: bvh::bvh::Bvh::build(&mut shapes), shapes }
    }

    fn closest(&self, ray: &RayRecord, own: &bvh::ray::Ray<f32, 3>) -> f32 {
        let mut best = f32::INFINITY;
        for shape in self.bvh.nearest_traverse_iterator(own, &self.shapes) {
            let entry = own.intersection_slice_for_aabb(&bvh::aabb::Bounded::aabb(shape));
            if entry.is_some_and(|(t, _)| t > best) {
                break;
            }
            best = meet(ray, &shape.corners, best).unwrap_or(best);
        }
        best
    }

    fn any(&self, ray: &RayRecord, own: &bvh::ray::Ray<f32, 3>) -> bool {
        self.bvh.traverse_iterator(own, &self.shapes).any(|shape| meet(ray, &shape.corners, ray.t_max).is_some())
    }
}

impl Peer for Bvh {
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>> {
        let own = |ray: &RayRecord| {
            let direction = Vector3::from(ray.direction);
            (*ray, bvh::ray::Ray::new(Point3::from(ray.origin), direction))
        };
        let trace = move |(ray, own): &(RayRecord, bvh::ray::Ray<f32, 3>)| {
            if kind.is_any_hit() { any_answer(self.any(ray, own)) } else { self.closest(ray, own) }
        };
        vec![entry("bvh", RayByRay::new(rays.iter().map(own).collect(), trace))]
    }
}

/// The triangle mesh of `parry3d`. It knows no any-hit ray.
pub struct Parry(TriMesh);

impl Parry {
    pub fn build(triangles: &[[Vec3; 3]]) -> Result<Self> {
        let corner = |p: &Vec3| parry3d::math::Vector::new(p.x, p.y, p.z);
        let corners = triangles.iter().flatten().map(corner).collect();
        let indices = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Ok(Self(TriMesh::new(corners, indices).map_err(|error| format!("parry3d: {error}"))?))
    }
}

impl Peer for Parry {
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>> {
        let own = |ray: &RayRecord| {
            let [origin, direction] = [ray.origin, ray.direction].map(|[x, y, z]| parry3d::math::Vector::new(x, y, z));
            (parry3d::query::Ray::new(origin, direction), ray.t_max)
        };
        let trace = move |(ray, t_max): &(parry3d::query::Ray, f32)| {
            let t = self.0.cast_local_ray(ray, *t_max, false);
            if kind.is_any_hit() { any_answer(t.is_some()) } else { t.unwrap_or(f32::INFINITY) }
        };
        vec![entry("parry3d", RayByRay::new(rays.iter().map(own).collect(), trace))]
    }
}
