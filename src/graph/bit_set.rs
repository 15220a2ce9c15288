//! A two-level bit set that drains in ascending order.

/// A set of small numbers: one bit per number, and one summary bit per word of them, so that a sparse set drains
/// quickly.
#[derive(Debug, Default)]
pub(super) struct BitSet {
    words: Vec<u64>,
    /// One bit per word: whether it is not 0.
    summary: Vec<u64>,
    has_any: bool,
}

impl BitSet {
    pub(super) fn is_empty(&self) -> bool {
        !self.has_any
    }

    /// Adds a number. O(1), amortised over the growth to the largest number.
    #[inline]
    pub(super) fn insert(&mut self, number: usize) {
        let word = number / 64;
        if word >= self.words.len() {
            self.words.resize(word + 1, 0);
            self.summary.resize(word / 64 + 1, 0);
        }
        self.words[word] |= 1 << (number % 64);
        self.summary[word / 64] |= 1 << (word % 64);
        self.has_any = true;
    }

    /// Removes all numbers in ascending order, as the iterator is run to its end. O(numbers + largest / 4096).
    pub(super) fn drain(&mut self) -> impl Iterator<Item = usize> {
        let Self { words, summary, has_any } = self;
        let has_any = std::mem::take(has_any);
        let summary = summary.iter_mut().take_while(move |_| has_any).enumerate();
        let word_indices = summary.flat_map(|(i, word)| ones(std::mem::take(word)).map(move |bit| i * 64 + bit));
        word_indices.flat_map(|i| ones(std::mem::take(&mut words[i])).map(move |bit| i * 64 + bit))
    }
}

/// Indices of the set bits, ascending.
fn ones(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = word.trailing_zeros() as usize;
        word &= word.checked_sub(1)?;
        Some(bit)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gives_back_in_order_what_was_inserted() {
        let mut set = BitSet::default();
        assert!(set.is_empty());
        let mut numbers: Vec<usize> =
            (0..1000).map(|i: usize| i * i * 7919 % 300_000).chain([0, 63, 64, 4095, 4096, 299_999]).collect();
        for &number in &numbers {
            set.insert(number);
        }
        numbers.sort_unstable();
        numbers.dedup();
        assert!(!set.is_empty());
        assert_eq!(set.drain().collect::<Vec<_>>(), numbers);
        assert!(set.is_empty());
        assert_eq!(set.drain().next(), None);

        set.insert(70);
        set.insert(5);
        assert_eq!(set.drain().collect::<Vec<_>>(), [5, 70]);
        assert!(set.is_empty());
    }
}
