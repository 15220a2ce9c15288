//! A queue of edit batches from other threads; each batch is applied as a transaction on the scene's thread.

use std::sync::mpsc::{Receiver, Sender, channel};

use crate::graph::Scene;
use crate::{Error, Result};

type Batch = Box<dyn FnOnce(&mut Scene) + Send>;

/// Receives edit batches on the scene's thread. Batches of one sender are applied in the order in which they were sent.
///
/// ```
/// use ropewalk::graph::EditQueue;
/// use ropewalk::{Core, Scene};
///
/// let mut scene = Scene::new();
/// let queue = EditQueue::new();
/// let (root, sender) = (scene.root(), queue.sender());
/// let worker = std::thread::spawn(move || {
///     let added = sender.send(move |scene| {
///         let node = scene.add(root, Core::Group)?;
///         scene.set_name(node, "made elsewhere")?;
///         Ok(node)
///     });
///     added.wait()
/// });
/// while !worker.is_finished() {
///     // Once a frame.
///     queue.apply(&mut scene);
/// }
/// let node = worker.join().expect("no panic")?;
/// assert_eq!(scene.name(node)?, "made elsewhere");
/// # Ok::<(), ropewalk::Error>(())
/// ```
#[derive(Debug)]
pub struct EditQueue {
    sender: Sender<Batch>,
    receiver: Receiver<Batch>,
}

impl Default for EditQueue {
    fn default() -> Self {
        Self::new()
    }
}

impl EditQueue {
    /// An empty queue.
    pub fn new() -> Self {
        let (sender, receiver) = channel();
        Self { sender, receiver }
    }

    /// A sender to this queue, for another thread.
    pub fn sender(&self) -> EditSender {
        EditSender { batches: self.sender.clone() }
    }

    /// Applies all batches received so far, each as a [transaction](Scene::transaction); a failed batch is rolled back
    /// and its error sent to the sender. Returns the number of batches. Does not block.
    pub fn apply(&self, scene: &mut Scene) -> usize {
        // Take a fixed set: later batches wait for the next call, so that busy senders cannot block a frame.
        let batches: Vec<Batch> = self.receiver.try_iter().collect();
        let count = batches.len();
        for batch in batches {
            batch(scene);
        }
        count
    }
}

/// Sends edit batches to the thread of the scene. Cheap to clone.
#[derive(Clone, Debug)]
pub struct EditSender {
    batches: Sender<Batch>,
}

impl EditSender {
    /// Sends a batch of edits, to be applied atomically when the scene's thread next calls [`EditQueue::apply`]. Does
    /// not block. The returned handle can be waited on or dropped.
    pub fn send<T: Send + 'static>(
        &self,
        batch: impl FnOnce(&mut Scene) -> Result<T> + Send + 'static,
    ) -> PendingEdit<T> {
        let (outcome, pending) = channel();
        let batch = move |scene: &mut Scene| {
            // Fails if the handle was dropped.
            let _ = outcome.send(scene.transaction(batch));
        };
        // If the queue was dropped, the batch is dropped here, and the outcome's sender with it: `wait` then returns
        // `QueueClosed`.
        let _ = self.batches.send(Box::new(batch));
        PendingEdit { outcome: pending }
    }
}

/// A handle to the outcome of a batch that was sent.
#[derive(Debug)]
#[must_use = "drop it if the outcome does not matter"]
pub struct PendingEdit<T> {
    outcome: Receiver<Result<T>>,
}

impl<T> PendingEdit<T> {
    /// Blocks until the batch has been applied or has failed. Never call it on the scene's own thread: it would wait
    /// forever.
    ///
    /// # Errors
    /// Those of the batch; [`Error::QueueClosed`] if the queue was dropped before it applied the batch.
    pub fn wait(self) -> Result<T> {
        self.outcome.recv().unwrap_or(Err(Error::QueueClosed))
    }

    /// The outcome, if there is one already. Returns it only once.
    ///
    /// # Errors
    /// As [`wait`](Self::wait).
    pub fn try_outcome(&self) -> Option<Result<T>> {
        use std::sync::mpsc::TryRecvError;
        match self.outcome.try_recv() {
            Ok(outcome) => Some(outcome),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(Error::QueueClosed)),
        }
    }
}
