//! The acceleration structures: every hierarchy is valid and of good quality, and rays hit in it what brute force hits.

#![allow(clippy::panic, clippy::unwrap_used, reason = "a test fails by panicking")]

mod agreement;
mod coincident;
mod degenerate;
mod hits;
mod meshes;
mod quality;
mod refit;
mod structure;
mod tlas;
mod tlas_updates;
mod world_boxes;
