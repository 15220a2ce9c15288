// Every type that crosses to the device, and the arrays. Twin of src/device/layout.rs: see there for what each member means.

const NONE: u32 = 0xffffffffu;
const F32_MAX: f32 = 0x1.fffffep+127f;
const F32_MIN_NORMAL: f32 = 0x1p-126f;

struct Node {
    min: vec3<f32>,
    escape_index: u32,
    max: vec3<f32>,
    primitives: u32,
}

struct WideNode {
    origin: vec3<f32>,
    exponents: u32,
    planes: array<vec4<u32>, 3>,
    children: array<u32, 8>,
}

struct Triangle {
    v0: vec3<f32>,
    primitive: u32,
    v1: vec3<f32>,
    _pad0: u32,
    v2: vec3<f32>,
    _pad1: u32,
}

struct InstanceRecord {
    local_from_world: array<vec4<f32>, 3>,
    world_from_local: array<vec4<f32>, 3>,
    first_node: u32,
    first_triangle: u32,
    geometry: u32,
    material: u32,
    mask: u32,
    flags: u32,
    node_key: vec2<u32>,
}

const INSTANCE_CULL_BACK: u32 = 1u;
const INSTANCE_ALPHA_MASK: u32 = 2u;
const INSTANCE_TRANSLUCENT: u32 = 4u;
const INSTANCE_THIN: u32 = 8u;
const INSTANCE_HAS_DUPLICATES: u32 = 16u;

struct GeometryRecord {
    first_index: u32,
    first_normal: u32,
    first_tex_coord_0: u32,
    first_tex_coord_1: u32,
    first_color: u32,
    first_wide_node: u32,
    _pad: array<u32, 2>,
}

struct MaterialRecord {
    base_color: vec4<f32>,
    emissive: vec3<f32>,
    metallic: f32,
    roughness: f32,
    transmission: f32,
    ior: f32,
    alpha_cutoff: f32,
    flags: u32,
    base_color_texture: u32,
    metallic_roughness_texture: u32,
    emissive_texture: u32,
    transmission_texture: u32,
    normal_texture: u32,
    normal_scale: f32,
    _pad: u32,
}

const MATERIAL_MASK: u32 = 1u;
const MATERIAL_BLEND: u32 = 2u;
const MATERIAL_UNLIT: u32 = 4u;

struct TextureInfo {
    row_u: vec4<f32>,
    row_v: vec4<f32>,
    first_texel: u32,
    width: u32,
    height: u32,
    flags: u32,
}

const TEXTURE_MIRROR_U: u32 = 1u;
const TEXTURE_CLAMP_U: u32 = 2u;
const TEXTURE_MIRROR_V: u32 = 4u;
const TEXTURE_CLAMP_V: u32 = 8u;
const TEXTURE_NEAREST: u32 = 16u;
const TEXTURE_SRGB: u32 = 32u;
const TEXTURE_TEX_COORD_1: u32 = 64u;

struct LightRecord {
    position: vec3<f32>,
    kind: u32,
    direction: vec3<f32>,
    range: f32,
    color: vec3<f32>,
    cone_scale: f32,
    cone_offset: f32,
    _pad0: u32,
    _pad1: u32,
    _pad2: u32,
}

const LIGHT_POINT: u32 = 0u;
const LIGHT_SPOT: u32 = 1u;
const LIGHT_DIRECTIONAL: u32 = 2u;

struct FrameParams {
    eye: vec3<f32>,
    width: u32,
    right: vec3<f32>,
    height: u32,
    up: vec3<f32>,
    max_depth: u32,
    forward: vec3<f32>,
    orthographic: u32,
    sky_zenith: vec3<f32>,
    ray_mask: u32,
    sky_horizon: vec3<f32>,
    light_count: u32,
    sky_ground: vec3<f32>,
    first_row: u32,
    sky_up: vec3<f32>,
    _pad: u32,
}

struct RayRecord {
    origin: vec3<f32>,
    t_min: f32,
    direction: vec3<f32>,
    t_max: f32,
}

struct HitRecord {
    t: f32,
    u: f32,
    v: f32,
    instance: u32,
    primitive: u32,
    triangle: u32,
    back_face: u32,
    _pad: u32,
}

struct RayBatch {
    count: u32,
    ray_mask: u32,
    first: u32,
    _pad: u32,
}

@group(0) @binding(0) var<storage, read> tlas_nodes: array<Node>;
@group(0) @binding(1) var<storage, read> instances: array<InstanceRecord>;
// Binding 2 is blas_nodes or wide_nodes, binding 3 triangles: declared with the functions that read them.
@group(0) @binding(4) var<storage, read> geometries: array<GeometryRecord>;
@group(0) @binding(5) var<storage, read> indices: array<u32>;
@group(0) @binding(6) var<storage, read> normals: array<f32>;
@group(0) @binding(7) var<storage, read> tex_coords: array<vec2<f32>>;
@group(0) @binding(8) var<storage, read> colors: array<vec2<u32>>;
@group(0) @binding(9) var<storage, read> materials: array<MaterialRecord>;
@group(0) @binding(10) var<storage, read> texture_infos: array<TextureInfo>;
@group(0) @binding(11) var<storage, read> texels: array<u32>;
@group(0) @binding(12) var<storage, read> lights: array<LightRecord>;
