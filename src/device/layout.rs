//! Every type that crosses to the device, byte for byte. `shaders/shared/types.wgsl` declares the same structs; a test
//! compares member names, offsets and sizes of both.

use bytemuck::{Pod, Zeroable};

/// "None" in any index of the device arrays, and "the end of the array" in [`Node::escape_index`].
pub const NONE: u32 = u32::MAX;

/// A node of a bounding volume hierarchy in depth-first order. The first child of an inner node follows it; the
/// escape index is where traversal goes on when the box is missed or the leaf is done (paper, section 3). 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Node {
    /// Least corner, padded outward.
    pub min: [f32; 3],
    /// Index, relative to the hierarchy's first node, of the next node past this subtree, or [`NONE`] at the end.
    pub escape_index: u32,
    /// Greatest corner, padded outward.
    pub max: [f32; 3],
    /// Empty for an inner node.
    pub primitives: PrimitiveRange,
}

impl Node {
    /// No box of a node in use has a corner this far out: [`f32::MAX`] less one ulp.
    pub(crate) const UNUSED_COORDINATE: f32 = f32::from_bits(f32::MAX.to_bits() - 1);

    /// A leaf of the top level that holds nothing: an inner node without children, so that traversal goes on with the next
    /// node whether it meets the box or not. The box lies where no ray comes by. It must not be the last of an array. An inner
    /// node with nothing but unused leaves below it has the same box.
    pub fn unused_leaf(escape_index: u32) -> Self {
        Self { min: [Self::UNUSED_COORDINATE; 3], escape_index, max: [f32::MAX; 3], primitives: PrimitiveRange::INNER }
    }

    /// Whether there is nothing in it or below it, see [`unused_slot`](Self::unused_leaf). A walk that visits the children of inner nodes
    /// must leave these out.
    pub fn is_empty(&self) -> bool {
        self.min[0] >= Self::UNUSED_COORDINATE
    }
}

/// What a leaf holds: `first` in the lower 28 bits, `count` in the upper 4; an inner node has count 0.
///
/// In a bottom-level structure `first` counts triangles from the instance's `first_triangle`; in the top level it is an
/// instance index, and `count` is 1.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct PrimitiveRange(u32);

impl PrimitiveRange {
    /// The range of an inner node.
    pub const INNER: Self = Self(0);
    /// The most primitives in one leaf.
    pub const MAX_COUNT: u32 = 15;
    /// One more than the greatest first primitive.
    pub const MAX_FIRST: u32 = 1 << 28;

    /// A leaf's range.
    ///
    /// # Panics
    /// In debug builds, if either number does not fit or `count` is 0: builders split until it does.
    pub fn leaf(first: u32, count: u32) -> Self {
        debug_assert!(first < Self::MAX_FIRST && (1..=Self::MAX_COUNT).contains(&count), "{first} + {count}");
        Self(first | count << 28)
    }

    /// The first primitive.
    pub fn first_primitive(self) -> u32 {
        self.0 & (Self::MAX_FIRST - 1)
    }

    /// In a [`WideNode`]: the child at an index.
    pub fn inner(index: u32) -> Self {
        debug_assert!(index < Self::MAX_FIRST, "{index}");
        Self(index)
    }

    /// How many primitives; 0 for an inner node.
    pub fn primitive_count(self) -> u32 {
        self.0 >> 28
    }
}

/// Eight children of a bottom-level hierarchy, their boxes in a grid of 256 steps a side: what coherent packets and single rays walk
/// on the CPU. The boxes are larger than those of [`Node`] by up to a step and never smaller (`accel::wide`). 96 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct WideNode {
    /// Least corner of the grid, local space.
    pub origin: [f32; 3],
    /// The length of a step along x, y and z: the exponents of powers of two, biased by 127 as in an `f32`. Then a bit for each child in use.
    pub exponents: [u8; 4],
    /// For each axis the least planes of the eight children, then the greatest, in steps from `origin`.
    pub planes: [[[u8; 8]; 2]; 3],
    /// A leaf's triangles, or, with count 0, the index of a child relative to the structure's first wide node.
    pub children: [PrimitiveRange; 8],
}

/// A triangle of a bottom-level structure, in leaf order. 48 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Triangle {
    /// First vertex, local space.
    pub v0: [f32; 3],
    /// The triangle's index in its geometry.
    pub primitive: u32,
    /// Second vertex.
    pub v1: [f32; 3],
    /// Zero.
    pub _pad0: u32,
    /// Third vertex.
    pub v2: [f32; 3],
    /// Zero.
    pub _pad1: u32,
}

