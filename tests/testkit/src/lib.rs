//! What Ropewalk's tests share. It is a package of its own, so that it is compiled once for all test binaries.
//!
//! - [`Random`]: the random numbers of all tests, from a seed, the same on every machine.
//! - [`Mesh`], [`Placed`], [`arrays`]: meshes made in code, and device arrays of them that are made without the
//!   compiler.
//! - [`tracers`]: every executor with every traversal; `gpu`: the GPU, if there is one.
//! - [`oracle`]: the closest hit by brute force in f64.
//! - [`canonical`]: compiled arrays in a form that can be compared; [`world`]: a scene under random edits.
//! - [`corpus`]: where the sample scenes are.
//! - [`mod@flip`]: how different two images look to a person.
//!
//! A function that cannot do its work panics: that is how a test fails. In-crate unit tests of `ropewalk` cannot use
//! this package, since it would bring a second copy of the crate, whose types are not theirs.

mod arrays;
pub mod canonical;
pub mod corpus;
pub mod flip;
#[cfg(feature = "gpu")]
pub mod gpu;
mod mesh;
pub mod oracle;
mod random;
mod tracers;
pub mod world;

pub use arrays::{Builder, Placed, arrays, arrays_by, gray};
pub use mesh::Mesh;
pub use random::Random;
pub use tracers::tracers;
