//! Why a glTF file cannot be imported: the causes in [`Error::Gltf`](crate::Error::Gltf).
//!
//! Every cause is about the object that the error's JSON pointer names, and its text continues a message that begins
//! with that pointer: "/nodes/3/mesh: is index 7, but there are 2 meshes". What other crates report (JSON, base64, the
//! operating system) is kept as text, so that their types are no part of this interface.

use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// Why a glTF file cannot be imported.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum GltfFault {
    /// The file is neither JSON nor a complete GLB file.
    #[error(transparent)]
    Container(#[from] ContainerFault),
    /// The text is not JSON; with the reason and the place.
    #[error("is not valid JSON: {0}")]
    Json(String),
    /// Arrays and objects lie within one another more deeply than is read.
    #[error("is nested deeper than the {max_depth} levels that are read")]
    TooDeep {
        /// The levels that are read.
        max_depth: usize,
    },
    /// An object lacks a member that the specification requires.
    #[error("has no {member}, which glTF requires")]
    MissingMember {
        /// The member: "attributes".
        member: String,
    },
    /// A member is of another type, or an array of another length, than the specification says.
    #[error("is {found}, but must be {expected}")]
    WrongType {
        /// The JSON value in the file, in words.
        found: String,
        /// What the specification says: "a number", "an array of 3".
        expected: String,
    },
    /// A member that holds objects by index is not an array.
    #[error("is not an array")]
    NotAnArray,
    /// `asset.version` is missing.
    #[error("there is no version: this is not a glTF 2.0 file")]
    NoVersion,
    /// `asset.version` is not 2.x.
    #[error("is {found:?}; only glTF 2 is known")]
    Version {
        /// The version in the file.
        found: String,
    },
    /// `asset.minVersion` is above 2.0.
    #[error("is {found}; glTF 2.0 is the newest known")]
    MinVersion {
        /// The JSON value in the file.
        found: String,
    },
    /// A reference is not a whole number.
    #[error("is {found}, but must be an index into {target}")]
    NotAnIndex {
        /// The JSON value in the file.
        found: String,
        /// The array that the reference points into: "accessors".
        target: &'static str,
    },
    /// A reference points past the end of its array.
    #[error("is index {index}, but there are {count} {target}")]
    IndexOutOfRange {
        /// The index in the file.
        index: u64,
        /// The length of the array.
        count: usize,
        /// The array that the reference points into: "accessors".
        target: &'static str,
    },
    /// The nodes do not form trees, or a scene does not list root nodes.
    #[error(transparent)]
    Hierarchy(#[from] HierarchyFault),
    /// A node's transform is malformed.
    #[error(transparent)]
    Transform(#[from] TransformFault),
    /// The file has no scene of the index that was asked for.
    #[error("there is no scene {index}: there are {count}")]
    NoSceneIndex {
        /// The index that was asked for.
        index: usize,
        /// How many scenes the file has.
        count: usize,
    },
    /// The file has no scene of the name that was asked for.
    #[error("there is no scene \"{name}\"; there are {count}, with the names: {}", known.join(", "))]
    NoSceneName {
        /// The name that was asked for.
        name: String,
        /// How many scenes the file has, with and without names.
        count: usize,
        /// The names in the file.
        known: Vec<String>,
    },
    /// The data of a buffer or a buffer view is missing or too short.
    #[error(transparent)]
    Buffer(#[from] BufferFault),
    /// An accessor does not fit into its buffer view, or has another format than its use needs.
    #[error(transparent)]
    Accessor(#[from] AccessorFault),
    /// A mesh primitive contradicts its accessors.
    #[error(transparent)]
    Primitive(#[from] PrimitiveFault),
    /// A skin contradicts its accessors.
    #[error(transparent)]
    Skin(#[from] SkinFault),
    /// `EXT_mesh_gpu_instancing` contradicts its accessors.
    #[error(transparent)]
    Instancing(#[from] InstancingFault),
    /// An image cannot be shown; with the reason. Only a strict import fails with it.
    #[error("{0}")]
    Image(String),
    /// An enumerated member has a value that glTF does not define.
    #[error("is not a mode that glTF defines")]
    UnknownMode,
    /// A camera or a light lacks the object with the properties of its type.
    #[error("has no properties of its type")]
    NoProperties,
    /// A number overflows its type.
    #[error("{what} is not finite")]
    NotFinite {
        /// The number: "metallicFactor".
        what: &'static str,
    },
    /// A number is outside of its range, and no value near it would make sense.
    #[error("{what} is {value}, but must be {expected}")]
    OutOfRange {
        /// The number: "yfov".
        what: &'static str,
        /// The number in the file.
        value: f32,
        /// What is allowed: "above 0".
        expected: &'static str,
    },
    /// The import would need more memory than a file of this size justifies, or than
    /// [`ImportOptions::memory_limit`](super::ImportOptions::memory_limit) allows.
    #[error(
        "the import takes more than {} MiB, more than its size justifies or ImportOptions::memory_limit allows: the \
         file is damaged, or made to exhaust memory",
        limit_bytes >> 20
    )]
    Budget {
        /// The memory that the import may take, in bytes.
        limit_bytes: u64,
    },
}

/// Why a file is neither a JSON nor a GLB file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum ContainerFault {
    /// The file, or the JSON chunk of a GLB file, is empty.
    #[error("there is no JSON in it: neither a glTF nor a GLB file")]
    NoJson,
    /// The text is UTF-16; glTF is UTF-8.
    #[error("is UTF-16 text: glTF must be UTF-8, save it as that")]
    Utf16,
    /// The file is not text, nor does it begin as a GLB file does.
    #[error("is binary data, neither JSON text nor GLB: it begins with \"{}\"", first_bytes.escape_ascii())]
    Binary {
        /// The first four bytes.
        first_bytes: [u8; 4],
    },
    /// The JSON is padded with NUL bytes; glTF pads it with spaces. Only a strict import fails with it.
    #[error("the JSON ends in NUL bytes, where glTF has spaces")]
    NulPadding,
    /// The file ends within the GLB header.
    #[error("the GLB header is cut short")]
    TruncatedHeader,
    /// The GLB version is not 2.
    #[error("is GLB version {found}; only version 2 is known")]
    Version {
        /// The version in the header.
        found: u32,
    },
    /// The file is shorter than its GLB header says.
    #[error("the GLB header says {declared} bytes, but the file has {found}: was the download cut short?")]
    TruncatedFile {
        /// The length in the header, in bytes.
        declared: u32,
        /// The length of the file, in bytes.
        found: usize,
    },
    /// The length in the GLB header is less than that of the header itself.
    #[error("the GLB length is shorter than its own header")]
    LengthBelowHeader,
    /// The first GLB chunk is not the JSON chunk.
    #[error("the first GLB chunk is not JSON")]
    FirstChunkNotJson,
    /// There are two JSON chunks or two binary chunks.
    #[error("a GLB chunk of the same kind appears twice")]
    DuplicateChunk,
    /// The file ends within the header of a chunk.
    #[error("a GLB chunk header is cut short")]
    TruncatedChunkHeader,
    /// The file ends within a chunk.
    #[error("a GLB chunk says {declared} bytes, but only {found} are left")]
    TruncatedChunk {
        /// The length in the chunk's header, in bytes.
        declared: u32,
        /// The bytes that follow it.
        found: usize,
    },
    /// The GLB file has no chunk at all.
    #[error("the GLB file has no JSON chunk")]
    NoJsonChunk,
}

/// Why the nodes of a file are not trees, or a scene does not list root nodes. The numbers are indices of nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum HierarchyFault {
    /// Two nodes list the same child, or one lists it twice.
    #[error("node {child} already is a child of node {other}: a node has one parent")]
    TwoParents {
        /// The child.
        child: usize,
        /// The node that lists it first.
        other: usize,
    },
    /// A node is its own ancestor, or below one that is.
    #[error("is its own ancestor, or below one: the nodes form a cycle")]
    Cycle,
    /// A scene lists a node that has a parent. Only a strict import fails with it.
    #[error("node {node} is a child of node {parent}, so it should not be a root too")]
    NotARoot {
        /// The node that the scene lists.
        node: usize,
        /// Its parent.
        parent: usize,
    },
    /// A scene lists a node twice.
    #[error("node {node} is listed twice")]
    ListedTwice {
        /// The node.
        node: usize,
    },
}

/// Why a node has no local transform.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum TransformFault {
    /// A member is not an array of so many numbers.
    #[error("its {member} is not an array of {count} numbers")]
    NotNumbers {
        /// The member: "translation".
        member: &'static str,
        /// The number of elements that it must have.
        count: usize,
    },
    /// All components of the rotation are zero.
    #[error("its rotation is zero: it must be a unit quaternion")]
    ZeroRotation,
    /// There are a matrix and a translation, rotation or scale, which exclude one another.
    #[error("it has both a matrix and a translation, rotation or scale")]
    MatrixAndTrs,
    /// A camera or light has no direction, because its node is scaled to zero along an axis. Only a strict import fails
    /// with it.
    #[error("is scaled to zero along an axis")]
    ZeroScale,
    /// The matrix is a projection.
    #[error("its matrix is not affine: the last row must be 0, 0, 0, 1")]
    NotAffine,
}

/// Why a buffer or a buffer view has no data.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum BufferFault {
    /// The buffer's URI cannot be read.
    #[error(transparent)]
    Uri(#[from] UriFault),
    /// The data is shorter than `byteLength`.
    #[error("has {found} bytes, but its byteLength is {declared}: was the file cut short?")]
    TooShort {
        /// The length of the data, in bytes.
        found: usize,
        /// `byteLength`.
        declared: u64,
    },
    /// The buffer has neither a URI nor the binary chunk of a GLB file.
    #[error("has no URI, and there is no binary GLB chunk for it: its data is missing")]
    NoData,
    /// A buffer view reaches past the end of its buffer.
    #[error("its {length} bytes from {offset} do not fit into a buffer of {available}")]
    ViewOutOfRange {
        /// `byteLength` of the view.
        length: u64,
        /// `byteOffset` of the view.
        offset: u64,
        /// `byteLength` of the buffer.
        available: u64,
    },
}

/// Why a URI cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum UriFault {
    /// The scheme is not `data:`. An import never accesses the network.
    #[error("the URI scheme \"{scheme}:\" is not supported: only data: and relative files are")]
    Scheme {
        /// The scheme, without the colon.
        scheme: String,
    },
    /// The path is absolute, or has a drive or share prefix, on some platform.
    #[error("{path} is an absolute path: only paths relative to the glTF file are read")]
    AbsolutePath {
        /// The path, percent-decoded if it was absolute only then.
        path: String,
    },
    /// [`ImportOptions::files`](super::ImportOptions::files) does not allow the file. It may exist or not.
    #[error("the external file {uri:?} {rule}")]
    NotAllowed {
        /// The URI in the glTF file.
        uri: String,
        /// The rule that it breaks.
        rule: FileRule,
    },
    /// The application's resolver returned an error.
    #[error("the application's resolver has no bytes for {uri:?}: {message}")]
    Resolver {
        /// The URI in the glTF file.
        uri: String,
        /// The kind of failure.
        kind: io::ErrorKind,
        /// The resolver's message.
        message: String,
    },
    /// The path has a NUL byte in it.
    #[error("the URI has a NUL byte in it, which no file name has")]
    NulByte,
    /// The file cannot be read.
    #[error("the external file {path} cannot be read: {message}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The kind of failure.
        kind: io::ErrorKind,
        /// The message of the operating system.
        message: String,
    },
    /// The data URI has no comma before its data.
    #[error("the data URI has no comma, hence no data")]
    NoComma,
    /// The base64 text has white space in it, or the letters of URLs. Only a strict import fails with it.
    #[error("the base64 text of the data URI has white space or the letters - and _ in it")]
    Base64Spelling,
    /// The data URI is not valid base64; with the decoder's message.
    #[error("the data URI is not valid base64: {0}")]
    Base64(String),
}

