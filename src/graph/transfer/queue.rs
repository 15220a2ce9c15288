//! Edits from other threads: batches that are applied where the scene lives, each all or not at all.

use std::sync::mpsc::{Receiver, Sender, channel};

use crate::graph::Scene;
use crate::{Error, Result};

type Batch = Box<dyn FnOnce(&mut Scene) + Send>;

/// Where the batches arrive: beside the scene, on its thread. Batches of one sender are applied in the order in which
/// they were sent.
///
/// ```
/// use ropewalk::{Core, EditQueue, Scene};
///
/// let mut scene = Scene::new();
/// let queue = EditQueue::new();
/// let (root, sender) = (scene.root(), queue.sender());
/// let worker = std::thread::spawn(move || {
///     let added = sender.send(move |scene| {
///         let node = scene.add(root, Core::Group)?;
///         scene.set_name(node, "from afar")?;
///         Ok(node)
///     });
///     added.wait()
/// });
/// while !worker.is_finished() {
///     // Once a frame.
///     queue.apply(&mut scene);
/// }
/// let node = worker.join().expect("no panic")?;
/// assert_eq!(scene.name(node)?, "from afar");
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

    /// A sender to it, for another thread.
    pub fn sender(&self) -> EditSender {
        EditSender { batches: self.sender.clone() }
    }

    /// Applies the batches that have arrived, each in a [transaction](Scene::transaction) of its own: one that fails
    /// leaves no trace, and its sender is told. Gives their number. Does not wait for more.
    pub fn apply(&self, scene: &mut Scene) -> usize {
        // Not those that arrive meanwhile, or busy senders could hold a frame up forever.
        let arrived: Vec<Batch> = self.receiver.try_iter().collect();
        let count = arrived.len();
        for batch in arrived {
            batch(scene);
        }
        count
    }
}

/// Sends edits to the thread where the scene lives. Cheap to clone.
#[derive(Clone, Debug)]
pub struct EditSender {
    batches: Sender<Batch>,
}

impl EditSender {
    /// Sends a batch of edits, to be applied whole or not at all when the scene's thread next calls
    /// [`EditQueue::apply`]. Does not wait for that; what it gives back can, or can be dropped.
    pub fn send<T: Send + 'static>(
        &self,
        batch: impl FnOnce(&mut Scene) -> Result<T> + Send + 'static,
    ) -> PendingEdit<T> {
        let (outcome, pending) = channel();
        let batch = move |scene: &mut Scene| {
            // A sender that does not want to know has dropped the other end.
            let _ = outcome.send(scene.transaction(batch));
        };
        // Where the queue is gone, the batch goes, and the outcome's sender with it: that is what `wait` sees.
        let _ = self.batches.send(Box::new(batch));
        PendingEdit { outcome: pending }
    }
}

/// The outcome of a batch that was sent.
#[derive(Debug)]
#[must_use = "drop it if the outcome does not matter"]
pub struct PendingEdit<T> {
    outcome: Receiver<Result<T>>,
}

impl<T> PendingEdit<T> {
    /// Waits until the batch has been applied or has failed. On the scene's own thread that is forever.
    ///
    /// # Errors
    /// Those of the batch; [`Error::QueueClosed`] if the queue went away before it was applied.
    pub fn wait(self) -> Result<T> {
        self.outcome.recv().unwrap_or(Err(Error::QueueClosed))
    }

    /// The outcome if there is one already. Gives it once.
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
