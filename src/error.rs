//! The error type of the crate, the types of its fields, and the checks that many modules share.

use std::fmt::{self, Debug};
use std::io;
use std::path::{Path, PathBuf};

use crate::gltf::{GltfFault, MAX_MESSAGE, printable};
use crate::graph::{CoreKind, NodeKey, ObjectKey, SceneFileError};

/// [`std::result::Result`] with this crate's [`enum@Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The error of every fallible call. Each variant carries the key, path, index or limit concerned, and its message the
/// likely cause.
///
/// A call that returns an error leaves the scene and the file system as they were, with two exceptions: a
/// [`Recorder`](crate::graph::Recorder) replaces the file before it writes the first frame, and may leave an incomplete
/// last frame; a [transaction](crate::Scene::transaction) that was rolled back has raised the scene's
/// [`revision`](crate::Scene::revision).
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The key does not refer to an object of this scene.
    #[error("{object} is not in this scene: it was removed, or its key comes from another scene")]
    StaleKey {
        /// The key that was passed in.
        object: ObjectKey,
    },
    /// The edit would make a node its own ancestor, through parents or through instances.
    #[error(
        "{node} cannot become a child of {parent}: {parent} is {node} itself, below it, or shown by an instance below \
         it (cycle)"
    )]
    Cycle {
        /// The node that would get the parent: the node that moves, or the target of an instance.
        node: NodeKey,
        /// The parent that it would get: the new parent, or the node with the instance core.
        parent: NodeKey,
    },
    /// A call tried to remove or move the root node, or to give it a core other than
    /// [`Core::Group`](crate::Core::Group).
    #[error("the root node cannot be {attempt}: every scene has exactly one root, and it is a group")]
    Root {
        /// The edit that was attempted.
        attempt: RootEdit,
    },
    /// A node's core is of another kind than the call needs.
    #[error("{node} has a core of kind {found} where one of kind {expected} is needed{}", wrong_core_advice(*expected))]
    WrongCore {
        /// The node.
        node: NodeKey,
        /// The kind of core that the call needs.
        expected: CoreKind,
        /// The kind of core that the node has.
        found: CoreKind,
    },
    /// A node's world matrix is not invertible, so no local transform below it can preserve a world transform.
    #[error(
        "{node} cannot keep its world transform below {parent}, whose own cannot be inverted: some scale at or above \
         {parent} is 0, or too small or large"
    )]
    Singular {
        /// The node that was to move.
        node: NodeKey,
        /// The parent that it was to get, whose world matrix is singular.
        parent: NodeKey,
    },
    /// An internal invariant of the scene is violated. Only [`Scene::validate`](crate::Scene::validate) returns this;
    /// it is a bug in Ropewalk.
    #[error("internal defect: {object}: {what}")]
    Defect {
        /// The object that is wrong.
        object: ObjectKey,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A value is outside its allowed range or not finite.
    #[error("{what} is {value}, but must be {expected}")]
    OutOfRange {
        /// Name of the value: "material roughness".
        what: &'static str,
        /// The value, as given.
        value: String,
        /// The allowed values: "finite", "between 0 and 1".
        expected: &'static str,
    },
    /// A geometry's arrays are inconsistent: wrong lengths, an index out of range, or a value that is not finite.
    #[error("geometry {what}[{index}] is {value}, but {expected}")]
    InvalidGeometry {
        /// The array: "positions", "indices", "normals".
        what: &'static str,
        /// The first offending element (or the array's length, where the length is wrong).
        index: usize,
        /// The offending value.
        value: String,
        /// The allowed values, and the limit.
        expected: String,
    },
    /// A delta does not fit the scene that it was applied to.
    #[error("{object}: {cause}: the delta is damaged, or was made for another state of the scene")]
    Delta {
        /// The first object whose state does not fit.
        object: ObjectKey,
        /// Why it does not fit.
        cause: DeltaFault,
    },
    /// Undo or redo was called by the edits of a transaction.
    #[error("cannot {attempt} within a transaction: let it end first")]
    Transaction {
        /// The call.
        attempt: HistoryStep,
    },
    /// The [`EditQueue`](crate::graph::EditQueue) was dropped before it applied the batch.
    #[error("the edits were not applied: their queue was dropped")]
    QueueClosed,
    /// A scene file or recording is damaged, of another format version, or not such a file.
    #[error("{path}: frame {frame}: {source}")]
    SceneFile {
        /// The file.
        path: PathBuf,
        /// Index of the frame in the file; a saved scene has frame 0 only.
        frame: usize,
        /// What is wrong with it.
        source: SceneFileError,
    },
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: IoFault,
    },
    /// A glTF file breaks the specification, or is damaged.
    #[error("{path}: {}", gltf_message(pointer, cause))]
    Gltf {
        /// The file.
        path: PathBuf,
        /// The JSON pointer of the offending object, as the glTF validator writes it: "/nodes/3/children/0". Empty for
        /// the file as a whole.
        pointer: String,
        /// What is wrong with it.
        cause: GltfFault,
    },
    /// A glTF file requires an extension that Ropewalk does not support.
    #[error("{path}: requires the extension {}, which is not supported", printable(extension, MAX_MESSAGE))]
    UnsupportedExtension {
        /// The file.
        path: PathBuf,
        /// The extension's name.
        extension: String,
    },
    /// The call was stopped by its [`Cancel`](crate::Cancel) token. The scene is as it was, and the call can be made
    /// again, with another token.
    #[error("the call was cancelled")]
    Cancelled,
    /// There is no usable GPU.
    #[error("no usable GPU: {reason}")]
    NoGpu {
        /// Each adapter that was considered, and why it was rejected.
        reason: String,
    },
    /// The scene, image or call needs more of a resource than there is.
    #[error(
        "{resource} needs {needed} {}, more than the limit of {limit}{}",
        resource.unit(),
        Advice(resource.advice())
    )]
    Limit {
        /// The resource.
        resource: Resource,
        /// The amount needed, in the [unit](Resource::unit) of the resource.
        needed: u64,
        /// The amount that there is.
        limit: u64,
    },
    /// The GPU driver reported a failure.
    #[error("the GPU failed during {during}: {message}")]
    Gpu {
        /// The operation: "frame readback".
        during: &'static str,
        /// The driver's message.
        message: String,
    },
    /// The GPU device was lost: the GPU was unplugged, its driver restarted or updated, or a submission ran too long
    /// (watchdog). Nothing stored on the device survives.
    #[error("the device was lost during {during}: {message}")]
    DeviceLost {
        /// The operation that was running or about to start.
        during: &'static str,
        /// The driver's message.
        message: String,
    },
    /// The GPU has no memory left: the scene or the image is too large for it, or other programs use the memory.
    #[error("out of GPU memory during {during}: {message}; render a smaller image or scene, or on the CPU")]
    OutOfMemory {
        /// The operation: "the upload of the scene".
        during: &'static str,
        /// The driver's message.
        message: String,
    },
    /// A file name does not say which image format to write.
    #[error("{path}: the ending of the name is not that of an image format Ropewalk writes (.png or .exr)")]
    ImageFormat {
        /// The file.
        path: PathBuf,
    },
    /// An image could not be encoded.
    #[error("{path}: {cause}")]
    Image {
        /// The file.
        path: PathBuf,
        /// The encoder's message.
        cause: String,
    },
}

