//! From the graph's values to the device's: pure functions, one a device type.

use glam::{DAffine3, DVec3, Vec4};
use slotmap::Key as _;

use crate::accel::SupportFunction;
use crate::device::layout::{self, InstanceFlags, InstanceRecord, MaterialFlags, TextureFlags, TextureInfo};
use crate::device::{MAX_MIRROR_ROUGHNESS, Needs};
use crate::graph::{AlphaMode, FilterMode, Light, LightKind, Material, NodeKey, Texture, TextureRef, WrapMode};
use crate::math::Aabb;

/// Where an instance is, for its device record.
pub(super) struct InstanceTransform {
    /// Rows of `local_from_world` and `world_from_local`, world relative to the render origin.
    local_from_world: [[f32; 4]; 3],
    world_from_local: [[f32; 4]; 3],
    /// The box around the instance in that world.
    pub(super) bounds: Aabb,
}

impl InstanceTransform {
    /// Places a geometry that reaches as far as `support` says. `None` if the matrix is singular, or if it or its inverse does not
    /// fit f32: such a geometry cannot be hit.
    ///
    /// What the device sees is the geometry under the *inverse of the rounded* `local_from_world`, so the box is
    /// computed from that, and then widened by the rounding of the ray transform: each local coordinate of a point x is off
    /// by less than 4 ulp of `|local_from_world| |x| + |translation|`, which the inverse takes back to the world.
    pub(super) fn new(world_from_local: &DAffine3, origin: DVec3, support: &SupportFunction) -> Option<Self> {
        let mut relative = *world_from_local;
        relative.translation -= origin;
        let determinant = relative.matrix3.determinant();
        if determinant == 0.0 || !determinant.is_finite() {
            return None;
        }
        let local_from_world = relative.inverse().as_affine3();
        let device = local_from_world.as_daffine3();
        let effective = device.inverse();
        let world_from_local = effective.as_affine3();
        if !(local_from_world.is_finite() && world_from_local.is_finite() && effective.is_finite()) {
            return None;
        }

        let world = support.world_bounds(&effective);
        let corner = world.min.abs().max(world.max.abs());
        let local_error = device.matrix3.abs() * corner + device.translation.abs();
        let slack = effective.matrix3.abs() * local_error * (4.0 * f64::from(f32::EPSILON));
        let (min, max) = (world.min - slack, world.max + slack);
        let bounds = Aabb { min: min.as_vec3(), max: max.as_vec3() };
        let fits = bounds.min.is_finite() && bounds.max.is_finite();
        fits.then(|| Self {
            local_from_world: affine_rows(&local_from_world),
            world_from_local: affine_rows(&world_from_local),
            bounds,
        })
    }

    /// The device record. `first_*`, `geometry` and `material` are indices into the arrays of those names.
    pub(super) fn instance(
        &self,
        [first_node, first_triangle, geometry, material]: [u32; 4],
        mask: u32,
        flags: InstanceFlags,
        node: NodeKey,
    ) -> InstanceRecord {
        let key = node.data().as_ffi();
        InstanceRecord {
            local_from_world: self.local_from_world,
            world_from_local: self.world_from_local,
            first_node,
            first_triangle,
            geometry,
            material,
            mask,
            flags: flags.bits(),
            node_key: [key as u32, (key >> 32) as u32],
        }
    }
}

/// The device record of a material whose textures (base colour, metallic-roughness, emissive, transmission, normal) are
/// at these indices of `texture_infos`.
pub(super) fn material_record(material: &Material, textures: [u32; 5]) -> layout::MaterialRecord {
    let mut flags = MaterialFlags::empty();
    flags.set(MaterialFlags::MASK, matches!(material.alpha_mode, AlphaMode::Mask { .. }));
    flags.set(MaterialFlags::BLEND, material.alpha_mode == AlphaMode::Blend);
    flags.set(MaterialFlags::UNLIT, material.unlit);
    let [base_color_texture, metallic_roughness_texture, emissive_texture, transmission_texture, normal_texture] =
        textures;
    layout::MaterialRecord {
        base_color: material.base_color.to_array(),
        emissive: material.emissive.to_array(),
        metallic: material.metallic,
        roughness: material.roughness,
        transmission: material.transmission,
        ior: material.ior,
        alpha_cutoff: if let AlphaMode::Mask { cutoff } = material.alpha_mode { cutoff } else { 0.0 },
        flags: flags.bits(),
        base_color_texture,
        metallic_roughness_texture,
        emissive_texture,
        transmission_texture,
        normal_texture,
        normal_scale: material.normal_scale,
        _pad: 0,
    }
}

/// What traversal must know of an instance of this material.
pub(super) fn instance_flags(material: &Material) -> InstanceFlags {
    let transmissive = material.transmission > 0.0;
    let mask = matches!(material.alpha_mode, AlphaMode::Mask { .. });
    let blend = material.alpha_mode == AlphaMode::Blend;
    let mut flags = InstanceFlags::empty();
    flags.set(InstanceFlags::CULL_BACK, !material.double_sided && !transmissive);
    flags.set(InstanceFlags::ALPHA_MASK, mask);
    flags.set(InstanceFlags::TRANSLUCENT, mask || blend || transmissive);
    flags
}

