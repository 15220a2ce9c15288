//! Every type that crosses to the device, byte for byte. `shaders/shared/types.wgsl` declares the same structs; a test
//! compares member names, offsets and sizes of both.
//!
//! Members whose names begin with `_pad` fill a struct up to the alignment that WGSL asks for. They are zero, and not
//! public: make a value with the type's constructor, or with `bytemuck::Zeroable::zeroed()` and assignments.

use bytemuck::{Pod, Zeroable};

use crate::Result;
use crate::error::require;

/// "No index" in any index of the device arrays; as an [escape index](Node::escape_index), the end of the hierarchy.
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
    /// The leaf's primitives; [`PrimitiveRange::INNER`] for an inner node.
    pub primitives: PrimitiveRange,
}

impl Node {
    /// The coordinate from which a box marks an unused node: the largest finite f32 less one ulp. Boxes in use lie
    /// below it.
    pub(crate) const UNUSED_COORDINATE: f32 = f32::from_bits(f32::MAX.to_bits() - 1);

    /// An unused leaf of the top level. It is encoded as an inner node without children, so that traversal continues at
    /// its escape index whether it meets the box or not; the box lies at the largest finite coordinates, which rays do
    /// not reach. It must not be the last node of an array. An inner node above unused leaves only has the same box.
    pub fn unused_leaf(escape_index: u32) -> Self {
        Self { min: [Self::UNUSED_COORDINATE; 3], escape_index, max: [f32::MAX; 3], primitives: PrimitiveRange::INNER }
    }

    /// Whether this is an unused leaf, or an inner node above unused leaves only. Code that visits all children of an
    /// inner node must skip such nodes.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.min[0] >= Self::UNUSED_COORDINATE
    }

    /// Whether this is a leaf that holds primitives. An unused leaf is not: it is encoded as an inner node.
    #[inline]
    pub fn is_leaf(&self) -> bool {
        self.primitives != PrimitiveRange::INNER
    }

    /// Whether the hierarchy whose first node this is holds nothing: the node is all zero, as in an array that is
    /// filled up for the device, or unused. No escape index of a hierarchy in use leads back to its first node.
    #[inline]
    pub fn is_empty_root(&self) -> bool {
        self.escape_index == 0 || self.is_empty()
    }

    /// The index after the last node of this node's subtree, relative to the first node of a hierarchy of `node_count`
    /// nodes.
    #[inline]
    pub fn subtree_end(&self, node_count: usize) -> usize {
        if self.escape_index == NONE { node_count } else { self.escape_index as usize }
    }

    /// The index of the right child of the binary inner node at `index`. The left child follows the inner node, and its
    /// escape index leads to its sibling. `nodes` starts with the hierarchy's first node.
    ///
    /// ```
    /// use ropewalk::device::layout::{NONE, Node, PrimitiveRange};
    ///
    /// let node = |escape_index, primitives| Node { min: [0.0; 3], escape_index, max: [1.0; 3], primitives };
    /// let nodes = [
    ///     node(NONE, PrimitiveRange::INNER),   // 0: children 1 and 4
    ///     node(4, PrimitiveRange::INNER),      // 1: children 2 and 3
    ///     node(3, PrimitiveRange::leaf(0, 1)), // 2
    ///     node(4, PrimitiveRange::leaf(1, 1)), // 3
    ///     node(NONE, PrimitiveRange::leaf(2, 1)),
    /// ];
    /// assert_eq!(Node::right_child(&nodes, 0), 4);
    /// assert_eq!(Node::right_child(&nodes, 1), 3);
    /// assert_eq!(nodes[1].subtree_end(nodes.len()), 4);
    /// ```
    #[inline]
    pub fn right_child(nodes: &[Self], index: usize) -> usize {
        nodes[index + 1].escape_index as usize
    }
}