impl Error {
    /// The error of reading or writing the file `path`.
    pub(crate) fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), source: source.into() }
    }

    /// The error of needing more of a resource than there is. The only function that constructs it; most callers call
    /// [`require_within`].
    pub(crate) fn limit(resource: Resource, needed: u64, limit: u64) -> Self {
        Self::Limit { resource, needed, limit }
    }
}

/// The message about an object of a glTF file. Both parts can quote the file, which may hold anything.
fn gltf_message(pointer: &str, cause: &GltfFault) -> String {
    let object = if pointer.is_empty() { "the file".to_owned() } else { printable(pointer, MAX_MESSAGE / 2) };
    format!("{object}: {}", printable(&cause.to_string(), MAX_MESSAGE))
}

fn wrong_core_advice(expected: CoreKind) -> &'static str {
    if expected == CoreKind::Transform { ": put a transform node above it" } else { "" }
}

/// An edit that the root node does not allow; see [`Error::Root`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum RootEdit {
    /// Removing it.
    Remove,
    /// Giving it a parent or a sibling.
    Move,
    /// Giving it a core of this kind.
    SetCore(CoreKind),
}

impl fmt::Display for RootEdit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Remove => f.write_str("removed"),
            Self::Move => f.write_str("moved"),
            Self::SetCore(kind) => write!(f, "given a core other than a group ({kind})"),
        }
    }
}

/// A step through the undo history; see [`Error::Transaction`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HistoryStep {
    /// [`Scene::undo`](crate::Scene::undo).
    Undo,
    /// [`Scene::redo`](crate::Scene::redo).
    Redo,
}

impl fmt::Display for HistoryStep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Undo => "undo",
            Self::Redo => "redo",
        })
    }
}

