//! The GPU executor on whatever adapter there is, a software one too. Where there is none these tests are skipped and
//! say so; under `ROPEWALK_REQUIRE_GPU=1` (set by `scripts/test.sh`) they fail.
#![cfg(feature = "gpu")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod agreement;
mod device;
mod frame;
mod soup;
mod upload;

use ropewalk::Result;
use ropewalk::trace::gpu::{Adapters, GpuOptions, GpuTracer};

/// Any adapter will do.
fn any_adapter() -> GpuOptions {
    GpuOptions { adapters: Adapters::Any, ..Default::default() }
}

/// A tracer, or `None` where the test is to be skipped.
fn tracer() -> Option<GpuTracer> {
    usable(GpuTracer::new(&any_adapter()))
}

/// What the GPU gave, or `None` where the test is to be skipped for want of one.
fn usable<T>(outcome: Result<T>) -> Option<T> {
    match outcome {
        Ok(value) => Some(value),
        Err(error) if std::env::var_os("ROPEWALK_REQUIRE_GPU").is_some() => panic!("{error}"),
        Err(error) => {
            eprintln!("skipped: {error}");
            None
        }
    }
}