/// A bottom-level structure placed in the world: the paper's Node Primitive. 128 bytes. "World" on the device is
/// relative to the scene's render origin.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct InstanceRecord {
    /// Three rows of an affine matrix: `local.x = dot(row0.xyz, world) + row0.w`.
    pub local_from_world: [[f32; 4]; 3],
    /// Three rows of its inverse.
    pub world_from_local: [[f32; 4]; 3],
    /// Where the bottom-level structure starts in the `blas_nodes` array.
    pub first_node: u32,
    /// Where its triangles start in the `triangles` array.
    pub first_triangle: u32,
    /// Index into `geometries`.
    pub geometry: u32,
    /// Index into `materials`.
    pub material: u32,
    /// Rays whose mask shares no bit with this pass by.
    pub mask: u32,
    /// [`InstanceFlags`].
    pub flags: u32,
    /// The node's key, as slotmap's `KeyData::as_ffi` gives it: lower 32 bits (slot), upper 32 bits (version).
    pub node_key: [u32; 2],
}

bitflags::bitflags! {
    /// What traversal must know of an instance and its material.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct InstanceFlags: u32 {
        /// `closest_hit` passes through back faces (single-sided and not transmissive).
        const CULL_BACK = 1;
        /// `closest_hit` must ask the material whether a candidate is a hole (alpha mask).
        const ALPHA_MASK = 2;
        /// `any_hit` must ask the material how much light passes (alpha mask, blend or transmission).
        const TRANSLUCENT = 4;
        /// A transmissive surface that encloses nothing (its geometry is not closed): light passes without bending.
        const THIN = 8;
        /// Some triangle is in several leaves of the geometry's structure, and may be met more than once: what is counted must
        /// count it once.
        const HAS_DUPLICATES = 16;
    }
}

/// Where a geometry's vertex streams and wide nodes start; [`NONE`] for what it does not have. 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct GeometryRecord {
    /// Into `indices`, in `u32`s: the three vertices of triangle `primitive` are at `first_index + 3 * primitive`.
    /// [`NONE`] for a geometry without any stream, which has nothing to look up.
    pub first_index: u32,
    /// Into `normals`, in `f32`s: three a vertex.
    pub first_normal: u32,
    /// Into `tex_coords`, in pairs: set 0.
    pub first_tex_coord_0: u32,
    /// Into `tex_coords`, in pairs: set 1.
    pub first_tex_coord_1: u32,
    /// Into `colors`, in pairs of `u32` (four 16-bit unorms, red lowest).
    pub first_color: u32,
    /// Where the bottom-level structure starts in the `wide_nodes` array.
    pub first_wide_node: u32,
    /// Zero.
    pub _pad: [u32; 2],
}

/// A [`graph::Material`](crate::graph::Material) as the kernel reads it. 80 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct MaterialRecord {
    /// Linear RGBA.
    pub base_color: [f32; 4],
    /// Linear radiance.
    pub emissive: [f32; 3],
    /// 0 to 1.
    pub metallic: f32,
    /// Perceptual roughness, 0 to 1.
    pub roughness: f32,
    /// 0 to 1.
    pub transmission: f32,
    /// Index of refraction; 0 means infinite.
    pub ior: f32,
    /// Smallest solid alpha where [`MaterialFlags::MASK`] is set.
    pub alpha_cutoff: f32,
    /// [`MaterialFlags`].
    pub flags: u32,
    /// Index into `texture_infos`, or [`NONE`].
    pub base_color_texture: u32,
    /// Index into `texture_infos`, or [`NONE`].
    pub metallic_roughness_texture: u32,
    /// Index into `texture_infos`, or [`NONE`].
    pub emissive_texture: u32,
    /// Index into `texture_infos`, or [`NONE`].
    pub transmission_texture: u32,
    /// Index into `texture_infos`, or [`NONE`].
    pub normal_texture: u32,
    /// Scales x and y of the normal texture.
    pub normal_scale: f32,
    /// Zero.
    pub _pad: u32,
}

bitflags::bitflags! {
    /// The switches of a [`MaterialRecord`].
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct MaterialFlags: u32 {
        /// Alpha below the cutoff is a hole.
        const MASK = 1;
        /// Alpha is coverage.
        const BLEND = 2;
        /// Shown without light.
        const UNLIT = 4;
    }
}

/// A texture as one material slot uses it: the paper's `TexInfo`. 48 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TextureInfo {
    /// First row of the affine map from texture coordinates to image coordinates: `u' = dot(row_u.xyz, (u, v, 1))`.
    pub row_u: [f32; 4],
    /// Second row.
    pub row_v: [f32; 4],
    /// Into `texels`.
    pub first_texel: u32,
    /// Texels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// [`TextureFlags`].
    pub flags: u32,
}