/// The rule for external files that a URI breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum FileRule {
    /// Only files in the glTF file's own folder are read.
    #[error("is not in the folder of the glTF file: copy it there, or allow its folder by ImportOptions::files")]
    OwnFolder,
    /// Only files below given folders are read.
    #[error("is below none of the folders that ImportOptions::files allows: add its folder there, or copy it into one")]
    Below,
}

/// Why an accessor cannot be read. Formats are written as in the specification: "VEC3 of normalized unsigned byte".
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum AccessorFault {
    /// `count` exceeds the address space.
    #[error("its count is beyond all memory")]
    CountTooLarge,
    /// `byteStride` of the buffer view is less than the size of an element.
    #[error("the byteStride of buffer view {view} is {stride}, less than an element of {size} bytes")]
    StrideTooSmall {
        /// The index of the buffer view.
        view: usize,
        /// Its `byteStride`.
        stride: usize,
        /// The size of an element, in bytes.
        size: usize,
    },
    /// The elements reach past the end of their buffer view.
    #[error(
        "its {count} elements of {size} bytes, {stride} apart, from byte {offset}, do not fit into the {available} \
         bytes of buffer view {view}"
    )]
    OutOfRange {
        /// The number of elements.
        count: usize,
        /// The size of an element, in bytes.
        size: usize,
        /// The distance from one element to the next, in bytes.
        stride: usize,
        /// The offset of the first element in the buffer view, in bytes.
        offset: u64,
        /// `byteLength` of the buffer view.
        available: u64,
        /// The index of the buffer view.
        view: usize,
    },
    /// There are more sparse elements than elements.
    #[error("its count is {count}, but the accessor has {accessor_count}")]
    SparseCount {
        /// The number of sparse elements.
        count: u64,
        /// The number of elements.
        accessor_count: usize,
    },
    /// The component type of the sparse indices is not one that glTF defines.
    #[error("its indices are of an unknown type")]
    SparseIndexType,
    /// A sparse index is not below the number of elements.
    #[error("replaces element {element}, but the accessor has {accessor_count}")]
    SparseIndexOutOfRange {
        /// The sparse index.
        element: u32,
        /// The number of elements.
        accessor_count: usize,
    },
    /// The sparse indices do not increase strictly.
    #[error("its indices do not ascend")]
    SparseOrder,
    /// The type or component type is not one that glTF defines.
    #[error("is of an unknown type")]
    UnknownFormat,
    /// The format is not one that the use of the accessor allows.
    #[error("is {found}, but {role} must be {expected}")]
    Format {
        /// The accessor's format.
        found: String,
        /// What it is used for: "POSITION".
        role: &'static str,
        /// The formats that this use allows.
        expected: &'static str,
    },
    /// An element has another number of components than its use needs.
    #[error("is {found}, but must have {expected} components")]
    ComponentCount {
        /// The accessor's format.
        found: String,
        /// The number of components needed.
        expected: usize,
    },
    /// Its elements are 32-bit integers where f32 is read.
    #[error("32-bit integers are no coordinates")]
    IntegerCoordinates,
    /// Its elements are no unsigned integers where these are read.
    #[error("holds no unsigned integers")]
    NotUnsigned,
    /// Its buffer has no data.
    #[error("its buffer has no data")]
    NoData,
    /// An element is infinite or not a number.
    #[error("element {element} is not finite")]
    NotFinite {
        /// The index of the element.
        element: usize,
    },
    /// Colours are integers that are not marked as normalized. Only a strict import fails with it.
    #[error("is {found}, but colours must be floats or normalized")]
    NotNormalized {
        /// The accessor's format.
        found: String,
    },
    /// A normal has no direction. Only a strict import fails with it.
    #[error("element {element} is no direction: it is zero or not finite")]
    NoDirection {
        /// The index of the element.
        element: usize,
    },
    /// A vertex hangs on no joint: all its weights are zero. Only a strict import fails with it.
    #[error("all weights of element {element} are zero")]
    NoWeight {
        /// The index of the element.
        element: usize,
    },
    /// A vertex index is not below the number of vertices.
    #[error("index {position} is {index}, but there are {vertex_count} vertices")]
    VertexIndexOutOfRange {
        /// The position of the index in the accessor.
        position: usize,
        /// The index.
        index: u32,
        /// The number of vertices.
        vertex_count: usize,
    },
    /// A vertex index is the largest value of its type, which glTF forbids.
    #[error("index {position} is {index}, which restarts primitives in some renderers: glTF forbids it")]
    PrimitiveRestart {
        /// The position of the index in the accessor.
        position: usize,
        /// The index.
        index: u32,
    },
    /// A vertex refers to a joint that its skin does not have. If its weight on it is zero, only a strict import fails.
    #[error("refers to joint {joint}, but the skin has {joint_count}")]
    JointOutOfRange {
        /// The index of the joint in the skin.
        joint: u32,
        /// The number of joints of the skin.
        joint_count: usize,
    },
}

