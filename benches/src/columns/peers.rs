//! The crates `obvhs`, `bvh` and `parry3d` as columns.

use ropewalk::device::layout::RayRecord;

use super::{Column, Hit, ray_by_ray};
use crate::Result;
use crate::peers::{Bvh, Obvhs, Parry};

impl Column for Obvhs {
    fn closest(&self, rays: &[RayRecord]) -> Result<Vec<Hit>> {
        Ok(ray_by_ray(rays, |ray| self.closest(&Self::ray(ray))))
    }
}

impl Column for Bvh {
    fn closest(&self, rays: &[RayRecord]) -> Result<Vec<Hit>> {
        Ok(ray_by_ray(rays, |ray| self.closest(ray, &Self::ray(ray))))
    }
}

impl Column for Parry {
    fn closest(&self, rays: &[RayRecord]) -> Result<Vec<Hit>> {
        if rays.iter().any(|ray| ray.t_min > 0.0) {
            return Err("its rays all start at t = 0".into());
        }
        Ok(ray_by_ray(rays, |ray| self.closest(&Self::ray(ray), ray.t_max)))
    }
}
