//! Scene files: a header and one or more frames; each frame is a delta with length and CRC-32. `docs/FILE_FORMAT.md`
//! has the layout.

use std::io::{self, Read, Write};
use std::path::Path;

use super::{Delta, Replay};
use crate::atomic_file::write_atomically;
use crate::graph::Scene;
use crate::{Error, Result};

/// The first bytes of a scene file or recording.
const MAGIC: [u8; 8] = *b"ROPEWALK";

/// The version of the format: the only one that is read.
const VERSION: u32 = 3;

/// What is wrong with a scene file or recording.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SceneFileError {
    /// It does not begin with the header of such a file.
    #[error("this is not a Ropewalk scene or recording")]
    NotAScene,
    /// A later version of Ropewalk wrote it.
    #[error("format version {found} is newer than {supported}, the newest that this version of Ropewalk reads")]
    Newer {
        /// The version of its format.
        found: u32,
        /// The newest that can be read.
        supported: u32,
    },
    /// A version of Ropewalk wrote it whose format is no longer read.
    #[error("format version {found} is older than {supported}, the oldest that this version of Ropewalk reads")]
    Older {
        /// The version of its format.
        found: u32,
        /// The oldest that can be read.
        supported: u32,
    },
    /// It ends within a frame: an incomplete copy, or the writing program was terminated.
    #[error("the file ends within the frame")]
    Truncated,
    /// Its content was changed after it was written.
    #[error("its checksum is {found:08x}, not {expected:08x}: the file is damaged")]
    Checksum {
        /// The checksum in the file.
        expected: u32,
        /// The checksum of its content.
        found: u32,
    },
    /// It is not the serialised form of a delta.
    #[error("it cannot be decoded: {cause}")]
    Encoding {
        /// The decoder's message.
        cause: String,
    },
    /// The delta was decoded but cannot be applied to the scene.
    #[error("{0}")]
    Mismatch(Box<Error>),
}

/// Files.
impl Scene {
    /// Writes the whole scene to a file. [`load`](Self::load) restores it, its keys included; saved again it is the
    /// same file, byte for byte. O(scene).
    ///
    /// The content is that of [`snapshot`](Self::snapshot). Undo history and cursors are not saved. Arrays shared by
    /// several geometries are written once per geometry.
    ///
    /// The write is atomic: a temporary file in the same folder is written and then renamed.
    ///
    /// ```
    /// use ropewalk::{Core, Scene};
    ///
    /// let mut scene = Scene::new();
    /// let node = scene.add(scene.root(), Core::Group)?;
    /// scene.set_name(node, "arm")?;
    /// let folder = tempfile::tempdir().expect("a temporary folder");
    /// let path = folder.path().join("arm.ropewalk");
    /// scene.save(&path)?;
    ///
    /// let loaded = Scene::load(&path)?;
    /// assert_eq!(loaded.name(node)?, "arm");
    /// assert_eq!(loaded.snapshot(), scene.snapshot());
    /// # Ok::<(), ropewalk::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Io`]: most often the folder does not exist or may not be written to. An older file of that name is then
    /// unchanged.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        let mut bytes = Vec::new();
        let written = write_header(&mut bytes).and_then(|()| write_frame(&mut bytes, &self.snapshot()));
        written.and_then(|()| write_atomically(path, &bytes)).map_err(|error| Error::io(path, error))
    }

    /// Reads a scene that was [saved](Self::save), or the last state in a [recording](super::Recorder). Keys of the
    /// saved scene are valid for the loaded one, and stale keys remain stale. O(scene); memory in proportion to the
    /// file's size, whatever its content.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read; [`Error::SceneFile`] if it is not such a file, is damaged, or is of
    /// another format version. The content is validated like any edit.
    pub fn load(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut replay = Replay::open(path)?;
        // Apply the snapshot in frame 0, then the changes of a recording; the last state remains.
        let mut scene = Self::new();
        if !replay.apply_next(&mut scene)? {
            return Err(Error::SceneFile { path: path.to_owned(), frame: 0, source: SceneFileError::Truncated });
        }
        while replay.apply_next(&mut scene)? {}
        Ok(scene)
    }
}

