//! The kernel's queries as text for an application's own compute shader.

use super::{ARRAY_COUNT, KernelVariant, MATERIALS, OPAQUE_STUBS, SURFACES};
use crate::device::Needs;
use crate::trace::Traversal;

/// WGSL with which a compute shader of the application's traces rays through the scene, and what it binds for that.
///
/// It declares the types and bindings of the scene and these functions:
///
/// | | |
/// |---|---|
/// | `closest_hit(ray: RayRecord, ray_mask: u32) -> Hit` | the closest hit; `instance == NONE` for none |
/// | `any_hit(ray: RayRecord, ray_mask: u32) -> bool` | whether anything lets no light through |
/// | `transmittance(ray: RayRecord, ray_mask: u32) -> vec3<f32>` | how much light gets through |
/// | `surface_at(hit: Hit, direction: vec3<f32>) -> Surface` | position, normals and material, as seen along the direction; only with [`surfaces`](Self::surfaces) |
/// | `leave(surface: Surface, direction: vec3<f32>) -> vec3<f32>` | where a ray starts that goes on from there; as above |
///
/// with the types `RayRecord { origin, t_min, direction, t_max }`, whose positions are relative to the
/// [render origin](crate::Renderer::render_origin), `Hit { t, u, v, instance, primitive, triangle, back }`, and `Surface { position, normal,
/// geometric_normal, base_color, emissive, metallic, roughness, .. }`. The whole is what frames are traced with: see `shaders/shared/`.
///
/// The names that it declares at module scope are not to be declared again: prefix your own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Include {
    /// The bind group that the scene is bound to.
    pub group: u32,
    /// Whether the shader asks for surfaces, which takes more bindings.
    pub surfaces: bool,
    /// What the scene needs and how it is bound.
    pub variant: KernelVariant,
}

/// The bindings that rays need: both levels, instances and triangles.
const HIT_BINDINGS: [u32; 4] = [0, 1, 2, 3];
/// Of the geometries, which say where wide nodes start.
const GEOMETRIES: u32 = 4;
/// Of the lights, which no query asks for.
const LIGHTS: u32 = 12;

impl Include {
    /// The text, to stand before or after the application's own.
    pub fn source(&self) -> String {
        let materials = if self.reads_materials() { &MATERIALS[..] } else { &OPAQUE_STUBS[..] };
        let surfaces = if self.surfaces { &SURFACES[..] } else { &[] };
        let source =
            self.variant.preamble() + &[&self.variant.scene_files()[..], materials, surfaces].concat().concat();
        source.replace("@group(0)", &format!("@group({})", self.group))
    }

    /// The bindings that the text uses.
    pub fn bindings(&self) -> Vec<u32> {
        let arrays = (0..ARRAY_COUNT).filter(|binding| match *binding {
            LIGHTS => false,
            GEOMETRIES if self.variant.traversal == Traversal::Wide => true,
            other => self.reads_materials() || HIT_BINDINGS.contains(&other),
        });
        arrays.chain(ARRAY_COUNT..ARRAY_COUNT + self.variant.splits.extra_bindings()).collect()
    }

    /// Whether anything depends on what a material is.
    fn reads_materials(&self) -> bool {
        self.surfaces || self.variant.needs.intersects(Needs::ALPHA_MASK | Needs::BLEND | Needs::REFRACTION)
    }
}
