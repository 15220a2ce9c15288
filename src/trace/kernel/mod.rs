//! The ray tracing kernel in Rust, file by file the twin of `shaders/shared`: types, ray queries and shading.
//!
//! Functions have the name of their WGSL twin. They differ where WGSL lacks generics, methods or many rays at once: its
//! leaf loops are one generic loop here ([`run_query`]), its traversal state and its ray tree are types with methods,
//! and a light's shadow ray and a pixel's rays are returned to the caller, who may trace those of many pixels together.
//! `emulated` runs all of it; `cpu` runs its own SIMD traversal and triangle test, and of the kernel the hit rules, the
//! shading and, for layered instances or where there is no SIMD, the traversal.

mod brdf;
mod camera;
mod intersect;
mod light;
mod material;
pub(crate) mod math;
mod offset;
mod query;
mod rope;
mod sky;
mod surface;
mod texture;
mod traversal_state;
mod traverse;
mod whitted;
mod wide;

pub(crate) use camera::camera_ray;
pub(crate) use intersect::{
    BOX_ENTRY_SCALE, CORNER_TOLERANCE, EDGE_TOLERANCE, MIN_COMPONENT, MIN_RELATIVE_COMPONENT, SHEARED_EXTENT,
    SQRT_MAX_QUOTIENT, START_ZONE, SlabRay, TriangleHit, edge_scale, intersects_box, max_component, padded_box,
    scaled_normal, shear_ray, slab_ray,
};
pub(crate) use light::LightSample;
#[cfg(test)]
pub(crate) use query::is_layered;
pub(crate) use query::{
    AnyQuery, ClosestQuery, Continuation, GrazingPlane, HitOrder, MAX_GRAZING, Query, T_BEFORE_SCALE, TOUCH_STEP,
    TransmittanceQuery, candidate_hit, depth_steps, hit_depth, intersect_leaf, is_culled, is_cut_out, is_opaque_at,
};
pub(crate) use traversal_state::{TraversalCounter, TraversalRay};
pub(crate) use traverse::{RayQueries, any_hit, closest_hit, next_hit, run_query, transmittance};
#[cfg(feature = "gpu")]
pub(crate) use whitted::max_rays_per_pixel;
pub(crate) use whitted::{Pixel, RayTree, SurfaceHit, active_lights, primary_hit, render_pixel};
pub(crate) use wide::grid_extent;

use crate::device::DeviceArrays;
use crate::device::layout::{
    GeometryRecord, InstanceRecord, LightRecord, MaterialRecord, Node, TextureInfo, Triangle, WideNode,
};
use crate::trace::Traversal;

/// Borrowed device arrays, one field per binding of the WGSL kernel, and the traversal to use.
#[derive(Clone, Copy)]
pub(crate) struct KernelScene<'a> {
    pub traversal: Traversal,
    pub tlas_nodes: &'a [Node],
    pub instances: &'a [InstanceRecord],
    pub blas_nodes: &'a [Node],
    pub wide_nodes: &'a [WideNode],
    pub triangles: &'a [Triangle],
    pub geometries: &'a [GeometryRecord],
    pub indices: &'a [u32],
    pub normals: &'a [f32],
    pub tex_coords: &'a [[f32; 2]],
    pub colors: &'a [[u32; 2]],
    pub materials: &'a [MaterialRecord],
    pub texture_infos: &'a [TextureInfo],
    pub texels: &'a [u32],
    pub lights: &'a [LightRecord],
}

impl<'a> KernelScene<'a> {
    /// A scene traversed by [`Traversal::Rope`].
    pub(crate) fn new(arrays: &'a DeviceArrays) -> Self {
        Self {
            traversal: Traversal::Rope,
            tlas_nodes: &arrays.tlas_nodes,
            instances: &arrays.instances,
            blas_nodes: &arrays.blas_nodes,
            wide_nodes: &arrays.wide_nodes,
            triangles: &arrays.triangles,
            geometries: &arrays.geometries,
            indices: &arrays.indices,
            normals: &arrays.normals,
            tex_coords: &arrays.tex_coords,
            colors: &arrays.colors,
            materials: &arrays.materials,
            texture_infos: &arrays.texture_infos,
            texels: &arrays.texels,
            lights: &arrays.lights,
        }
    }

