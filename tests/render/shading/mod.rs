//! Shading: rendered scenes compared with closed forms.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![allow(unreachable_pub, reason = "support modules serve several tests")]

mod devices;
mod furnace;
mod layers;
mod lights;
mod paths;
mod scenes;
mod textures;
mod unlit;
