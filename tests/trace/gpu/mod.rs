//! The GPU executor, on any adapter.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod agreement;
mod device;
mod failures;
mod frame;
mod layers;
mod occlusion;
mod resident;
mod scene;
mod soup;
mod upload;