/// Why the target state of an object does not fit a scene; see [`Error::Delta`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum DeltaFault {
    /// The objects of the delta are not in ascending order, or one occurs twice.
    DuplicateObject,
    /// Two objects of the delta have keys of the same slot.
    SharedSlot,
    /// An object that stays in the scene has a key of the same slot.
    SlotTaken,
    /// No scene issues such a key.
    InvalidKey,
    /// The state is not that of an object of the key's kind.
    KindMismatch,
    /// A node other than the root has no parent.
    NoParent,
    /// The previous sibling has another parent.
    SiblingElsewhere,
    /// Two nodes have the same previous sibling.
    SiblingTwice,
    /// A node is among its own previous siblings.
    SiblingCycle,
    /// A removed object is still referenced.
    StillUsed,
    /// A child of a removed node is not removed.
    ChildStays,
}

impl fmt::Display for DeltaFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::DuplicateObject => "it occurs twice, or out of order",
            Self::SharedSlot => "another object of the delta has a key of the same slot",
            Self::SlotTaken => "another object of the scene has a key of the same slot",
            Self::InvalidKey => "no scene issues this key",
            Self::KindMismatch => "its state is that of another kind of object",
            Self::NoParent => "it would have no parent, as only the root has",
            Self::SiblingElsewhere => "its previous sibling would have another parent",
            Self::SiblingTwice => "another node would have the same previous sibling",
            Self::SiblingCycle => "it would come after itself among its siblings",
            Self::StillUsed => "it would be removed, but something still uses it",
            Self::ChildStays => "its parent would be removed, but not it",
        })
    }
}

/// A resource with a limit; see [`Error::Limit`]. `Display` gives its name. Each variant names the file that checks it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Resource {
    /// Entries of the flattened hierarchy. Checked in `graph/hierarchy/entries.rs`.
    HierarchyEntries,
    /// Key slots, which a delta of some objects may skip. Checked in `graph/transfer/check.rs`.
    KeySlots,
    /// Elements of a device array of this name. Checked in `compile/buffer_allocator.rs`.
    DeviceArray(&'static str),
    /// Instances in the TLAS. Checked in `compile/instance_table.rs`.
    Instances,
    /// Pixels of an image. Checked in `trace/frame_buffer.rs`.
    ImagePixels,
    /// Columns of an image that a GPU renders. Checked in `trace/gpu/frame.rs`.
    ImageWidth,
    /// Rows of an image that a GPU renders. Checked in `trace/gpu/frame.rs`.
    ImageHeight,
    /// Bytes of the device array of this name in bindings of a GPU. Checked in `trace/gpu/scene.rs`.
    GpuArray(&'static str),
    /// Bytes of a batch's rays in a binding of a GPU. Checked in `trace/gpu/batch.rs`, as the next three.
    RayBinding,
    /// Bytes of a batch's results in a binding of a GPU.
    ResultBinding,
    /// Bytes of the application's buffer of rays.
    RayBuffer,
    /// Bytes of the application's buffer of results.
    ResultBuffer,
    /// Storage buffers of a shader stage of the kernel. Checked in `trace/gpu/adapter.rs`, as all that follow.
    StorageBuffers,
    /// Storage textures of a shader stage of the kernel.
    StorageTextures,
    /// Uniform buffers of a shader stage of the kernel.
    UniformBuffers,
    /// Bind groups of the kernel.
    BindGroups,
    /// Uniform buffers with a dynamic offset of the kernel.
    DynamicUniformBuffers,
    /// Invocations of a workgroup of the kernel.
    WorkgroupInvocations,
    /// Invocations along x of a workgroup of the kernel.
    WorkgroupWidth,
    /// Invocations along y of a workgroup of the kernel.
    WorkgroupHeight,
    /// Workgroups of a dispatch of the kernel, along one dimension.
    Workgroups,
}

impl Resource {
    /// Unit of the amounts of [`Error::Limit`], in the plural: "bytes".
    pub fn unit(&self) -> &'static str {
        self.row().1
    }

    /// What helps when the limit is reached; `None` where nothing is known to.
    pub fn advice(&self) -> Option<&'static str> {
        Some(self.row().2).filter(|advice| !advice.is_empty())
    }

    /// Name, unit and advice.
    fn row(&self) -> (&'static str, &'static str, &'static str) {
        const RESEND: &str =
            "the delta is damaged, or so many objects came and went since the last one that a snapshot is needed";
        const SHRINK: &str = "share geometry between nodes, use smaller textures, or use the cpu executor";
        const SPLIT_IMAGE: &str = "render it in parts, or use the cpu executor";
        const SPLIT_BATCH: &str = "trace fewer rays at a time";
        const REQUEST: &str = "request the device with ropewalk's required_limits(), or use another adapter";
        match *self {
            Self::HierarchyEntries => {
                ("the scene with all instances of its nodes", "entries", "instances of instances multiply")
            }
            Self::KeySlots => ("a key of a delta", "slots", RESEND),
            Self::DeviceArray(name) => (name, "elements", ""),
            Self::Instances => ("the instances array", "elements", ""),
            Self::ImagePixels => ("the image", "pixels", "render the image in parts"),
            Self::ImageWidth => ("the image's width", "pixels", SPLIT_IMAGE),
            Self::ImageHeight => ("the image's height", "pixels", SPLIT_IMAGE),
            Self::GpuArray(name) => (name, "bytes", SHRINK),
            Self::RayBinding => ("the buffer of rays", "bytes", SPLIT_BATCH),
            Self::ResultBinding => ("the buffer of results", "bytes", SPLIT_BATCH),
            Self::RayBuffer => ("the buffer of rays", "bytes", "the buffer is too small for its count of rays"),
            Self::ResultBuffer => ("the buffer of results", "bytes", "the buffer is too small for its count of rays"),
            Self::StorageBuffers => ("the kernel", "storage buffers a shader stage", REQUEST),
            Self::StorageTextures => ("the kernel", "storage textures a shader stage", REQUEST),
            Self::UniformBuffers => ("the kernel", "uniform buffers a shader stage", REQUEST),
            Self::BindGroups => ("the kernel", "bind groups", REQUEST),
            Self::DynamicUniformBuffers => ("the kernel", "dynamic uniform buffers", REQUEST),
            Self::WorkgroupInvocations => ("the kernel", "invocations a workgroup", REQUEST),
            Self::WorkgroupWidth => ("the kernel", "invocations a workgroup along x", REQUEST),
            Self::WorkgroupHeight => ("the kernel", "invocations a workgroup along y", REQUEST),
            Self::Workgroups => ("the kernel", "workgroups a dispatch", REQUEST),
        }
    }
}

