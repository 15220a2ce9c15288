//! Messages to the user, in a corner of the window.

use std::time::{Duration, Instant};

/// One message.
#[derive(Clone, Debug)]
pub(crate) struct Message {
    pub(crate) text: String,
    /// Errors stay until they are dismissed.
    pub(crate) is_error: bool,
    since: Instant,
}

/// The messages that are shown, the latest last.
#[derive(Clone, Debug, Default)]
pub(crate) struct Messages {
    shown: Vec<Message>,
}

/// How long a message that is not an error is shown.
const LIFETIME: Duration = Duration::from_secs(5);
/// At most so many messages are shown: a new one removes the oldest.
const MAX_MESSAGES: usize = 6;

impl Messages {
    pub(crate) fn inform(&mut self, text: impl Into<String>) {
        self.push(text.into(), false);
    }

    pub(crate) fn fail(&mut self, text: impl Into<String>) {
        self.push(text.into(), true);
    }

    /// The messages; those that have been shown long enough are removed.
    pub(crate) fn current(&mut self, now: Instant) -> &[Message] {
        self.shown.retain(|message| message.is_error || now.saturating_duration_since(message.since) < LIFETIME);
        &self.shown
    }

    /// The time from now until the next message disappears.
    pub(crate) fn time_to_next_expiry(&self, now: Instant) -> Option<Duration> {
        let expiring = self.shown.iter().filter(|message| !message.is_error);
        expiring.map(|message| LIFETIME.saturating_sub(now.saturating_duration_since(message.since))).min()
    }

    pub(crate) fn dismiss(&mut self, index: usize) {
        if index < self.shown.len() {
            self.shown.remove(index);
        }
    }

    fn push(&mut self, text: String, is_error: bool) {
        // A message with the same text replaces the earlier one.
        self.shown.retain(|message| message.text != text);
        self.shown.push(Message { text, is_error, since: Instant::now() });
        if self.shown.len() > MAX_MESSAGES {
            self.shown.remove(0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_expire_and_errors_stay() {
        let mut messages = Messages::default();
        messages.inform("a message");
        messages.fail("an error");
        messages.fail("an error");
        let now = Instant::now();
        assert_eq!(messages.current(now).len(), 2);
        let later = now + messages.time_to_next_expiry(now).unwrap();
        assert!(messages.current(later).iter().all(|message| message.is_error));
        assert_eq!(messages.time_to_next_expiry(later), None);
        messages.dismiss(0);
        messages.dismiss(0);
        assert!(messages.current(later).is_empty());
    }
}
