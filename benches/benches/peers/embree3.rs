//! Embree 3.13 of the distribution (Debian: `libembree-dev`), with the cargo feature `embree3`. Single rays only, since
//! that package is compiled without packets.

use std::time::Duration;

use embree3::{BufferUsage, Device, Format, GeometryKind, IntersectContext, RayHit, Scene};
use glam::Vec3;
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::rays::{RayKind, any_answer};
use ropewalk_bench::runner::Runner;
use ropewalk_bench::{Result, time};

use crate::peer::{Entry, Peer, Role};

/// A scene of one geometry, with the defaults.
pub struct Embree3(Scene<'static>);

impl Embree3 {
    pub fn build(triangles: &[[Vec3; 3]]) -> Result<Self> {
        let say = |error| format!("Embree 3: {error:?}");
        let device = Device::new().map_err(say)?;
        let mut scene = device.create_scene().map_err(say)?;
        let mut geometry = device.create_geometry(GeometryKind::TRIANGLE).map_err(say)?;
        let corners: Vec<[f32; 3]> = triangles.iter().flatten().map(|corner| corner.to_array()).collect();
        let indices: Vec<[u32; 3]> = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let mut buffer = geometry
            .set_new_buffer::<[f32; 3]>(BufferUsage::VERTEX, 0, Format::FLOAT3, 12, corners.len())
            .map_err(say)?;
        buffer.copy_from_slice(&corners);
        let mut buffer = geometry
            .set_new_buffer::<[u32; 3]>(BufferUsage::INDEX, 0, Format::UINT3, 12, indices.len())
            .map_err(say)?;
        buffer.copy_from_slice(&indices);
        scene.attach_geometry(&geometry.commit());
        scene.commit();
        Ok(Self(scene))
    }
}

impl Peer for Embree3 {
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>> {
        let name = if kind.is_any_hit() { "Embree 3 occluded1" } else { "Embree 3 intersect1" };
        let runner = Box::new(Function { scene: &self.0, rays, kind, batch: Vec::new() });
        vec![Entry { name: name.to_owned(), role: Role::Other, runner }]
    }
}

struct Function<'a> {
    scene: &'a Scene<'static>,
    rays: &'a [RayRecord],
    kind: RayKind,
    batch: Vec<RayHit>,
}

impl Runner for Function<'_> {
    fn run(&mut self) -> Duration {
        let own =
            |ray: &RayRecord| RayHit::from(embree3::Ray::segment(ray.origin, ray.direction, ray.t_min, ray.t_max));
        self.batch.clear();
        self.batch.extend(self.rays.iter().map(own));
        let mut context = IntersectContext::incoherent();
        time(|| {
            for ray in &mut self.batch {
                if self.kind.is_any_hit() {
                    self.scene.occluded(&mut context, &mut ray.ray);
                } else {
                    self.scene.intersect(&mut context, ray);
                }
            }
        })
    }

    fn answers(&self) -> Vec<f32> {
        let answer = |ray: &RayHit| {
            if self.kind.is_any_hit() {
                // After a hit, Embree sets the ray's end to minus infinity.
                any_answer(ray.ray.tfar < 0.0)
            } else if ray.hit.is_valid() {
                ray.ray.tfar
            } else {
                f32::INFINITY
            }
        };
        self.batch.iter().map(answer).collect()
    }
}