/// The primitives of a leaf of [`Node`]s, packed into 32 bits, or the mark of an inner node.
///
/// | | bits 28 to 31 | bits 0 to 27 |
/// |---|---|---|
/// | [`leaf`](Self::leaf) | primitive count, 1 to 15 | first primitive |
/// | [`INNER`](Self::INNER) | 0 | 0 |
///
/// In a bottom-level structure the first primitive is a triangle, counted from the instance's `first_triangle`; in the
/// top level it is an instance index, and the count is 1.
///
/// ```
/// use ropewalk::device::layout::PrimitiveRange;
///
/// // Triangles 5, 6 and 7.
/// let leaf = PrimitiveRange::leaf(5, 3);
/// assert_eq!(bytemuck::cast::<_, u32>(leaf), 0x3000_0005);
/// assert_eq!((leaf.first_primitive(), leaf.primitive_count()), (5, 3));
/// assert_eq!(bytemuck::cast::<_, u32>(PrimitiveRange::INNER), 0);
/// ```
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct PrimitiveRange(u32);

impl PrimitiveRange {
    /// The mark of an inner node, and of an [unused leaf](Node::unused_leaf): no primitives.
    pub const INNER: Self = Self(0);
    /// The most primitives in one leaf.
    pub const MAX_COUNT: u32 = 15;
    /// Exclusive limit of the first primitive: 2^28.
    pub const MAX_FIRST: u32 = 1 << 28;

    /// The range of a leaf.
    ///
    /// # Panics
    /// In debug builds, if `first` is 2^28 or more or `count` is not 1 to 15. Builders guarantee both.
    #[inline]
    pub fn leaf(first: u32, count: u32) -> Self {
        debug_assert!(first < Self::MAX_FIRST && (1..=Self::MAX_COUNT).contains(&count), "{first} + {count}");
        Self(first | count << 28)
    }

    /// The first primitive.
    #[inline]
    pub fn first_primitive(self) -> u32 {
        self.0 & (Self::MAX_FIRST - 1)
    }

    /// How many primitives; 0 for an inner node.
    #[inline]
    pub fn primitive_count(self) -> u32 {
        self.0 >> 28
    }
}

/// One child of a [`WideNode`], packed into 32 bits: an inner node, a leaf, or an unused slot.
///
/// | | bits 28 to 31 | bits 0 to 27 |
/// |---|---|---|
/// | [`node`](Self::node) | 0 | index of the child, at least 1, relative to the structure's first wide node |
/// | [`leaf`](Self::leaf) | triangle count, 1 to 15 | first triangle, counted from the instance's `first_triangle` |
/// | [`UNUSED`](Self::UNUSED) | 0 | 0 |
///
/// Index 0 is the root, which is no node's child, so it can mark an unused slot. Traversal tells unused slots by
/// [`WideNode::child_mask`].
///
/// ```
/// use ropewalk::device::layout::{PrimitiveRange, WideChild};
///
/// let bits = |child: WideChild| bytemuck::cast::<_, u32>(child);
/// // The wide node at index 7.
/// let node = WideChild::node(7);
/// assert_eq!((bits(node), node.is_leaf(), node.node_index()), (0x0000_0007, false, 7));
/// // Triangles 5, 6 and 7.
/// let leaf = WideChild::leaf(5, 3);
/// assert_eq!((bits(leaf), leaf.is_leaf(), leaf.triangles()), (0x3000_0005, true, PrimitiveRange::leaf(5, 3)));
/// assert_eq!((bits(WideChild::UNUSED), WideChild::UNUSED.is_unused()), (0, true));
/// ```
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct WideChild(u32);

impl WideChild {
    /// An unused slot.
    pub const UNUSED: Self = Self(0);

    /// An inner node, by its index relative to the structure's first wide node.
    ///
    /// # Panics
    /// In debug builds, if `index` is 0 (the root) or 2^28 or more.
    #[inline]
    pub fn node(index: u32) -> Self {
        debug_assert!((1..PrimitiveRange::MAX_FIRST).contains(&index), "{index}");
        Self(index)
    }

    /// A leaf with `count` triangles from `first` on.
    ///
    /// # Panics
    /// In debug builds, as [`PrimitiveRange::leaf`].
    #[inline]
    pub fn leaf(first: u32, count: u32) -> Self {
        Self(PrimitiveRange::leaf(first, count).0)
    }

    /// Whether this is a leaf.
    #[inline]
    pub fn is_leaf(self) -> bool {
        self.triangles().primitive_count() > 0
    }

    /// Whether the slot is unused.
    #[inline]
    pub fn is_unused(self) -> bool {
        self == Self::UNUSED
    }

    /// The index of an inner node relative to the structure's first wide node. Meaningless for a leaf or an unused
    /// slot.
    #[inline]
    pub fn node_index(self) -> u32 {
        self.triangles().first_primitive()
    }

