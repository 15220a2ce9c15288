//! Every kernel is valid WGSL, and its structs have the layout of the Rust types.

#![allow(clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::mem::{offset_of, size_of};

use naga::proc::Layouter;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use ropewalk::device::Needs;
use ropewalk::device::layout::{
    FrameParams, GeometryRecord, HitRecord, InstanceRecord, LightRecord, MaterialRecord, Node, RayBatch, RayRecord,
    TextureInfo, Triangle, WideNode,
};
use ropewalk::trace::Traversal;
use ropewalk::trace::shader::{ArraySplit, ArraySplits, EntryPoint, Include, KernelVariant};

const TYPES: &str = include_str!("../../shaders/shared/types.wgsl");

fn parse(entry: EntryPoint, needs: impl Into<KernelVariant>) -> naga::Module {
    let needs = needs.into();
    let source = entry.source(needs);
    let module = naga::front::wgsl::parse_str(&source)
        .unwrap_or_else(|e| panic!("{entry:?} with {needs:?}: {}", e.emit_to_string(&source)));
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{entry:?} with {needs:?}: {}", e.emit_to_string(&source)));
    module
}

#[test]
fn every_kernel_is_valid_whatever_is_needed() {
    let all = Needs::all();
    let one_more_or_less = all.iter().flat_map(|flag| [flag, all - flag]);
    for needs in [Needs::empty(), all].into_iter().chain(one_more_or_less) {
        for entry in EntryPoint::ALL {
            let splits =
                ArraySplits::default().with_nodes(ArraySplit::new(20, 10)).with_triangles(ArraySplit::new(40, 10));
            parse(entry, KernelVariant::from(needs).with_traversal(Traversal::Rope).with_splits(splits));
            parse(entry, KernelVariant::from(needs).with_traversal(Traversal::Rope));
            let module = parse(entry, needs);
            assert!(module.entry_points.iter().any(|e| e.name == entry.name()), "{entry:?} is in its module");
        }
    }
}

/// Includes of all kinds: each need alone and all but each, with and without surfaces, with whole and with split
/// arrays.
fn includes() -> impl Iterator<Item = Include> {
    let all = Needs::all();
    let needs = [Needs::empty(), all].into_iter().chain(all.iter().flat_map(move |flag| [flag, all - flag]));
    let split = ArraySplits::default().with_nodes(ArraySplit::new(20, 10)).with_triangles(ArraySplit::new(40, 10));
    let bound = [
        (Traversal::Rope, split),
        (Traversal::Rope, ArraySplits::default()),
        (Traversal::Wide, split),
        (Traversal::Wide, ArraySplits::default()),
    ];
    let variants = needs.flat_map(move |needs| {
        bound.map(|(layout, splits)| KernelVariant::from(needs).with_traversal(layout).with_splits(splits))
    });
    let includes = variants.map(|variant| Include::new(variant).in_group(3));
    includes.flat_map(|include| [include, include.with_surfaces()])
}

#[test]
fn includes_are_valid_and_bind_what_they_use() {
    let mut fewest = usize::MAX;
    for include in includes() {
        let mut source = include.source();
        source.push_str("@group(0) @binding(0) var<storage, read_write> own: vec4<f32>;\n@compute @workgroup_size(1) fn own_kernel() {\n");
        source.push_str(
            "let ray = RayRecord(vec3<f32>(own.x), 0.0, vec3<f32>(1.0), 1.0); let hit = closest_hit(ray, 1u);\n",
        );
        source.push_str("own.x = hit.t; own.y = f32(any_hit(ray, 1u)); own.z = transmittance(ray, 1u).x;\n");
        if include.surfaces {
            source.push_str("let surface = surface_at(hit, ray.direction); own.w = surface.normal.x + offset_ray_origin(surface, ray.direction).x;\n");
        }
        source.push('}');
        let module = naga::front::wgsl::parse_str(&source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&source)));
        let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
            .validate(&module)
            .unwrap_or_else(|e| panic!("{include:?}: {}", e.emit_to_string(&source)));
        let kernel = info.get_entry_point(0);
        let used: Vec<u32> = module
            .global_variables
            .iter()
            .filter(|(handle, _)| !kernel[*handle].is_empty())
            .filter_map(|(_, variable)| variable.binding)
            .filter(|binding| binding.group == 3)
            .map(|binding| binding.binding)
            .collect();
        let bound = include.bindings();
        assert!(used.iter().all(|binding| bound.contains(binding)), "{include:?} uses {used:?} of {bound:?}");
        assert!(bound.len() < used.len() + 2, "{include:?} binds {bound:?} for {used:?}");
        fewest = fewest.min(bound.len());
    }
    assert_eq!(fewest, 4);
}