bitflags::bitflags! {
    /// How a texture is read. Without a wrap flag an axis repeats.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct TextureFlags: u32 {
        /// Mirrored beyond the left and right edges.
        const MIRROR_U = 1;
        /// The edge beyond the left and right edges.
        const CLAMP_U = 2;
        /// Mirrored beyond the upper and lower edges.
        const MIRROR_V = 4;
        /// The edge beyond the upper and lower edges.
        const CLAMP_V = 8;
        /// The nearest texel, not the bilinear mix.
        const NEAREST = 16;
        /// Texels are sRGB encoded.
        const SRGB = 32;
        /// Uses texture coordinate set 1, not 0.
        const TEX_COORD_1 = 64;
    }
}

/// A light in (origin-relative) world space. 64 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LightRecord {
    /// Position (point, spot).
    pub position: [f32; 3],
    /// [`LIGHT_POINT`], [`LIGHT_SPOT`] or [`LIGHT_DIRECTIONAL`].
    pub kind: u32,
    /// Unit vector along which it shines (spot, directional).
    pub direction: [f32; 3],
    /// Beyond this distance it does not shine; `f32::MAX` for unlimited.
    pub range: f32,
    /// Linear colour times intensity.
    pub color: [f32; 3],
    /// Spot: `saturate(cos(angle) * cone_scale + cone_offset)` squared is the falloff (`KHR_lights_punctual`).
    pub cone_scale: f32,
    /// See `cone_scale`.
    pub cone_offset: f32,
    /// Zero.
    pub _pad0: u32,
    /// Zero.
    pub _pad1: u32,
    /// Zero.
    pub _pad2: u32,
}

/// [`LightRecord::kind`]: shines in all directions.
pub const LIGHT_POINT: u32 = 0;
/// [`LightRecord::kind`]: shines in a cone.
pub const LIGHT_SPOT: u32 = 1;
/// [`LightRecord::kind`]: infinitely far away.
pub const LIGHT_DIRECTIONAL: u32 = 2;

/// What changes from frame to frame: the uniform buffer. 128 bytes. Positions are relative to the render origin.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct FrameParams {
    /// Camera position (perspective), or the image's centre (orthographic).
    pub eye: [f32; 3],
    /// Pixels a row.
    pub width: u32,
    /// From the image's centre to its right edge, in a plane at distance 1 (perspective) or at the eye (orthographic).
    pub right: [f32; 3],
    /// Rows.
    pub height: u32,
    /// From the image's centre to its upper edge.
    pub up: [f32; 3],
    /// Reflections and refractions a path may have.
    pub max_depth: u32,
    /// From the eye to the image's centre in the plane at distance 1 (perspective), or the unit vector of view (orthographic).
    pub forward: [f32; 3],
    /// 1 for an orthographic camera, else 0.
    pub orthographic: u32,
    /// Radiance of the sky straight up.
    pub sky_zenith: [f32; 3],
    /// Instances whose mask shares no bit with this are not seen.
    pub ray_mask: u32,
    /// Radiance at the horizon.
    pub sky_horizon: [f32; 3],
    /// How many elements of `lights` shine.
    pub light_count: u32,
    /// Radiance straight down.
    pub sky_ground: [f32; 3],
    /// First row of this dispatch: frames are traced in bands.
    pub first_row: u32,
    /// The up direction of the sky, unit, in world space.
    pub sky_up: [f32; 3],
    /// Zero.
    pub _pad: u32,
}

/// A ray for a batch query, in (origin-relative) world space. 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct RayRecord {
    /// Where it starts.
    pub origin: [f32; 3],
    /// Hits nearer than this are passed over, in units of `direction`'s length; not negative.
    pub t_min: f32,
    /// Where it goes; any length but zero.
    pub direction: [f32; 3],
    /// Hits farther than this are passed over.
    pub t_max: f32,
}

/// What a ray hit. 32 bytes. A miss has `instance == NONE`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct HitRecord {
    /// Distance in units of the ray direction's length.
    pub t: f32,
    /// Barycentric weight of the second vertex.
    pub u: f32,
    /// Barycentric weight of the third vertex.
    pub v: f32,
    /// Index into `instances`, or [`NONE`].
    pub instance: u32,
    /// The triangle's index in its geometry.
    pub primitive: u32,
    /// The triangle's index in the `triangles` array.
    pub triangle: u32,
    /// 1 if the ray came from the side where the triangle winds clockwise in local space, else 0. That is the back as glTF
    /// defines it, under mirroring transforms too.
    pub back_face: u32,
    /// Zero.
    pub _pad: u32,
}

impl HitRecord {
    /// No hit.
    pub const MISS: Self =
        Self { t: f32::MAX, u: 0.0, v: 0.0, instance: NONE, primitive: NONE, triangle: NONE, back_face: 0, _pad: 0 };
}

/// How the rays of a batch are traced: a uniform buffer. 16 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct RayBatch {
    /// How many rays.
    pub count: u32,
    /// Instances whose mask shares no bit with this are not hit.
    pub ray_mask: u32,
    /// The first of them.
    pub first: u32,
    /// Zero.
    pub _pad: u32,
}
