//! What is seen at a position of the picture.

use glam::{DVec2, DVec3};
use ropewalk::{Camera, NodeKey, Renderer, Result, Scene, View};

use crate::projection::Projection;

/// Something that was met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pick {
    pub(crate) node: NodeKey,
    /// In the world.
    pub(crate) position: DVec3,
}

/// Follows the ray of a position of the picture to the first surface: as a picture of one pixel, with depth and ids.
pub(crate) fn pick(renderer: &mut Renderer, scene: &mut Scene, view: &View, position: DVec2) -> Result<Option<Pick>> {
    let ray = Projection::of(view).ray(position);
    let probe = View {
        ray_mask: view.ray_mask,
        max_depth: 0,
        aovs: true,
        ..View::look_at(ray.origin, ray.origin + ray.direction, DVec3::Y, Camera::default(), 1, 1)
    };
    let image = renderer.render(scene, &probe)?.image()?;
    let depth = image.aovs.as_ref().and_then(|aovs| aovs.depth.first().copied()).unwrap_or(f32::INFINITY);
    let hit = image.node_at(0, 0).filter(|_| depth.is_finite());
    Ok(hit.map(|node| Pick { node, position: ray.origin + ray.direction * f64::from(depth) }))
}
