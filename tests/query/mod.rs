//! Queries against brute force in f64 over all triangles of random scenes, and what they cost.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![allow(unreachable_pub, reason = "support modules serve several tests")]

mod batch;
mod cost;
mod errors;
mod far_apart;
mod inside;
mod nearest;
mod oracle;
mod pick;
mod placed;
mod rays;
mod regions;
mod ridges;
mod scenes;