/// Why a part of a file could not be read.
#[derive(Debug)]
pub(super) enum ReadError {
    Io(io::Error),
    File(SceneFileError),
}

impl ReadError {
    pub(super) fn at(self, path: &Path, frame: usize) -> Error {
        match self {
            Self::Io(error) => Error::io(path, error),
            Self::File(source) => Error::SceneFile { path: path.to_owned(), frame, source },
        }
    }
}

impl From<SceneFileError> for ReadError {
    fn from(error: SceneFileError) -> Self {
        Self::File(error)
    }
}

pub(super) fn write_header(file: &mut impl Write) -> io::Result<()> {
    file.write_all(&MAGIC)?;
    file.write_all(&VERSION.to_le_bytes())
}

pub(super) fn read_header(file: &mut impl Read) -> Result<(), ReadError> {
    let header: [u8; 12] = read_array(file)?.ok_or(SceneFileError::NotAScene)?;
    let (magic, version) = header.split_at(MAGIC.len());
    if magic != MAGIC {
        return Err(SceneFileError::NotAScene.into());
    }
    match u32_at(version, 0) {
        found if found > VERSION => Err(SceneFileError::Newer { found, supported: VERSION }.into()),
        found if found < VERSION => Err(SceneFileError::Older { found, supported: VERSION }.into()),
        _ => Ok(()),
    }
}

pub(super) fn write_frame(file: &mut impl Write, delta: &Delta) -> io::Result<()> {
    let body = postcard::to_stdvec(delta).map_err(io::Error::other)?;
    file.write_all(&(body.len() as u64).to_le_bytes())?;
    file.write_all(&crc32fast::hash(&body).to_le_bytes())?;
    file.write_all(&body)
}

/// The next frame; `None` at the end of the file.
pub(super) fn read_frame(file: &mut impl Read) -> Result<Option<Delta>, ReadError> {
    // Read the head: the length of the body, and its checksum.
    let Some(head) = read_array::<12>(file)? else { return Ok(None) };
    let length = u64::from(u32_at(&head, 0)) | u64::from(u32_at(&head, 4)) << 32;
    let expected = u32_at(&head, 8);

    // Allocates only as much as the file contains, even if the length field is corrupt.
    let mut body = Vec::new();
    file.take(length).read_to_end(&mut body).map_err(ReadError::Io)?;
    if (body.len() as u64) < length {
        return Err(SceneFileError::Truncated.into());
    }
    // Check the body before it is decoded.
    let found = crc32fast::hash(&body);
    if found != expected {
        return Err(SceneFileError::Checksum { expected, found }.into());
    }
    // Decode it; bytes left over mean that it is not what was written.
    match postcard::take_from_bytes(&body) {
        Ok((delta, [])) => Ok(Some(delta)),
        Ok((_, rest)) => Err(SceneFileError::Encoding { cause: format!("{} bytes are left over", rest.len()) }.into()),
        Err(error) => Err(SceneFileError::Encoding { cause: error.to_string() }.into()),
    }
}

/// The next `N` bytes; `None` at the end of the file.
fn read_array<const N: usize>(file: &mut impl Read) -> Result<Option<[u8; N]>, ReadError> {
    let mut bytes = Vec::with_capacity(N);
    file.take(N as u64).read_to_end(&mut bytes).map_err(ReadError::Io)?;
    match <[u8; N]>::try_from(bytes) {
        Ok(array) => Ok(Some(array)),
        Err(bytes) if bytes.is_empty() => Ok(None),
        Err(_) => Err(SceneFileError::Truncated.into()),
    }
}

fn u32_at(bytes: &[u8], start: usize) -> u32 {
    bytes[start..].iter().take(4).rev().fold(0, |number, &byte| number << 8 | u32::from(byte))
}
