//! The kernel's queries as WGSL for an application's own compute shader.

use super::{ARRAY_COUNT, KernelVariant, MATERIALS, OPAQUE_STUBS, SURFACES};
use crate::device::Needs;
use crate::trace::Traversal;

/// A WGSL source to prepend to an application's compute shader, with the scene's types, bindings and ray queries, and
/// the bindings it needs. Made by `GpuTracer::include` for an uploaded scene.
///
/// It declares the types and bindings of the scene and these functions:
///
/// - `closest_hit(ray: RayRecord, ray_mask: u32) -> HitRecord`: the closest hit; `instance == NONE` for a miss.
/// - `any_hit(ray: RayRecord, ray_mask: u32) -> bool`: whether the ray hits an opaque surface between `t_min` and
///   `t_max`.
/// - `transmittance(ray: RayRecord, ray_mask: u32) -> vec3<f32>`: the share of light, per colour channel, that arrives
///   at the ray's origin from its other end. Single-sided triangles let light pass that comes from behind them.
/// - `surface_at(hit: HitRecord, direction: vec3<f32>) -> Surface`: position, normals and material at a hit of a ray of
///   that direction. Only [with surfaces](Self::with_surfaces).
/// - `offset_ray_origin(surface: Surface, direction: vec3<f32>) -> vec3<f32>`: the origin of a secondary ray of that
///   direction, offset against hitting the surface itself. Only with surfaces.
///
/// Their types are `RayRecord { origin, t_min, direction, t_max }`, whose positions are relative to the [render
/// origin](crate::Renderer::render_origin), `HitRecord { t, u, v, instance, primitive, triangle, back_face }`, and
/// `Surface { position, normal, geometric_normal, base_color, emissive, metallic, roughness, .. }`. Frames are traced
/// by the same source: see `shaders/shared/`.
///
/// Do not declare again the names that it declares at module scope: prefix your own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct Include {
    /// The bind group of the scene.
    pub group: u32,
    /// Whether the source has `surface_at` and `offset_ray_origin`, which need more bindings.
    pub surfaces: bool,
    /// The needs, the traversal and the splits of the scene.
    pub variant: KernelVariant,
}

/// The bindings of every query: TLAS nodes, instances, BLAS nodes and triangles.
const HIT_BINDINGS: [u32; 4] = [0, 1, 2, 3];
/// Binding of `geometries` (wide traversal reads `first_wide_node`).
const GEOMETRIES: u32 = 4;
/// Binding of `lights`, unused by queries.
const LIGHTS: u32 = 12;

impl Include {
    /// An include for scenes of this variant, in bind group 0 and without surfaces.
    pub fn new(variant: impl Into<KernelVariant>) -> Self {
        Self { group: 0, surfaces: false, variant: variant.into() }
    }

    /// Binds the scene as this group.
    #[must_use]
    pub fn in_group(self, group: u32) -> Self {
        Self { group, ..self }
    }

    /// Adds `surface_at` and `offset_ray_origin`, which need the bindings of materials, textures and vertex attributes.
    #[must_use]
    pub fn with_surfaces(self) -> Self {
        Self { surfaces: true, ..self }
    }

    /// The WGSL source, to stand before or after the application's own.
    pub fn source(&self) -> String {
        let materials = if self.reads_materials() { &MATERIALS[..] } else { &OPAQUE_STUBS[..] };
        let surfaces = if self.surfaces { &SURFACES[..] } else { &[] };
        let source =
            self.variant.preamble() + &[&self.variant.scene_files()[..], materials, surfaces].concat().concat();
        // The files declare the scene as group 0; put the application's group in its place.
        source.replace("@group(0)", &format!("@group({})", self.group))
    }

    /// The bindings that the source uses, in ascending order.
    pub fn bindings(&self) -> Vec<u32> {
        let arrays = (0..ARRAY_COUNT).filter(|binding| match *binding {
            LIGHTS => false,
            GEOMETRIES if self.variant.traversal == Traversal::Wide => true,
            other => self.reads_materials() || HIT_BINDINGS.contains(&other),
        });
        arrays.chain(ARRAY_COUNT..ARRAY_COUNT + self.variant.splits.extra_bindings()).collect()
    }

    /// Whether the source reads material bindings.
    fn reads_materials(&self) -> bool {
        self.surfaces || self.variant.needs.intersects(Needs::ALPHA_MASK | Needs::BLEND | Needs::REFRACTION)
    }
}
