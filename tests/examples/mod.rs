//! The examples.

mod render;
