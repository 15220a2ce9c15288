//! Embree 4, single rays and packets of 16: with its defaults, with high build quality, and watertight ("robust").

use std::time::Duration;

use glam::Vec3;
use ropewalk::device::layout::RayRecord;
use ropewalk_bench::embree::{Any1, Any16, Batch, Closest1, Closest16, Embree, Quality, Scene};
use ropewalk_bench::rays::RayKind;
use ropewalk_bench::runner::Runner;
use ropewalk_bench::{Result, time};

use crate::peer::{Entry, Peer, Role};

/// Its scenes: with the defaults, of high quality, and robust.
pub struct Embree4<'a>([Scene<'a>; 3]);

impl<'a> Embree4<'a> {
    pub fn build(embree: &'a Embree, triangles: &[[Vec3; 3]]) -> Result<Self> {
        Ok(Self([
            embree.scene(triangles, Quality::Medium, false)?,
            embree.scene(triangles, Quality::High, false)?,
            embree.scene(triangles, Quality::Medium, true)?,
        ]))
    }
}

impl Peer for Embree4<'_> {
    fn entries<'a>(&'a self, rays: &'a [RayRecord], kind: RayKind) -> Vec<Entry<'a>> {
        let [medium, high, robust] = &self.0;
        let best = kind.is_coherent();
        vec![
            embree_1("", Role::Embree1, medium, rays, kind),
            embree_16("", Role::Embree16, medium, rays, kind, false),
            embree_16(", coherent", Role::Embree16Coherent, medium, rays, kind, true),
            embree_1(", high quality", Role::Other, high, rays, kind),
            embree_16(", high quality", Role::Other, high, rays, kind, best),
            embree_1(", robust", Role::Other, robust, rays, kind),
            embree_16(", robust", Role::Other, robust, rays, kind, best),
        ]
    }
}

fn embree_1<'a>(how: &str, role: Role, scene: &'a Scene<'a>, rays: &'a [RayRecord], kind: RayKind) -> Entry<'a> {
    if kind.is_any_hit() {
        let runner = Box::new(Function::<Any1>::new(scene, rays, false));
        return Entry { name: format!("Embree 4 occluded1{how}"), role, runner };
    }
    let runner = Box::new(Function::<Closest1>::new(scene, rays, false));
    Entry { name: format!("Embree 4 intersect1{how}"), role, runner }
}

fn embree_16<'a>(
    how: &str,
    role: Role,
    scene: &'a Scene<'a>,
    rays: &'a [RayRecord],
    kind: RayKind,
    is_coherent: bool,
) -> Entry<'a> {
    if kind.is_any_hit() {
        let runner = Box::new(Function::<Any16>::new(scene, rays, is_coherent));
        return Entry { name: format!("Embree 4 occluded16{how}"), role, runner };
    }
    let runner = Box::new(Function::<Closest16>::new(scene, rays, is_coherent));
    Entry { name: format!("Embree 4 intersect16{how}"), role, runner }
}

/// One of Embree's functions.
struct Function<'a, B> {
    scene: &'a Scene<'a>,
    rays: &'a [RayRecord],
    is_coherent: bool,
    batch: B,
}

impl<'a, B: Batch + Default> Function<'a, B> {
    fn new(scene: &'a Scene<'a>, rays: &'a [RayRecord], is_coherent: bool) -> Self {
        Self { scene, rays, is_coherent, batch: B::default() }
    }
}

impl<B: Batch> Runner for Function<'_, B> {
    fn run(&mut self) -> Duration {
        self.batch.write(self.rays);
        time(|| self.batch.trace(self.scene, self.is_coherent))
    }

    fn answers(&self) -> Vec<f32> {
        self.batch.answers()
    }
}