/// Why a mesh primitive contradicts its accessors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum PrimitiveFault {
    /// An attribute or a morph target has another number of elements than there are positions.
    #[error("accessor {accessor} has {count} elements, but there are {vertex_count} positions")]
    AttributeCount {
        /// The index of the attribute's accessor.
        accessor: usize,
        /// Its number of elements.
        count: usize,
        /// The number of positions.
        vertex_count: usize,
    },
    /// The primitive is larger than a [`Geometry`](crate::graph::Geometry) can be.
    #[error("has more than {max_triangles} triangles, or than 2^32 vertices")]
    TooLarge {
        /// The largest number of triangles.
        max_triangles: usize,
    },
    /// Morph targets or joints move a vertex to where it has no f32 coordinates.
    #[error("morph targets or joints move a vertex beyond the range of f32")]
    PoseNotFinite,
}

/// Why a skin contradicts its accessors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum SkinFault {
    /// There are more joints than inverse bind matrices.
    #[error("has {joints} joints, but only {matrices} inverse bind matrices")]
    TooFewMatrices {
        /// The number of joints.
        joints: usize,
        /// The number of matrices.
        matrices: usize,
    },
}

/// Why the instances of `EXT_mesh_gpu_instancing` cannot be placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum InstancingFault {
    /// There is no attribute that would say how many instances there are.
    #[error("has no attributes, so the number of instances is unknown")]
    NoAttributes,
    /// Two attributes have different numbers of elements.
    #[error("its attributes have different numbers of instances")]
    DifferentCounts,
    /// All components of a rotation are zero.
    #[error("the rotation of instance {instance} is zero")]
    ZeroRotation {
        /// The index of the instance.
        instance: usize,
    },
}
