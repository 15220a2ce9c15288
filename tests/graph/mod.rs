//! The scene graph: edits, reads, and state that goes from one scene to another.

mod edits;
mod random_edits;
mod reads;
mod scale;
mod transfer;
