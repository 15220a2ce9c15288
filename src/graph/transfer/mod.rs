//! Moving a scene's state: between scenes, threads, points in time, and files.
//!
//! All of it is built on [`Delta`]: target states of some or all objects, applied atomically by
//! [`Scene::apply`](super::Scene::apply). A replica applies deltas made from another scene's change log; undo applies
//! the states that objects had before; a scene file is a delta of the whole scene.

mod check;
mod delta;
mod file;
mod journal;
mod queue;
mod replay;
mod state;
mod undo;
mod write;

pub use delta::Delta;
pub use file::SceneFileError;
pub(super) use journal::Journal;
pub use queue::{EditQueue, EditSender, PendingEdit};
pub use replay::{Recorder, Replay};
pub use state::{NodeState, ObjectState};
