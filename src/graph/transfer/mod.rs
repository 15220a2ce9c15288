//! Moving a scene's state: between scenes, threads, points in time, and files.
//!
//! One mechanism serves all: a [`Delta`] says what some objects are to be, and [`Scene::apply`](super::Scene::apply)
//! makes them so, all or none. A mirror applies what another scene's change log names; undo applies what objects were
//! before; a file is the delta that makes all of them.

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
