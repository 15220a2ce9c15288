//! Pure functions from scene-graph values to device records, one for each record type.

use glam::{DAffine3, DMat3, DVec3, Vec4};
use slotmap::Key as _;

use crate::accel::SupportFunction;
use crate::device::layout::{self, InstanceFlags, InstanceRecord, MaterialFlags, TextureFlags, TextureInfo};
use crate::device::{MAX_MIRROR_ROUGHNESS, Needs};
use crate::graph::{AlphaMode, FilterMode, Light, LightKind, Material, NodeKey, Texture, TextureRef, WrapMode};
use crate::math::{Aabb, with_least_thickness};

/// The transform and world box of an instance, as its device record has them.
pub(super) struct InstanceTransform {
    /// Rows of `local_from_world` and `world_from_local`; world space is relative to the render origin.
    local_from_world: [[f32; 4]; 3],
    world_from_local: [[f32; 4]; 3],
    /// The box around the instance in that world space.
    pub(super) bounds: Aabb,
    /// See [`displacement`].
    pub(super) displacement: f64,
}

impl InstanceTransform {
    /// The placement of a geometry with this support function. `None` if the matrix scales two axes to zero, or it or
    /// its inverse does not fit f32: such an instance cannot be hit. One that scales a single axis to zero is given a
    /// least thickness, so that it is drawn flat.
    ///
    /// Rays are transformed by the f32-rounded `local_from_world`, so what is seen is the geometry under the inverse of
    /// that, and the box is computed from it. The box is then widened by the rounding of the ray transform: each local
    /// coordinate of a point x is off by less than 4 ulp of `|local_from_world| |x| + |translation|`, which is mapped
    /// back to world space. That holds what the scene has too, for exact queries, unless the matrix is so ill
    /// conditioned that the inverse of the rounded one is another: then the box is around both.
    pub(super) fn new(world_from_local: &DAffine3, origin: DVec3, support: &SupportFunction) -> Option<Self> {
        // 1. Relative to the render origin.
        let relative = relative_to(world_from_local, origin)?;
        // 2. Round the inverse to f32, as the device has it.
        let local_from_world = relative.inverse().as_affine3();
        let rounded_local_from_world = local_from_world.as_daffine3();
        // 3. The placement that rays then see.
        let world_from_rounded_local = rounded_local_from_world.inverse();
        let world_from_local = world_from_rounded_local.as_affine3();
        if !(local_from_world.is_finite() && world_from_local.is_finite() && world_from_rounded_local.is_finite()) {
            return None;
        }

        // 4. Its box, widened by the rounding of the ray transform.
        let displacement = displacement(&world_from_rounded_local.matrix3, &rounded_local_from_world.matrix3);
        let mut world = support.world_bounds(&world_from_rounded_local);
        if displacement > MAX_FIRST_ORDER_DISPLACEMENT {
            world = world.union(support.world_bounds(&relative));
        }
        let corner = world.min.abs().max(world.max.abs());
        let local_error = rounded_local_from_world.matrix3.abs() * corner + rounded_local_from_world.translation.abs();
        let rounding_margin = world_from_rounded_local.matrix3.abs() * local_error * (4.0 * f64::from(f32::EPSILON));
        let (min, max) = (world.min - rounding_margin, world.max + rounding_margin);
        let bounds = Aabb { min: min.as_vec3(), max: max.as_vec3() };
        let fits = bounds.min.is_finite() && bounds.max.is_finite();
        fits.then(|| Self {
            local_from_world: affine_rows(&local_from_world),
            world_from_local: affine_rows(&world_from_local),
            bounds,
            displacement,
        })
    }

    /// The flags of the rows that multiply without rounding.
    fn exact_rows(&self) -> InstanceFlags {
        let bits = |rows: &[[f32; 4]; 3]| (0..3).filter(|&i| is_exact(&rows[i])).fold(0, |bits, i| bits | 1 << i);
        let in_flags = |rows, flags: InstanceFlags| bits(rows) << flags.bits().trailing_zeros();
        InstanceFlags::from_bits_retain(
            in_flags(&self.local_from_world, InstanceFlags::EXACT_LOCAL_ROWS)
                | in_flags(&self.world_from_local, InstanceFlags::EXACT_WORLD_ROWS),
        )
    }

    /// The device record. `first_*`, `geometry` and `material` are indices into the arrays of those names.
    pub(super) fn instance_record(
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
            flags: (flags | self.exact_rows()).bits(),
            node_key: [key as u32, (key >> 32) as u32],
        }
    }
}

/// A displacement beyond which terms of second order matter: 2^-8.
const MAX_FIRST_ORDER_DISPLACEMENT: f64 = 1.0 / 256.0;