    /// The triangles of a leaf. Without any for an inner node or an unused slot.
    #[inline]
    pub fn triangles(self) -> PrimitiveRange {
        PrimitiveRange(self.0)
    }
}

/// An 8-wide node of a bottom-level hierarchy with quantised child boxes. Read by the GPU kernel and its emulated twin
/// under `Traversal::Wide`, and by the CPU executor. The boxes contain those of the binary [`Node`]s and exceed them by
/// at most one grid step a side (`accel::blas::quantize`). 96 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct WideNode {
    /// Least corner of the grid, local space.
    pub origin: [f32; 3],
    /// Bytes 0 to 2: biased exponents of the grid's steps, see [`grid_step`](Self::grid_step). Byte 3: the
    /// [`child_mask`](Self::child_mask).
    pub exponents: [u8; 4],
    /// `planes[axis][0]` holds the lower planes of the eight children, `planes[axis][1]` the upper ones, in steps from
    /// `origin`.
    pub planes: [[[u8; 8]; 2]; 3],
    /// The child in each slot.
    pub children: [WideChild; 8],
}

impl WideNode {
    /// The used slots: bit k is set if there is a child in slot k.
    #[inline]
    pub fn child_mask(&self) -> u8 {
        self.exponents[3]
    }

    /// The length of a grid step along x, y and z, in local units: a power of two, 2^(exponent - 127).
    #[inline]
    pub fn grid_step(&self) -> [f32; 3] {
        let [x, y, z, _] = self.exponents.map(|exponent| f32::from_bits(u32::from(exponent) << 23));
        [x, y, z]
    }
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
    pub(crate) _pad0: u32,
    /// Third vertex.
    pub v2: [f32; 3],
    pub(crate) _pad1: u32,
}

impl Triangle {
    /// A triangle with three vertices in local space; `primitive` is its index in its geometry.
    #[inline]
    pub fn new([v0, v1, v2]: [[f32; 3]; 3], primitive: u32) -> Self {
        Self { v0, primitive, v1, _pad0: 0, v2, _pad1: 0 }
    }
}

/// An instance of a bottom-level structure in the world (the paper's Node Primitive). On the device, "world" means
/// world space relative to the scene's render origin. 128 bytes.
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
    /// The instance is skipped by rays whose mask has no bit in common with this.
    pub mask: u32,
    /// [`InstanceFlags`].
    pub flags: u32,
    /// The scene node's key as two words of slotmap's `KeyData::as_ffi`: the key's slot, then its generation. (Not an
    /// instance index.)
    pub node_key: [u32; 2],
}

bitflags::bitflags! {
    /// Properties of an instance and its material that traversal needs.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct InstanceFlags: u32 {
        /// Closest hits on back faces are rejected: the material is single-sided and not transmissive.
        const CULL_BACK = 1;
        /// The material decides whether a candidate for the closest hit is a hole (alpha mask), or a fully transparent
        /// part of a blended surface.
        const ALPHA_MASK = 2;
        /// An occlusion query must evaluate the material's transmittance (alpha mask, blend or transmission).
        const TRANSLUCENT = 4;
        /// A transmissive material on a surface that is a thin wall, by its [`WallKind`](crate::graph::WallKind): light
        /// passes without refraction.
        const THIN = 8;
        /// Some triangle is in several leaves (spatial splits, kd-tree), so a ray may meet it more than once: queries
        /// that accumulate over hits must count it once.
        const HAS_DUPLICATES = 16;
        /// Three bits, one for each row of `local_from_world`, first the lowest: the row has one number that is not
        /// zero (the translation not counted), and that is a power of two, so that it multiplies without rounding.
        const EXACT_LOCAL_ROWS = 0b111 << 8;
        /// The same for the rows of `world_from_local`.
        const EXACT_WORLD_ROWS = 0b111 << 11;
    }
}

/// Offsets of a geometry's vertex streams and wide nodes in the device arrays; [`NONE`] for a stream that the geometry
/// lacks. 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct GeometryRecord {
    /// Into `indices`, in `u32`s: the three vertices of triangle `primitive` are at `first_index + 3 * primitive`.
    /// [`NONE`] for a geometry without any stream, whose vertex indices nothing reads.
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
    pub(crate) _pad: [u32; 2],
}

