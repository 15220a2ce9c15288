//! The renderer's tracer: how it is chosen, and how it is replaced after a device loss or lack of memory.

use std::cell::Cell;

use serde::Serialize;

#[cfg(feature = "gpu")]
use crate::trace::gpu::{AdapterKinds, GpuOptions, GpuTracer};
use crate::trace::{Cpu, Emulated, Tracer};
use crate::{Cancel, Error, Result};

/// Which tracer a renderer uses, and the policy after [`Error::DeviceLost`] or [`Error::OutOfMemory`]: the failing call
/// returns the error, and the next call recovers as documented at each variant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DeviceChoice {
    /// A hardware GPU if there is one, else the CPU. After a device loss: a hardware GPU if one is available, else the
    /// CPU. After out-of-memory: the CPU.
    #[default]
    Auto,
    /// A GPU, or a software implementation of one; an error if there is neither. After a device loss: whichever is
    /// available then. After out-of-memory: the same device, tried again.
    Gpu,
    /// All CPU cores.
    Cpu,
    /// The Rust twin of the GPU kernel, on one CPU thread; for debugging. The paper calls it "Emulated".
    Emulated,
}

/// The tracer of a renderer.
pub(super) struct ActiveTracer {
    /// The policy that chose the tracer; `None` if the application supplied it: the renderer then never replaces it.
    choice: Option<DeviceChoice>,
    tracer: Box<dyn Tracer>,
    /// Why the CPU is used although `Auto` prefers a GPU.
    fallback: Option<String>,
    /// A failure from which the next call must recover.
    failure: Cell<Option<Failure>>,
    /// The token of the tracer, which one that replaces it gets too.
    cancel: Option<Cancel>,
}

/// The kinds of failure after which the tracer may have to be replaced.
#[derive(Clone, Copy)]
enum Failure {
    DeviceLost,
    OutOfMemory,
}

impl ActiveTracer {
    /// Opens the tracer that a policy asks for.
    pub(super) fn open(choice: DeviceChoice) -> Result<Self> {
        let (tracer, fallback): (Box<dyn Tracer>, _) = match choice {
            DeviceChoice::Cpu => (Box::new(Cpu::default()), None),
            DeviceChoice::Emulated => (Box::new(Emulated::default()), None),
            DeviceChoice::Gpu => (open_gpu(choice)?, None),
            // Without a GPU the CPU traces, and the reason is kept.
            DeviceChoice::Auto => match open_gpu(choice) {
                Ok(gpu) => (gpu, None),
                Err(reason) => (Box::new(Cpu::default()), Some(reason.to_string())),
            },
        };
        Ok(Self { choice: Some(choice), fallback, ..Self::from_tracer(tracer) })
    }

    /// Takes a tracer of the application.
    pub(super) fn from_tracer(tracer: Box<dyn Tracer>) -> Self {
        Self { choice: None, tracer, fallback: None, failure: Cell::new(None), cancel: None }
    }

    /// Replaces the tracer by one of the application.
    pub(super) fn set_tracer(&mut self, tracer: Box<dyn Tracer>) {
        self.replace_by(Self::from_tracer(tracer));
    }

    /// Sets the token that stops the tracer.
    pub(super) fn set_cancel(&mut self, cancel: Option<Cancel>) {
        self.tracer.set_cancel(cancel.clone());
        self.cancel = cancel;
    }

    fn replace_by(&mut self, new: Self) {
        let cancel = self.cancel.take();
        *self = new;
        self.set_cancel(cancel);
    }

    /// Why the CPU is used although `Auto` prefers a GPU; `None` if it is not, or another policy was chosen.
    pub(super) fn fallback(&self) -> Option<&str> {
        self.fallback.as_deref()
    }

    pub(super) fn tracer(&self) -> &dyn Tracer {
        &*self.tracer
    }

    pub(super) fn tracer_mut(&mut self) -> &mut dyn Tracer {
        &mut *self.tracer
    }

    /// Returns `result` unchanged. A device loss or lack of memory in it is remembered for [`recover`](Self::recover).
    pub(super) fn record_failure<T>(&self, result: Result<T>) -> Result<T> {
        match &result {
            Err(Error::DeviceLost { .. }) => self.failure.set(Some(Failure::DeviceLost)),
            Err(Error::OutOfMemory { .. }) => self.failure.set(Some(Failure::OutOfMemory)),
            _ => {}
        }
        result
    }

    /// Recovers from the failure of an earlier call, if there was one. A new tracer has no scene yet: the next upload
    /// copies everything.
    pub(super) fn recover(&mut self) -> Result<()> {
        match (self.choice, self.failure.get()) {
            // A lost device is opened again, as the policy chooses now.
            (Some(choice), Some(Failure::DeviceLost)) => self.replace_by(Self::open(choice)?),
            // Out of memory: `Auto` goes on with the CPU.
            (Some(DeviceChoice::Auto), Some(Failure::OutOfMemory)) => {
                let fallback = Some("the GPU had no memory left".to_owned());
                let cpu = Self::from_tracer(Box::new(Cpu::default()));
                self.replace_by(Self { choice: self.choice, fallback, ..cpu });
            }
            // Everything else is tried again with the same tracer.
            _ => self.failure.set(None),
        }
        Ok(())
    }
}

/// Opens a GPU. With [`DeviceChoice::Gpu`] a software adapter (llvmpipe, WARP) is accepted too.
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
    fn auto_falls_back_to_the_cpu_when_memory_is_used_up_and_says_why() {
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
    fn a_lost_device_is_opened_again_once() {
        // The choice opens another tracer than the one that fails, so that they can be told apart.
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
    fn a_tracer_of_the_application_is_never_replaced() {
        let mut device = ActiveTracer::from_tracer(Box::new(Emulated::default()));
        for error in [lost(), out_of_memory()] {
            fail(&device, error);
            device.recover().unwrap();
            assert_eq!((device.tracer().device().executor, device.fallback()), ("emulated", None));
        }
    }
}
