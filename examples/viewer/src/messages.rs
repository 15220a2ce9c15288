//! What the user is told, in a corner of the window.

use std::time::{Duration, Instant};

/// One line.
#[derive(Clone, Debug)]
pub(crate) struct Message {
    pub(crate) text: String,
    /// Errors stay until they are dismissed.
    pub(crate) is_error: bool,
    since: Instant,
}

/// The lines that are shown, the latest last.
#[derive(Clone, Debug, Default)]
pub(crate) struct Messages {
    shown: Vec<Message>,
}

/// How long what is no error is shown.
const SHOWN: Duration = Duration::from_secs(5);
/// More than these push the oldest out.
const MOST: usize = 6;

impl Messages {
    pub(crate) fn tell(&mut self, text: impl Into<String>) {
        self.push(text.into(), false);
    }

    pub(crate) fn fail(&mut self, text: impl Into<String>) {
        self.push(text.into(), true);
    }

    /// The messages, without those that were shown long enough.
    pub(crate) fn current(&mut self, now: Instant) -> &[Message] {
        self.shown.retain(|message| message.is_error || now.saturating_duration_since(message.since) < SHOWN);
        &self.shown
    }

    /// How long from now on the messages stay as they are.
    pub(crate) fn settled_for(&self, now: Instant) -> Option<Duration> {
        let passing = self.shown.iter().filter(|message| !message.is_error);
        passing.map(|message| SHOWN.saturating_sub(now.saturating_duration_since(message.since))).min()
    }

    pub(crate) fn dismiss(&mut self, index: usize) {
        if index < self.shown.len() {
            self.shown.remove(index);
        }
    }

    fn push(&mut self, text: String, is_error: bool) {
        // A message that comes again is the same message.
        self.shown.retain(|message| message.text != text);
        self.shown.push(Message { text, is_error, since: Instant::now() });
        if self.shown.len() > MOST {
            self.shown.remove(0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn news_pass_and_errors_stay() {
        let mut messages = Messages::default();
        messages.tell("news");
        messages.fail("an error");
        messages.fail("an error");
        let now = Instant::now();
        assert_eq!(messages.current(now).len(), 2);
        let later = now + messages.settled_for(now).unwrap();
        assert!(messages.current(later).iter().all(|message| message.is_error));
        assert_eq!(messages.settled_for(later), None);
        messages.dismiss(0);
        messages.dismiss(0);
        assert!(messages.current(later).is_empty());
    }
}
