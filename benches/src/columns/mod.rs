//! Tracers beside each other: each takes the same rays and names the triangle that each of them hits.

mod embree;
mod ours;
mod peers;
mod textbook;

use glam::Vec3;
use rayon::prelude::*;
use ropewalk::device::layout::{NONE, RayRecord};

#[cfg(feature = "gpu")]
pub use ours::TracedByGpu;
pub use ours::{Executor, Placed, Traced, soup};

use crate::Result;
use crate::embree::Embree;
use crate::peers::{Bvh, Obvhs, Parry};
use textbook::Textbook;

/// A hit of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// The triangle's index, or [`NONE`].
    pub primitive: u32,
    /// In units of the ray's direction.
    pub t: f64,
}

impl Hit {
    /// No hit.
    pub const MISS: Self = Self { primitive: NONE, t: f64::INFINITY };
}

/// A tracer with its structure over some triangles.
pub trait Column: Sync {
    /// What each ray hits first.
    ///
    /// # Errors
    /// The tracer cannot be asked this, and why.
    fn closest(&self, rays: &[RayRecord]) -> Result<Vec<Hit>>;
}

/// The names of the columns that [`peer`] builds.
pub const PEERS: [&str; 6] = ["textbook", "obvhs", "bvh", "parry3d", "Embree", "Embree robust"];

/// One of [`PEERS`] over these triangles. Embree is one that was [opened](Embree::open), or why there is none.
///
/// # Errors
/// It cannot be built.
pub fn peer<'a>(
    name: &str,
    triangles: &[[Vec3; 3]],
    embree: std::result::Result<&'a Embree, &str>,
) -> Result<Box<dyn Column + 'a>> {
    Ok(match name {
        "textbook" => Box::new(Textbook::build(triangles)),
        "obvhs" => Box::new(Obvhs::build(triangles)),
        "bvh" => Box::new(Bvh::build(triangles)),
        "parry3d" => Box::new(Parry::build(triangles)?),
        _ => Box::new(embree::column(embree?, triangles, name == "Embree robust")?),
    })
}

/// Traces each ray by itself, on all threads.
fn ray_by_ray(rays: &[RayRecord], trace: impl Fn(&RayRecord) -> Option<(u32, f32)> + Sync) -> Vec<Hit> {
    let hit = |found: Option<(u32, f32)>| found.map_or(Hit::MISS, |(primitive, t)| Hit { primitive, t: t.into() });
    rays.par_iter().map(|ray| hit(trace(ray))).collect()
}