impl GeometryRecord {
    /// A geometry without vertex streams and without wide nodes: [`NONE`] everywhere.
    pub const EMPTY: Self = Self {
        first_index: NONE,
        first_normal: NONE,
        first_tex_coord_0: NONE,
        first_tex_coord_1: NONE,
        first_color: NONE,
        first_wide_node: NONE,
        _pad: [0; 2],
    };
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
    /// The least alpha that is not a hole, where [`MaterialFlags::MASK`] is set.
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
    pub(crate) _pad: u32,
}

bitflags::bitflags! {
    /// Material properties that are either on or off.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct MaterialFlags: u32 {
        /// Where alpha is below `alpha_cutoff` the surface has a hole.
        const MASK = 1;
        /// Alpha is opacity: the fraction of light that the surface does not let through.
        const BLEND = 2;
        /// The base colour is shown without lighting (`KHR_materials_unlit`).
        const UNLIT = 4;
    }
}

/// One texture reference of a material: its texels, coordinate transform and sampler (the paper's `TexInfo`). 48 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct TextureInfo {
    /// First row of the affine map from texture coordinates to image coordinates: `u' = dot(row_u.xyz, (u, v, 1))`.
    pub row_u: [f32; 4],
    /// Second row.
    pub row_v: [f32; 4],
    /// Index of the first texel in `texels`.
    pub first_texel: u32,
    /// Texels per row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// [`TextureFlags`].
    pub flags: u32,
}

bitflags::bitflags! {
    /// Sampler settings and colour space. Without a wrap flag the texture repeats along that axis.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct TextureFlags: u32 {
        /// Mirrored beyond the left and right edges.
        const MIRROR_U = 1;
        /// The edge texel is repeated beyond the left and right edges.
        const CLAMP_U = 2;
        /// Mirrored beyond the upper and lower edges.
        const MIRROR_V = 4;
        /// The edge texel is repeated beyond the upper and lower edges.
        const CLAMP_V = 8;
        /// The nearest texel instead of bilinear interpolation.
        const NEAREST = 16;
        /// Texels are sRGB encoded.
        const SRGB = 32;
        /// Uses texture coordinate set 1, not 0.
        const TEX_COORD_1 = 64;
    }
}

/// A light in world space relative to the render origin. 64 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LightRecord {
    /// Position (point, spot).
    pub position: [f32; 3],
    /// [`LIGHT_POINT`], [`LIGHT_SPOT`] or [`LIGHT_DIRECTIONAL`].
    pub kind: u32,
    /// The direction in which light travels, a unit vector (spot, directional).
    pub direction: [f32; 3],
    /// The light has no effect beyond this distance, in world units; `f32::MAX` if unlimited.
    pub range: f32,
    /// Linear colour times intensity.
    pub color: [f32; 3],
    /// Spot: `saturate(cos(angle) * cone_scale + cone_offset)` squared is the falloff (`KHR_lights_punctual`).
    pub cone_scale: f32,
    /// See [`cone_scale`](Self::cone_scale).
    pub cone_offset: f32,
    pub(crate) _pad0: u32,
    pub(crate) _pad1: u32,
    pub(crate) _pad2: u32,
}

/// [`LightRecord::kind`]: emits in all directions from a point.
pub const LIGHT_POINT: u32 = 0;
/// [`LightRecord::kind`]: emits into a cone.
pub const LIGHT_SPOT: u32 = 1;
/// [`LightRecord::kind`]: infinitely far away.
pub const LIGHT_DIRECTIONAL: u32 = 2;

