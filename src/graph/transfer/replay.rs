//! Recordings: a session as a file, with a snapshot of the scene at its start and the changes of each frame.

use std::fs::File;
use std::io::{BufReader, BufWriter, Write as _};
use std::path::{Path, PathBuf};

use super::Delta;
use super::file::{SceneFileError, read_frame, read_header, write_frame, write_header};
use crate::graph::{ChangeCursor, Scene};
use crate::{Error, Result};

/// Records a session to a file, frame by frame; for example to attach to a bug report.
///
/// ```
/// use ropewalk::graph::{Recorder, Replay};
/// use ropewalk::{Core, Scene};
///
/// let folder = tempfile::tempdir().expect("a temporary folder");
/// let path = folder.path().join("session.ropewalk");
///
/// let mut scene = Scene::new();
/// let mut recorder = Recorder::new(&path, &mut scene)?;
/// for name in ["one", "two"] {
///     let node = scene.add(scene.root(), Core::Group)?;
///     scene.set_name(node, name)?;
///     recorder.record(&mut scene)?;
/// }
///
/// let (mut replay, mut replayed) = (Replay::open(&path)?, Scene::new());
/// let mut node_counts = Vec::new();
/// while replay.apply_next(&mut replayed)? {
///     node_counts.push(replayed.node_count());
/// }
/// assert_eq!(node_counts, [1, 2, 3]);
/// assert_eq!(replayed.snapshot(), scene.snapshot());
/// # Ok::<(), ropewalk::Error>(())
/// ```
#[derive(Debug)]
pub struct Recorder {
    path: PathBuf,
    file: BufWriter<File>,
    cursor: ChangeCursor,
}

impl Recorder {
    /// Begins a recording with the scene as it is. A file of that name is replaced.
    ///
    /// # Errors
    /// [`Error::Io`]: most often the folder does not exist or may not be written to.
    pub fn new(path: impl AsRef<Path>, scene: &mut Scene) -> Result<Self> {
        let path = path.as_ref().to_owned();
        // Create the file with its header.
        let started = File::create(&path).and_then(|file| {
            let mut file = BufWriter::new(file);
            write_header(&mut file).map(|()| file)
        });
        let file = started.map_err(|error| Error::io(&path, error))?;
        // The first read of a new cursor is a snapshot: frame 0.
        let mut recorder = Self { path, file, cursor: ChangeCursor::default() };
        recorder.record(scene)?;
        Ok(recorder)
    }

    /// Appends a frame with the changes since the last one (possibly none) and flushes it to the operating system, so
    /// that it survives a crash of this process. O(changes).
    ///
    /// # Errors
    /// [`Error::Io`]: most often the disk is full. The file is then complete up to the frame before; begin another.
    pub fn record(&mut self, scene: &mut Scene) -> Result<()> {
        let delta = scene.delta_since(&mut self.cursor);
        let written = write_frame(&mut self.file, &delta).and_then(|()| self.file.flush());
        written.map_err(|error| Error::io(&self.path, error))
    }
}

/// Reads a recording, frame by frame, or a saved scene, which is a recording with one frame.
#[derive(Debug)]
pub struct Replay {
    path: PathBuf,
    file: BufReader<File>,
    frame: usize,
}

impl Replay {
    /// Opens a recording.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read; [`Error::SceneFile`] if it is not a recording, or one of another format
    /// version.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref().to_owned();
        let file = File::open(&path).map_err(|error| Error::io(&path, error))?;
        let mut file = BufReader::new(file);
        read_header(&mut file).map_err(|error| error.at(&path, 0))?;
        Ok(Self { path, file, frame: 0 })
    }

    /// Number of frames read so far.
    pub fn frame(&self) -> usize {
        self.frame
    }

    /// The next frame; `None` at the end.
    ///
    /// # Errors
    /// [`Error::SceneFile`] if the file is damaged, or ends within the frame; the frames before are intact.
    pub fn next_delta(&mut self) -> Result<Option<Delta>> {
        let delta = read_frame(&mut self.file).map_err(|error| error.at(&self.path, self.frame))?;
        self.frame += usize::from(delta.is_some());
        Ok(delta)
    }

    /// Applies the next frame. Returns false at the end. Frame 0 is a snapshot and fits any scene; each later frame
    /// requires the state of the frame before.
    ///
    /// # Errors
    /// As [`next_delta`](Self::next_delta); [`Error::SceneFile`] also for a frame that does not fit the scene, which is
    /// then unchanged.
    pub fn apply_next(&mut self, scene: &mut Scene) -> Result<bool> {
        let Some(delta) = self.next_delta()? else { return Ok(false) };
        scene.apply(&delta).map_err(|error| Error::SceneFile {
            path: self.path.clone(),
            frame: self.frame - 1,
            source: SceneFileError::Mismatch(Box::new(error)),
        })?;
        Ok(true)
    }
}
