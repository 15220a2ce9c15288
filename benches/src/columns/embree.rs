//! Embree 4, single rays, as a column: with its defaults, or robust.

use glam::Vec3;
use ropewalk::device::layout::RayRecord;

use super::{Column, Hit};
use crate::Result;
use crate::embree::{Batch as _, Closest1, Embree, Quality, Scene};

pub(super) fn column<'a>(embree: &'a Embree, triangles: &[[Vec3; 3]], robust: bool) -> Result<Scene<'a>> {
    embree.scene(triangles, Quality::Medium, robust)
}

impl Column for Scene<'_> {
    fn closest(&self, rays: &[RayRecord]) -> Result<Vec<Hit>> {
        let mut batch = Closest1::default();
        batch.write(rays);
        batch.trace(self, false);
        Ok(batch.hits().map(|hit| hit.map_or(Hit::MISS, |(primitive, t)| Hit { primitive, t: t.into() })).collect())
    }
}