/// Per-frame parameters: the uniform buffer of a dispatch. Positions are relative to the render origin. 144 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct FrameParams {
    /// Camera position (perspective), or the image's centre (orthographic).
    pub eye: [f32; 3],
    /// Pixels per row.
    pub width: u32,
    /// From the image's centre to the middle of its right edge, in world units: at distance 1 from the eye
    /// (perspective), or in the image plane (orthographic).
    pub right: [f32; 3],
    /// Number of rows.
    pub height: u32,
    /// From the image's centre to the middle of its upper edge, likewise.
    pub up: [f32; 3],
    /// The most reflections and refractions along a path.
    pub max_depth: u32,
    /// From the eye to the image's centre in the plane at distance 1 (perspective), or the unit vector along which the
    /// camera looks (orthographic).
    pub forward: [f32; 3],
    /// 1 for an orthographic camera, else 0.
    pub orthographic: u32,
    /// Radiance of the sky straight up.
    pub sky_zenith: [f32; 3],
    /// Instances whose mask has no bit in common with this are not hit.
    pub ray_mask: u32,
    /// Radiance at the horizon.
    pub sky_horizon: [f32; 3],
    /// How many elements of `lights` are in use.
    pub light_count: u32,
    /// Radiance straight down.
    pub sky_ground: [f32; 3],
    /// The first image row of this dispatch: an image may be traced in several strips of rows.
    pub first_row: u32,
    /// The up direction of the sky, unit, in world space.
    pub sky_up: [f32; 3],
    /// The most rays of a pixel, shadow rays not counted: see [`View::max_rays`](crate::View::max_rays).
    pub max_rays: u32,
    /// Camera rays start at this distance: see [`View::near`](crate::View::near).
    pub near: f32,
    /// Rays of no more throughput see the sky: see [`View::min_throughput`](crate::View::min_throughput).
    pub min_throughput: f32,
    pub(crate) _pad: [u32; 2],
}

/// A ray of a batch query, in world space relative to the render origin. 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct RayRecord {
    /// Where the ray starts.
    pub origin: [f32; 3],
    /// Hits nearer than this are ignored, in units of the length of `direction`; at least 0.
    pub t_min: f32,
    /// The direction of the ray; not zero, need not be normalised.
    pub direction: [f32; 3],
    /// Hits farther than this are ignored, in the same units.
    pub t_max: f32,
}

impl RayRecord {
    /// The longest component of a direction is between these, 2^-100 and 2^100: the reciprocal of one that is far
    /// shorter than the longest must be within f32, and so must products with a normal.
    const DIRECTION_RANGE: std::ops::RangeInclusive<f32> = 1.0 / (1_u128 << 100) as f32..=(1_u128 << 100) as f32;

    /// Validates the ray.
    ///
    /// # Errors
    /// [`Error::OutOfRange`](crate::Error::OutOfRange) if the origin is not finite, the longest component of the
    /// direction is not between 2^-100 and 2^100, `t_min` is negative, or a limit is NaN.
    pub fn validate(&self) -> Result<()> {
        let longest = self.direction.iter().fold(0.0, |longest: f32, d| longest.max(d.abs()));
        require(self.origin.iter().all(|x| x.is_finite()), "ray origin", &self.origin, "finite")?;
        let is_direction = Self::DIRECTION_RANGE.contains(&longest) && self.direction.iter().all(|d| d.is_finite());
        require(is_direction, "ray direction", &self.direction, "between 2^-100 and 2^100 in its longest component")?;
        let range = [self.t_min, self.t_max];
        require(self.t_min >= 0.0 && !self.t_max.is_nan(), "ray interval", &range, "two numbers from 0 on")
    }
}

/// The hit of a ray. A miss has `instance == NONE`, see [`MISS`](Self::MISS). 32 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct HitRecord {
    /// Distance along the ray, in units of the length of its direction.
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
    /// 1 if the ray came from the side where the triangle winds clockwise in local space, else 0. That is the back as
    /// glTF defines it, under mirroring transforms too.
    pub back_face: u32,
    /// The distance by which hits are ordered: `t`, but a little less for translucent surfaces and a little more for
    /// back faces, so that the order is defined where surfaces touch.
    pub depth: f32,
}

impl HitRecord {
    /// No hit.
    pub const MISS: Self = Self {
        t: f32::MAX,
        u: 0.0,
        v: 0.0,
        instance: NONE,
        primitive: NONE,
        triangle: NONE,
        back_face: 0,
        depth: f32::MAX,
    };
}

/// Parameters of a batch of rays: a uniform buffer. 16 bytes.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct RayBatch {
    /// How many rays.
    pub count: u32,
    /// Instances whose mask has no bit in common with this are not hit.
    pub ray_mask: u32,
    /// The index of the batch's first ray in the ray buffer.
    pub first: u32,
    pub(crate) _pad: u32,
}

impl RayBatch {
    /// A batch of `count` rays from index `first` of the ray buffer on.
    pub fn new(first: u32, count: u32, ray_mask: u32) -> Self {
        Self { count, ray_mask, first, _pad: 0 }
    }
}
