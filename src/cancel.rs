//! The token by which an application stops a long call from another thread.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::{Error, Result};

/// Stops a call that is running on another thread: an import, a build, a frame or a batch of rays.
///
/// Give a clone to the call, and keep one for the thread that may stop it. Once [`cancel`](Self::cancel) was called,
/// the running call ends with [`Error::Cancelled`], and so does every later one that has the token: a token is for one
/// job, and the next job gets a new one. The scene is as it was before a call that was cancelled, and the next call
/// that is not cancelled gives what it would have given if it had been the first.
///
/// Calls look at the token between pieces of work: each object of a file, some thousand triangles of a build, each tile
/// of a frame on the CPU and each dispatch on a GPU. They end within such a piece, mostly some milliseconds; what is
/// not divided is the decoding of one image, the parsing of a file's JSON, and the copy of the scene to a GPU.
///
/// ```
/// use ropewalk::{Cancel, DeviceChoice, Error, Renderer, RendererOptions, Scene, View};
///
/// let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
/// let mut scene = Scene::new();
/// let view = View::framing(&mut scene, 64, 48)?;
///
/// // Another thread would do this while a frame is being rendered.
/// let cancel = Cancel::new();
/// renderer.set_cancel(cancel.clone());
/// cancel.cancel();
/// assert_eq!(renderer.render(&mut scene, &view).err(), Some(Error::Cancelled));
///
/// // The next frame has a token of its own.
/// renderer.set_cancel(Cancel::new());
/// assert!(renderer.render(&mut scene, &view).is_ok());
/// # Ok::<(), ropewalk::Error>(())
/// ```
#[derive(Clone, Default)]
pub struct Cancel {
    /// [`RUNNING`], [`CANCELLED`], or how many more times [`should_stop`](Self::should_stop) returns false.
    state: Arc<AtomicU64>,
}

const RUNNING: u64 = 0;
const CANCELLED: u64 = u64::MAX;

impl Cancel {
    /// A token that is not cancelled.
    pub fn new() -> Self {
        Self::default()
    }

    /// A token that is cancelled when it is looked at for the time `checks` + 1, so that tests can stop a call at each
    /// of the places where it can be stopped.
    #[doc(hidden)]
    pub fn after_checks(checks: u64) -> Self {
        let state = if checks == 0 { CANCELLED } else { checks };
        Self { state: Arc::new(AtomicU64::new(state)) }
    }

    /// Stops the calls that have this token or a clone of it, for good. O(1), from any thread and from a signal
    /// handler; returns at once, before they have ended.
    pub fn cancel(&self) {
        self.state.store(CANCELLED, Relaxed);
    }

    /// Whether [`cancel`](Self::cancel) was called on this token or a clone of it.
    pub fn is_cancelled(&self) -> bool {
        self.state.load(Relaxed) == CANCELLED
    }

    /// Whether the work must stop here. One relaxed load: call it for each piece of some microseconds or more.
    #[inline]
    pub(crate) fn should_stop(&self) -> bool {
        match self.state.load(Relaxed) {
            RUNNING => false,
            CANCELLED => true,
            _ => self.count_down(),
        }
    }

    /// [`Error::Cancelled`] if the work must stop here.
    #[inline]
    pub(crate) fn check(&self) -> Result<()> {
        if self.should_stop() { Err(Error::Cancelled) } else { Ok(()) }
    }

    /// Counts a check of [`after_checks`](Self::after_checks).
    #[cold]
    fn count_down(&self) -> bool {
        let next = |left| match left {
            RUNNING | CANCELLED => None,
            1 => Some(CANCELLED),
            left => Some(left - 1),
        };
        // The check that takes the last one still passes.
        self.state.fetch_update(Relaxed, Relaxed, next) == Err(CANCELLED)
    }
}

impl fmt::Debug for Cancel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Cancel").field("is_cancelled", &self.is_cancelled()).finish()
    }
}

/// Tokens are equal if they are clones of one another: to cancel one is to cancel the other.
impl PartialEq for Cancel {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.state, &other.state)
    }
}

impl Eq for Cancel {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clone_is_the_same_token_and_stays_cancelled() {
        let (token, other) = (Cancel::new(), Cancel::new());
        let clone = token.clone();
        assert_eq!((token == clone, token == other), (true, false));
        assert_eq!((token.check(), token.is_cancelled()), (Ok(()), false));
        clone.cancel();
        assert_eq!((token.check(), token.is_cancelled()), (Err(Error::Cancelled), true));
        assert_eq!(token.check(), Err(Error::Cancelled), "still");
        assert_eq!(other.check(), Ok(()));
    }

    #[test]
    fn a_token_that_counts_passes_as_many_checks_as_it_says() {
        for checks in [0, 1, 2, 5] {
            let token = Cancel::after_checks(checks);
            assert!((0..checks).all(|_| token.check().is_ok()), "{checks}");
            assert_eq!((token.check(), token.is_cancelled()), (Err(Error::Cancelled), true), "{checks}");
        }
    }
}
