//! The one error type: what failed, which object, and the likely cause.

use std::path::PathBuf;

use crate::gltf::GltfFault;
use crate::graph::{ObjectKey, SceneFileError};

/// Everything that can go wrong, with the key, path, index or limit and the likely cause.
///
/// A call that returns an error has left the scene and the file system as they were.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A key names nothing in this scene.
    #[error("{object} is not in this scene: it was removed, or its key comes from another scene")]
    StaleKey {
        /// The key that was passed in.
        object: ObjectKey,
    },
    /// A node was to become its own ancestor.
    #[error("{node} cannot become a child of {parent}, which is below it (or is it): that would close a cycle")]
    Cycle {
        /// The node that was to move.
        node: ObjectKey,
        /// The parent it was to get.
        parent: ObjectKey,
    },
    /// The root node was to be removed, moved or given a core other than a group.
    #[error("the root node cannot be {attempt}: it lives as long as its scene")]
    Root {
        /// What was attempted, as a participle: "removed".
        attempt: &'static str,
    },
    /// A node's core is of another kind than the call needs.
    #[error("{node} has a {found} core where a {expected} core is needed{}", wrong_core_hint(expected))]
    WrongCore {
        /// The node.
        node: ObjectKey,
        /// The kind of core that the call needs.
        expected: &'static str,
        /// The kind of core that the node has.
        found: &'static str,
    },
    /// A node's world transform has no inverse, so nothing can keep its place below it.
    #[error(
        "the world transform of {node} cannot be inverted: some scale at it or above it is 0, or too small or large"
    )]
    Singular {
        /// The node.
        node: ObjectKey,
    },
    /// A scene contradicts itself: a defect of Ropewalk, which only `Scene::validate` looks for.
    #[error("internal defect: {object}: {what}")]
    Defect {
        /// The object that is wrong.
        object: ObjectKey,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A value that must be a number within a range is not.
    #[error("{what} is {value}, but must be {expected}")]
    OutOfRange {
        /// What the value is: "material roughness".
        what: &'static str,
        /// The value, as given.
        value: String,
        /// What is allowed: "finite", "between 0 and 1".
        expected: &'static str,
    },
    /// A geometry's arrays contradict each other.
    #[error("geometry {what}[{index}] is {value}, but {expected}")]
    InvalidGeometry {
        /// The array: "positions", "indices", "normals".
        what: &'static str,
        /// The first offending element (or the array's length, where the length is wrong).
        index: usize,
        /// The offending value.
        value: String,
        /// What is allowed, and the limit.
        expected: String,
    },
    /// A delta does not fit the scene that it was applied to.
    #[error("{object}: {what}: the delta is damaged, or was made for another state of the scene")]
    Delta {
        /// The first object whose state does not fit.
        object: ObjectKey,
        /// What does not fit.
        what: &'static str,
    },
    /// Undo or redo was called by the edits of a transaction.
    #[error("cannot {attempt} within a transaction: let it end first")]
    Transaction {
        /// What was attempted: "undo".
        attempt: &'static str,
    },
    /// The queue that a batch of edits was sent to is gone, and the batch with it.
    #[error("the edits were not applied: their queue was dropped")]
    QueueClosed,
    /// A scene file or a recording is damaged, or not one.
    #[error("{path}: frame {frame}: {source}")]
    SceneFile {
        /// The file.
        path: PathBuf,
        /// Which frame: 0 for a saved scene, and for the start of a recording.
        frame: usize,
        /// What is wrong with it.
        #[source]
        source: SceneFileError,
    },
    /// A file could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A glTF file breaks the specification, or is damaged.
    #[error("{path}: {}: {cause}", if pointer.is_empty() { "the file" } else { pointer })]
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
    #[error("{path}: requires the extension {extension}, which is not supported")]
    UnsupportedExtension {
        /// The file.
        path: PathBuf,
        /// The extension's name.
        extension: String,
    },
    /// There is no usable GPU.
    #[error("no usable GPU: {reason}")]
    NoGpu {
        /// Each adapter that was looked at, and why it was not taken.
        reason: String,
    },
    /// The scene or image needs more of a resource than there is.
    #[error("{what} needs {needed}, more than the limit of {limit}{hint}")]
    Limit {
        /// The resource: "the triangles buffer (bytes)".
        what: &'static str,
        /// How much the scene needs.
        needed: u64,
        /// How much there is.
        limit: u64,
        /// What would help, starting with "; ", or nothing.
        hint: &'static str,
    },
    /// The GPU driver reported a failure.
    #[error("the GPU failed during {during}: {message}")]
    Gpu {
        /// What was being done: "frame readback".
        during: &'static str,
        /// What the driver said.
        message: String,
    },
    /// The GPU's driver gave the device up: it was unplugged, restarted, updated, or ran too long. Nothing on it is left.
    #[error("the device was lost during {during}: {message}")]
    DeviceLost {
        /// What was being done, or was to be.
        during: &'static str,
        /// What the driver said.
        message: String,
    },
    /// The GPU has no memory left: the scene or the image is too large for it, or others use it.
    #[error("out of GPU memory during {during}: {message}; render a smaller image or scene, or on the CPU")]
    OutOfMemory {
        /// What was being done: "the upload of the scene".
        during: &'static str,
        /// What the driver said.
        message: String,
    },
    /// A file name does not say which image format to write.
    #[error("{path}: the ending of the name is not that of an image format Ropewalk writes (.png or .exr)")]
    ImageFormat {
        /// The file.
        path: PathBuf,
    },
    /// An image could not be encoded.
    #[error("{path}: {source}")]
    Image {
        /// The file.
        path: PathBuf,
        /// What the encoder said.
        source: image::ImageError,
    },
}

fn wrong_core_hint(expected: &str) -> &'static str {
    if expected == "transform" { ": put a transform node above it" } else { "" }
}

/// [`std::result::Result`] with this crate's [`enum@Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;