/// What this material needs of the kernel.
pub(super) fn needs(material: &Material) -> Needs {
    let textured = [
        material.base_color_texture,
        material.metallic_roughness_texture,
        material.emissive_texture,
        material.transmission_texture,
        material.normal_texture,
    ];
    // A texture only ever lowers roughness and metallic (its texels are at most 1), so it can make a mirror.
    let sharp = material.roughness < MAX_MIRROR_ROUGHNESS || material.metallic_roughness_texture.is_some();
    let transmissive = material.transmission > 0.0;
    let mut needs = Needs::empty();
    needs.set(Needs::TEXTURES, textured.iter().any(Option::is_some));
    needs.set(Needs::NORMAL_TEXTURES, material.normal_texture.is_some());
    needs.set(Needs::ALPHA_MASK, matches!(material.alpha_mode, AlphaMode::Mask { .. }));
    needs.set(Needs::BLEND, material.alpha_mode == AlphaMode::Blend);
    needs.set(Needs::REFLECTION, !material.unlit && (sharp || transmissive));
    needs.set(Needs::REFRACTION, transmissive);
    needs.set(Needs::CULLING, instance_flags(material).contains(InstanceFlags::CULL_BACK));
    needs
}

/// The device record of a texture as one material slot uses it.
pub(super) fn texture_record(
    reference: &TextureRef,
    texture: &Texture,
    first_texel: u32,
    color_space: TextureFlags,
) -> TextureInfo {
    let [x, y] = [reference.transform.matrix2.x_axis, reference.transform.matrix2.y_axis];
    let translation = reference.transform.translation;
    let sampler = reference.sampler;
    let mut flags = color_space;
    flags.set(TextureFlags::MIRROR_U, sampler.wrap_u == WrapMode::Mirror);
    flags.set(TextureFlags::CLAMP_U, sampler.wrap_u == WrapMode::Clamp);
    flags.set(TextureFlags::MIRROR_V, sampler.wrap_v == WrapMode::Mirror);
    flags.set(TextureFlags::CLAMP_V, sampler.wrap_v == WrapMode::Clamp);
    flags.set(TextureFlags::NEAREST, sampler.filter == FilterMode::Nearest);
    flags.set(TextureFlags::TEX_COORD_1, reference.tex_coord == 1);
    TextureInfo {
        row_u: [x.x, y.x, translation.x, 0.0],
        row_v: [x.y, y.y, translation.y, 0.0],
        first_texel,
        width: texture.width,
        height: texture.height,
        flags: flags.bits(),
    }
}

/// The device record of a light at `world_from_local`; `None` if it gives no light, or is beyond what f32 holds.
pub(super) fn light_record(light: &Light, world_from_local: &DAffine3, origin: DVec3) -> Option<layout::LightRecord> {
    let color = light.color * light.intensity;
    // A light whose node is scaled to nothing keeps its place and loses its direction.
    let direction = (-world_from_local.matrix3.z_axis).try_normalize();
    let position = (world_from_local.translation - origin).as_vec3();
    let is_usable = position.is_finite() && color.is_finite();
    if !is_usable || color == glam::Vec3::ZERO || (direction.is_none() && light.kind != LightKind::Point) {
        return None;
    }
    let (kind, cone_scale, cone_offset) = match light.kind {
        LightKind::Point => (layout::LIGHT_POINT, 0.0, 1.0),
        LightKind::Directional => (layout::LIGHT_DIRECTIONAL, 0.0, 1.0),
        LightKind::Spot { inner_cone_angle, outer_cone_angle } => {
            // Equal angles would divide by zero; an ulp of the cosine is a sharp edge.
            let (inner, outer) = (inner_cone_angle.cos(), outer_cone_angle.cos());
            let scale = 1.0 / (inner - outer).max(f32::EPSILON);
            (layout::LIGHT_SPOT, scale, -outer * scale)
        }
    };
    Some(layout::LightRecord {
        position: position.to_array(),
        kind,
        direction: direction.unwrap_or(DVec3::NEG_Z).as_vec3().to_array(),
        range: light.range.unwrap_or(f32::MAX),
        color: color.to_array(),
        cone_scale,
        cone_offset,
        _pad0: 0,
        _pad1: 0,
        _pad2: 0,
    })
}

/// Four 16-bit unorms, red lowest.
pub(super) fn pack_color(color: Vec4) -> [u32; 2] {
    let [r, g, b, a] = color.to_array().map(|c| (c.clamp(0.0, 1.0) * 65535.0 + 0.5) as u32);
    [r | g << 16, b | a << 16]
}

fn affine_rows(affine: &glam::Affine3) -> [[f32; 4]; 3] {
    let [x, y, z] = [affine.matrix3.x_axis, affine.matrix3.y_axis, affine.matrix3.z_axis];
    let t = affine.translation;
    [[x.x, y.x, z.x, t.x], [x.y, y.y, z.y, t.y], [x.z, y.z, z.z, t.z]]
}
