//! The GPU executor on whatever adapter there is.
#![cfg(feature = "gpu")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![allow(unreachable_pub, reason = "support modules serve several tests")]

mod agreement;
mod device;
mod failures;
mod frame;
mod layers;
mod occlusion;
mod resident;
mod scene;
mod soup;
#[path = "../support/gpu.rs"]
mod support;
mod upload;