/// Bounds how far a point of an instance is drawn from where the scene has it, relative to its coordinates and those of
/// the instance's own origin, both relative to the render origin: each number of `local_from_world` is rounded by
/// 2^-24 of itself, which the inverse enlarges. That is 2^-22 or less for what is turned and then scaled along its own
/// axes, and grows with the ratio of the scales where it is turned before too (the condition number of R. Skeel,
/// *Scaling for Numerical Stability in Gaussian Elimination*, 1979).
fn displacement(world_from_local: &DMat3, local_from_world: &DMat3) -> f64 {
    let products = world_from_local.abs() * local_from_world.abs();
    // The greatest sum of a row.
    (products * DVec3::ONE).max_element() / f64::from(1 << 24)
}

/// The matrix relative to the render origin, with a [least thickness](with_least_thickness) along an axis that it
/// scales to zero; `None` if it scales two.
pub(super) fn relative_to(world_from_local: &DAffine3, origin: DVec3) -> Option<DAffine3> {
    let matrix3 = with_least_thickness(&world_from_local.matrix3)?;
    Some(DAffine3 { matrix3, translation: world_from_local.translation - origin })
}

/// Whether a row of an affine matrix multiplies without rounding: one number of the linear part is not zero, and that
/// is a power of two.
fn is_exact(row: &[f32; 4]) -> bool {
    let [x, y, z, _] = *row;
    let mut factors = [x, y, z].into_iter().filter(|&factor| factor != 0.0);
    let is_power_of_two = |factor: f32| factor.to_bits() & 0x007f_ffff == 0;
    factors.next().is_some_and(is_power_of_two) && factors.next().is_none()
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

/// The instance flags that follow from a material.
pub(super) fn instance_flags(material: &Material) -> InstanceFlags {
    let transmissive = material.transmission > 0.0;
    let mask = matches!(material.alpha_mode, AlphaMode::Mask { .. });
    let blend = material.alpha_mode == AlphaMode::Blend;
    let mut flags = InstanceFlags::empty();
    flags.set(InstanceFlags::CULL_BACK, !material.double_sided && !transmissive);
    flags.set(InstanceFlags::ALPHA_MASK, mask || has_clear_parts(material));
    flags.set(InstanceFlags::TRANSLUCENT, mask || blend || transmissive);
    flags
}

/// Whether a blended material may be fully transparent somewhere: rays pass there, as through the holes of a mask.
fn has_clear_parts(material: &Material) -> bool {
    material.alpha_mode == AlphaMode::Blend && (material.base_color.w <= 0.0 || material.base_color_texture.is_some())
}

/// The kernel features that a material needs.
pub(super) fn material_needs(material: &Material) -> Needs {
    let textured = [
        material.base_color_texture,
        material.metallic_roughness_texture,
        material.emissive_texture,
        material.transmission_texture,
        material.normal_texture,
    ];
    // A metallic-roughness texture multiplies by at most 1, so it may make a rough material smooth enough for
    // reflection rays.
    let sharp = material.roughness < MAX_MIRROR_ROUGHNESS || material.metallic_roughness_texture.is_some();
    let transmissive = material.transmission > 0.0;
    let mut needs = Needs::empty();
    needs.set(Needs::TEXTURES, textured.iter().any(Option::is_some));
    needs.set(Needs::NORMAL_TEXTURES, material.normal_texture.is_some());
    needs.set(Needs::ALPHA_MASK, instance_flags(material).contains(InstanceFlags::ALPHA_MASK));
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

/// The device record of a light; `None` if it emits nothing, or its position or colour does not fit f32. The position
/// is relative to the render origin; the direction is the -Z axis of the light's node.
pub(super) fn light_record(light: &Light, world_from_local: &DAffine3, origin: DVec3) -> Option<layout::LightRecord> {
    let color = light.color * light.intensity;
    // A node scaled to zero has no direction: point lights still work, others are left out.
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
            // Equal cone angles would divide by zero; a difference of one ulp gives a hard edge.
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

/// A colour as four 16-bit unorms, red in the lowest bits.
pub(super) fn pack_color(color: Vec4) -> [u32; 2] {
    let [r, g, b, a] = color.to_array().map(|c| (c.clamp(0.0, 1.0) * 65535.0 + 0.5) as u32);
    [r | g << 16, b | a << 16]
}

/// The rows of an affine matrix, the translation in the last column.
fn affine_rows(affine: &glam::Affine3) -> [[f32; 4]; 3] {
    let [x, y, z] = [affine.matrix3.x_axis, affine.matrix3.y_axis, affine.matrix3.z_axis];
    let t = affine.translation;
    [[x.x, y.x, z.x, t.x], [x.y, y.y, z.y, t.y], [x.z, y.z, z.z, t.z]]
}