    /// A scene traversed by `traversal`, or by [`Traversal::Rope`] if the arrays have no wide nodes.
    pub(crate) fn with_traversal(arrays: &'a DeviceArrays, traversal: Traversal) -> Self {
        Self { traversal: traversal.supported_by(arrays), ..Self::new(arrays) }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use crate::accel::SIDE_MARGIN;
    use crate::device::layout::{
        InstanceFlags, LIGHT_DIRECTIONAL, LIGHT_POINT, LIGHT_SPOT, MaterialFlags, NONE, Node, TextureFlags,
    };
    use crate::device::{MAX_MIRROR_ROUGHNESS, Needs};
    use crate::trace::kernel::query::VisitOrder;
    use crate::trace::shader::EntryPoint;

    /// Constants by name: `{:?}` prints the shortest text that parses back to the same value, with a point for an
    /// `f32`.
    type Constants = BTreeMap<String, String>;

    /// Constants of the kernel, each under its own name.
    macro_rules! named {
        ($($module:ident { $($name:ident),* $(,)? })*) => {
            [$($((stringify!($name).to_owned(), format!("{:?}", super::$module::$name))),*),*]
        };
    }

    fn rust_constants() -> Constants {
        fn flags<F: bitflags::Flags<Bits = u32>>(prefix: &str) -> impl Iterator<Item = (String, String)> {
            F::FLAGS.iter().map(move |f| (format!("{prefix}_{}", f.name()), f.value().bits().to_string()))
        }
        let kernel = named! {
            intersect { BOX_ENTRY_SCALE, MIN_RELATIVE_COMPONENT, MIN_COMPONENT, SQRT_MAX_QUOTIENT }
            intersect { SHEARED_EXTENT, CORNER_TOLERANCE, EDGE_TOLERANCE, START_ZONE }
            texture { SRGB_LINEAR_END, SRGB_LINEAR_SLOPE, SRGB_SCALE, SRGB_OFFSET }
            texture { SRGB_FIT_6, SRGB_FIT_5, SRGB_FIT_4, SRGB_FIT_3, SRGB_FIT_2, SRGB_FIT_1, SRGB_FIT_0 }
            surface { MIN_COSINE }
            offset { HALF_ULP, LEAST_OFFSET, OFFSET_MARGIN, LIKELY_WEIGHT }
            sky { COSINE_INTEGRAL_6, COSINE_INTEGRAL_4, COSINE_INTEGRAL_2, COSINE_INTEGRAL_0 }
            brdf { SHARP_REFLECTION_ROUGHNESS, MIN_HIGHLIGHT_ROUGHNESS }
            wide { TLAS_STACK_SIZE, TLAS_LEAF_BIT, BLAS_STACK_SIZE, PENDING_CHILDREN_MASK, NO_ENTRY }
            whitted { ON_SURFACE, MAX_PENDING }
            query { TOUCH_STEP, MAX_GRAZING, T_BEFORE_SCALE, T_AFTER_SCALE, EDGE_WEIGHT }
        };
        let others = [
            ("NONE", NONE.to_string()),
            ("SIDE_MARGIN", format!("{SIDE_MARGIN:?}")),
            ("UNUSED_COORDINATE", format!("{:?}", Node::UNUSED_COORDINATE)),
            ("INSTANCE_LAYERED", super::query::LAYERED.bits().to_string()),
            ("NEAR_FIRST", (VisitOrder::NearFirst as u32).to_string()),
            ("ANY_ORDER", (VisitOrder::Any as u32).to_string()),
            ("LIGHT_POINT", LIGHT_POINT.to_string()),
            ("LIGHT_SPOT", LIGHT_SPOT.to_string()),
            ("LIGHT_DIRECTIONAL", LIGHT_DIRECTIONAL.to_string()),
            ("PI", format!("{:?}", std::f32::consts::PI)),
            ("F32_MAX", format!("{:?}", f32::MAX)),
            ("F32_MIN_NORMAL", format!("{:?}", f32::MIN_POSITIVE)),
            ("MAX_MIRROR_ROUGHNESS", format!("{MAX_MIRROR_ROUGHNESS:?}")),
        ];
        let others = others.map(|(name, value)| (name.to_owned(), value));
        let flags =
            flags::<InstanceFlags>("INSTANCE")
                .chain(flags::<MaterialFlags>("MATERIAL"))
                .chain(flags::<TextureFlags>("TEXTURE"));
        kernel.into_iter().chain(others).chain(flags).collect()
    }

    /// Every constant of a module but the generated `NEEDS_*`.
    fn wgsl_constants(source: &str) -> Constants {
        let module = naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(source)));
        // naga forgets constants without a type.
        assert_eq!(module.constants.len(), source.lines().filter(|line| line.starts_with("const ")).count());
        let constants = module.constants.iter().map(|(_, constant)| {
            let value = match module.global_expressions[constant.init] {
                naga::Expression::Literal(naga::Literal::U32(value)) => format!("{value:?}"),
                naga::Expression::Literal(naga::Literal::F32(value)) => format!("{value:?}"),
                naga::Expression::Literal(naga::Literal::Bool(value)) => format!("{value:?}"),
                ref other => panic!("{:?} is {other:?}", constant.name),
            };
            (constant.name.clone().expect("module-scope constants have names"), value)
        });
        constants.filter(|(name, _)| !name.starts_with("NEEDS_")).collect()
    }

    #[test]
    fn wgsl_has_the_same_constants() {
        let rust = rust_constants();
        // With every need: less shortens MAX_PENDING.
        let wgsl = wgsl_constants(&EntryPoint::RenderAovs.source(Needs::all()));
        let names: Vec<&String> = rust.keys().chain(wgsl.keys().filter(|name| !rust.contains_key(*name))).collect();
        assert!(names.len() > 40, "{} constants", names.len());
        for name in names {
            assert_eq!(rust.get(name), wgsl.get(name), "{name}, in Rust and in WGSL");
        }
    }
}
