//! The compiler: from scenes and their changes to device arrays.

mod cancel;
mod coincident;
mod compiler;
mod cores;
mod deformation;
mod sheared;
mod walls;
