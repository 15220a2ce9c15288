//! glTF import, from outside: hand-made files against hand-computed values, the real scenes against their index and
//! against the reader of the crate `gltf`, malformed files against the glTF validator's verdicts, and mutated files
//! against any panic.

#![expect(clippy::unwrap_used, clippy::panic, reason = "a panic in a test is a failure")]
#![expect(clippy::needless_pass_by_value, reason = "json! makes values to be given away")]

mod cancel;
mod files;
mod fixture;
mod forgiving;
mod geometry;
mod hostile;
mod invalid;
mod materials;
mod mutations;
mod nodes;
mod pose;
mod reader;
mod scenes;