/// Name, offset and size of each member of a struct, and its whole size.
type Layout = (Vec<(String, u32, u32)>, u32);

/// The layout of a Rust struct, without the members that pad it: they are private. No other member may be left out.
macro_rules! layout_of {
    ($type:ident { $($member:ident),* $(,)? }) => {{
        let value: $type = bytemuck::Zeroable::zeroed();
        assert_eq!(members_but_pads(&value), [$(stringify!($member)),*], "members of {}", stringify!($type));
        let members = vec![$((
            stringify!($member).to_owned(),
            offset_of!($type, $member) as u32,
            size_of_val(&value.$member) as u32,
        )),*];
        (stringify!($type).to_owned(), (members, size_of::<$type>() as u32))
    }};
}

/// The names of a struct's members as its derived `Debug` lists them, but for those that pad it.
fn members_but_pads(value: &impl std::fmt::Debug) -> Vec<String> {
    let text = format!("{value:#?}");
    let members = text.lines().filter_map(|line| line.strip_prefix("    ")?.split_once(": ")).map(|(name, _)| name);
    members.filter(|name| !name.starts_with([' ', '_'])).map(str::to_owned).collect()
}

fn rust_layouts() -> BTreeMap<String, Layout> {
    BTreeMap::from([
        layout_of!(Node { min, escape_index, max, primitives }),
        layout_of!(Triangle { v0, primitive, v1, v2 }),
        layout_of!(InstanceRecord {
            local_from_world,
            world_from_local,
            first_node,
            first_triangle,
            geometry,
            material,
            mask,
            flags,
            node_key
        }),
        layout_of!(GeometryRecord {
            first_index,
            first_normal,
            first_tex_coord_0,
            first_tex_coord_1,
            first_color,
            first_wide_node
        }),
        layout_of!(WideNode { origin, exponents, planes, children }),
        layout_of!(MaterialRecord {
            base_color,
            emissive,
            metallic,
            roughness,
            transmission,
            ior,
            alpha_cutoff,
            flags,
            base_color_texture,
            metallic_roughness_texture,
            emissive_texture,
            transmission_texture,
            normal_texture,
            normal_scale
        }),
        layout_of!(TextureInfo { row_u, row_v, first_texel, width, height, flags }),
        layout_of!(LightRecord { position, kind, direction, range, color, cone_scale, cone_offset }),
        layout_of!(FrameParams {
            eye,
            width,
            right,
            height,
            up,
            max_depth,
            forward,
            orthographic,
            sky_zenith,
            ray_mask,
            sky_horizon,
            light_count,
            sky_ground,
            first_row,
            sky_up,
            max_rays,
            near,
            min_throughput
        }),
        layout_of!(RayRecord { origin, t_min, direction, t_max }),
        layout_of!(RayBatch { count, ray_mask, first }),
        layout_of!(HitRecord { t, u, v, instance, primitive, triangle, back_face, depth }),
    ])
}

fn wgsl_layouts(source: &str) -> BTreeMap<String, Layout> {
    let module = naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(source)));
    let mut layouter = Layouter::default();
    layouter.update(module.to_ctx()).unwrap_or_else(|e| panic!("{e}"));
    let layout = |ty: &naga::Type| {
        let naga::TypeInner::Struct { members, span } = &ty.inner else { return None };
        let member = |m: &naga::StructMember| {
            (m.name.clone().unwrap_or_default(), m.offset, module.types[m.ty].inner.size(module.to_ctx()))
        };
        let is_not_padding = |m: &&naga::StructMember| !m.name.as_ref().is_some_and(|name| name.starts_with("_pad"));
        Some((ty.name.clone()?, (members.iter().filter(is_not_padding).map(member).collect(), *span)))
    };
    module.types.iter().filter_map(|(_, ty)| layout(ty)).collect()
}

#[test]
fn structs_have_the_same_members_at_the_same_offsets() {
    let (rust, wgsl) = (rust_layouts(), wgsl_layouts(TYPES));
    assert_eq!(wgsl.len(), TYPES.matches("struct ").count());
    assert_eq!(rust, wgsl);
}

#[test]
fn swapped_members_are_noticed() {
    let swapped = TYPES.replace("mask: u32,\n    flags: u32,", "flags: u32,\n    mask: u32,");
    assert_ne!(swapped, TYPES);
    let (rust, wgsl) = (rust_layouts(), wgsl_layouts(&swapped));
    assert_ne!(rust["InstanceRecord"], wgsl["InstanceRecord"]);
    assert_eq!(rust["InstanceRecord"].1, wgsl["InstanceRecord"].1);
}
