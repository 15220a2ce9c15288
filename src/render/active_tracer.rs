//! What a renderer traces with, and what becomes of it when it fails.

use std::cell::Cell;

use serde::Serialize;

#[cfg(feature = "gpu")]
use crate::trace::gpu::{AdapterKinds, GpuOptions, GpuTracer};
use crate::trace::{Cpu, Emulated, Tracer};
use crate::{Error, Result};

/// What traces the rays, and what is done when that fails with [`Error::DeviceLost`] or [`Error::OutOfMemory`]: the call
/// during which it fails returns the error, the next one goes on as said here.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DeviceChoice {
    /// A hardware GPU if there is one, else the CPU. After a loss, a hardware GPU again if there still is one, else the CPU;
    /// when its memory is used up, the CPU.
    #[default]
    Auto,
    /// A GPU, or a software implementation of one; an error if there is neither. After a loss, whichever is there then; when
    /// its memory is used up, it is tried again.
    Gpu,
    /// All CPU cores.
    Cpu,
    /// The GPU kernel line for line on one CPU thread: the paper's "Emulated".
    Emulated,
}

/// The executor of a renderer.
pub(super) struct ActiveTracer {
    /// Who chose the executor; `None` for the application, which then also answers for its failures.
    choice: Option<DeviceChoice>,
    tracer: Box<dyn Tracer>,
    fallback: Option<String>,
    /// What the next call must see to first.
    failure: Cell<Option<Failure>>,
}

/// What a device did not survive.
#[derive(Clone, Copy)]
enum Failure {
    DeviceLost,
    OutOfMemory,
}

impl ActiveTracer {
    pub(super) fn open(choice: DeviceChoice) -> Result<Self> {
        let (tracer, fallback): (Box<dyn Tracer>, _) = match choice {
            DeviceChoice::Cpu => (Box::new(Cpu::default()), None),
            DeviceChoice::Emulated => (Box::new(Emulated::default()), None),
            DeviceChoice::Gpu => (open_gpu(choice)?, None),
            DeviceChoice::Auto => match open_gpu(choice) {
                Ok(gpu) => (gpu, None),
                Err(reason) => (Box::new(Cpu::default()), Some(reason.to_string())),
            },
        };
        Ok(Self { choice: Some(choice), fallback, ..Self::from_tracer(tracer) })
    }

    pub(super) fn from_tracer(tracer: Box<dyn Tracer>) -> Self {
        Self { choice: None, tracer, fallback: None, failure: Cell::new(None) }
    }

    /// Why the CPU traces where a GPU was wanted.
    pub(super) fn fallback(&self) -> Option<&str> {
        self.fallback.as_deref()
    }

    pub(super) fn tracer(&self) -> &dyn Tracer {
        &*self.tracer
    }

    pub(super) fn tracer_mut(&mut self) -> &mut dyn Tracer {
        &mut *self.tracer
    }

    /// Passes a result of the tracer on; of a failure that it does not survive, a note stays.
    pub(super) fn record_failure<T>(&self, result: Result<T>) -> Result<T> {
        match &result {
            Err(Error::DeviceLost { .. }) => self.failure.set(Some(Failure::DeviceLost)),
            Err(Error::OutOfMemory { .. }) => self.failure.set(Some(Failure::OutOfMemory)),
            _ => {}
        }
        result
    }

    /// Recovers from the failure of an earlier call, if there was one. The new tracer holds nothing yet.
    pub(super) fn recover(&mut self) -> Result<()> {
        match (self.choice, self.failure.get()) {
            (Some(choice), Some(Failure::DeviceLost)) => *self = Self::open(choice)?,
            (Some(DeviceChoice::Auto), Some(Failure::OutOfMemory)) => {
                let fallback = Some("the GPU had no memory left".to_owned());
                *self = Self { choice: self.choice, fallback, ..Self::from_tracer(Box::new(Cpu::default())) };
            }
            _ => self.failure.set(None),
        }
        Ok(())
    }
}

/// A GPU; where it was asked for by name, a software one too.
#[cfg(feature = "gpu")]
fn open_gpu(choice: DeviceChoice) -> Result<Box<dyn Tracer>> {
    let adapters = if choice == DeviceChoice::Gpu { AdapterKinds::IncludingSoftware } else { AdapterKinds::Hardware };
    Ok(Box::new(GpuTracer::new(&GpuOptions::default().with_adapters(adapters))?))
}

#[cfg(not(feature = "gpu"))]
fn open_gpu(_: DeviceChoice) -> Result<Box<dyn Tracer>> {
    Err(Error::NoGpu { reason: "Ropewalk was built without its `gpu` feature".to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fail(device: &ActiveTracer, error: Error) {
        let failed: Result<()> = device.record_failure(Err(error));
        assert!(failed.is_err());
    }

    fn lost() -> Error {
        Error::DeviceLost { during: "a test", message: String::new() }
    }

    fn out_of_memory() -> Error {
        Error::OutOfMemory { during: "a test", message: String::new() }
    }

    #[test]
    fn auto_comes_down_to_the_cpu_when_memory_is_used_up_and_says_why() {
        let emulated = Box::new(Emulated::default());
        let mut device = ActiveTracer { choice: Some(DeviceChoice::Auto), ..ActiveTracer::from_tracer(emulated) };
        fail(&device, Error::Gpu { during: "a test", message: String::new() });
        device.recover().unwrap();
        assert_eq!((device.tracer().device().executor, device.fallback()), ("emulated", None));
        fail(&device, out_of_memory());
        device.recover().unwrap();
        assert_eq!(device.tracer().device().executor, "cpu");
        assert!(device.fallback().is_some_and(|why| why.contains("memory")));
    }

    #[test]
    fn a_lost_device_is_opened_anew_once() {
        // The device that is opened for this choice is not the one that was there.
        let emulated = Box::new(Emulated::default());
        let mut device = ActiveTracer { choice: Some(DeviceChoice::Cpu), ..ActiveTracer::from_tracer(emulated) };
        fail(&device, lost());
        device.recover().unwrap();
        assert_eq!(device.tracer().device().executor, "cpu");
        device.tracer = Box::new(Emulated::default());
        device.recover().unwrap();
        assert_eq!(device.tracer().device().executor, "emulated");
    }

    #[test]
    fn what_the_application_brought_stays() {
        let mut device = ActiveTracer::from_tracer(Box::new(Emulated::default()));
        for error in [lost(), out_of_memory()] {
            fail(&device, error);
            device.recover().unwrap();
            assert_eq!((device.tracer().device().executor, device.fallback()), ("emulated", None));
        }
    }
}