impl fmt::Display for Resource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.row().0)
    }
}

/// Appends advice to a message.
struct Advice(Option<&'static str>);

impl fmt::Display for Advice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.map_or(Ok(()), |advice| write!(f, "; {advice}"))
    }
}

/// An error of the operating system: a copy of [`std::io::Error`] that can be cloned and compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IoFault {
    kind: io::ErrorKind,
    message: String,
}

impl IoFault {
    /// The category of the error.
    pub fn kind(&self) -> io::ErrorKind {
        self.kind
    }
}

impl From<io::Error> for IoFault {
    fn from(error: io::Error) -> Self {
        Self { kind: error.kind(), message: error.to_string() }
    }
}

impl fmt::Display for IoFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for IoFault {}

/// Fails with [`Error::OutOfRange`] unless the condition holds.
pub(crate) fn require(holds: bool, what: &'static str, value: &dyn Debug, expected: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::OutOfRange { what, value: format!("{value:?}"), expected }) }
}

/// Fails with [`Error::Limit`] if more of a resource is needed than there is.
pub(crate) fn require_within(resource: Resource, needed: u64, limit: u64) -> Result<()> {
    if needed <= limit { Ok(()) } else { Err(Error::limit(resource, needed, limit)) }
}

/// Fails with [`Error::Defect`] unless an invariant of an object holds.
pub(crate) fn require_invariant(holds: bool, object: impl Into<ObjectKey>, what: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::Defect { object: object.into(), what }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_is_told_with_its_unit_and_advice() {
        assert_eq!(require_within(Resource::ImagePixels, 4, 4), Ok(()));
        let error = require_within(Resource::ImagePixels, 5, 4).unwrap_err();
        assert_eq!(error.to_string(), "the image needs 5 pixels, more than the limit of 4; render the image in parts");
        let error = require_within(Resource::DeviceArray("the triangles array"), 9, 8).unwrap_err();
        assert_eq!(error.to_string(), "the triangles array needs 9 elements, more than the limit of 8");
    }

    #[test]
    fn errors_can_be_compared_and_cloned() {
        let missing = || Error::io(Path::new("a"), io::ErrorKind::NotFound.into());
        assert_eq!(missing(), missing().clone());
        assert_ne!(missing(), Error::io(Path::new("b"), io::ErrorKind::NotFound.into()));
        let Error::Io { source, .. } = missing() else { unreachable!() };
        assert_eq!(source.kind(), io::ErrorKind::NotFound);
    }

    /// A second one would word the same limit differently.
    #[test]
    fn errors_of_limits_are_made_in_one_place() {
        let literal = ["::Limit", " { resource"].concat();
        let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
        let mut found = Vec::new();
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let count = std::fs::read_to_string(&path).unwrap().matches(&literal).count();
                    found.extend(std::iter::repeat_n(path, count));
                }
            }
        }
        assert!(found.len() == 1 && found[0].ends_with("error.rs"), "{found:?}");
    }
}
