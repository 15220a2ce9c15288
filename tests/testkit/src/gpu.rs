//! The GPU for tests, on any adapter, a software renderer included. Without an adapter, tests are skipped with a
//! message; if the variable `ROPEWALK_REQUIRE_GPU` is set, as by `scripts/test.sh`, they fail.

use ropewalk::Result;
use ropewalk::trace::gpu::{AdapterKinds, GpuOptions, GpuTracer};

/// A tracer, or `None` where the test is to be skipped.
pub fn tracer() -> Option<GpuTracer> {
    usable(GpuTracer::new(&GpuOptions::default().with_adapters(AdapterKinds::IncludingSoftware)))
}

/// The value of a GPU call, or `None` where the test is to be skipped because there is no GPU.
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
