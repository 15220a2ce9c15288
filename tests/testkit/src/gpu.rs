//! The GPU for tests: any adapter will do, a software one too. Where there is none a test is skipped and says so; under
//! `ROPEWALK_REQUIRE_GPU` (set by `scripts/test.sh`) it fails.

use ropewalk::Result;
use ropewalk::trace::gpu::{AdapterKinds, GpuOptions, GpuTracer};

/// A tracer, or `None` where the test is to be skipped.
pub fn tracer() -> Option<GpuTracer> {
    usable(GpuTracer::new(&GpuOptions::default().with_adapters(AdapterKinds::IncludingSoftware)))
}

/// What the GPU gave, or `None` where the test is to be skipped for want of one.
pub fn usable<T>(outcome: Result<T>) -> Option<T> {
    match outcome {
        Ok(value) => Some(value),
        Err(error) if std::env::var_os("ROPEWALK_REQUIRE_GPU").is_some() => panic!("{error}"),
        Err(error) => {
            eprintln!("skipped: {error}");
            None
        }
    }
}
