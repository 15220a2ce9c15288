//! A set of small numbers that gives them back in order.

/// A set of numbers: one bit each, and one for each word that has any, so that a sparse set is drained quickly.
#[derive(Debug, Default)]
pub(super) struct BitSet {
    words: Vec<u64>,
    /// Which words are not 0.
    summary: Vec<u64>,
    len: usize,
}

impl BitSet {
    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Adds a number. O(1), amortised over the growth to the largest number.
    pub(super) fn insert(&mut self, number: usize) {
        let word = number / 64;
        if word >= self.words.len() {
            self.words.resize(word + 1, 0);
            self.summary.resize(word / 64 + 1, 0);
        }
        let bit = 1 << (number % 64);
        self.len += usize::from(self.words[word] & bit == 0);
        self.words[word] |= bit;
        self.summary[word / 64] |= 1 << (word % 64);
    }

    /// Removes the smallest number that is `start` or above. O(1 + numbers skipped / 4096).
    pub(super) fn pop_from(&mut self, start: usize) -> Option<usize> {
        if self.is_empty() {
            return None;
        }
        let word = start / 64;
        let rest = self.words.get(word)? & (u64::MAX << (start % 64));
        let (word, rest) = if rest != 0 { (word, rest) } else { self.first_word_from(word + 1)? };
        let bit = rest & rest.wrapping_neg();
        self.words[word] ^= bit;
        if self.words[word] == 0 {
            self.summary[word / 64] &= !(1 << (word % 64));
        }
        self.len -= 1;
        Some(word * 64 + bit.trailing_zeros() as usize)
    }

    fn first_word_from(&self, start: usize) -> Option<(usize, u64)> {
        let first = self.summary.get(start / 64)? & (u64::MAX << (start % 64));
        let later = self.summary.iter().enumerate().skip(start / 64 + 1).map(|(i, &summary)| (i, summary));
        let (i, summary) = std::iter::once((start / 64, first)).chain(later).find(|(_, summary)| *summary != 0)?;
        let word = i * 64 + summary.trailing_zeros() as usize;
        Some((word, self.words[word]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gives_back_in_order_what_was_inserted() {
        let mut set = BitSet::default();
        let mut numbers: Vec<usize> =
            (0..1000).map(|i: usize| i * i * 7919 % 300_000).chain([0, 63, 64, 4095, 4096, 299_999]).collect();
        for &number in &numbers {
            set.insert(number);
        }
        numbers.sort_unstable();
        numbers.dedup();

        let from_first = |set: &mut BitSet| {
            let mut start = 0;
            let next = || set.pop_from(start).inspect(|number| start = number + 1);
            std::iter::from_fn(next).collect::<Vec<_>>()
        };
        assert_eq!(from_first(&mut set), numbers);
        assert!(set.is_empty());
        assert_eq!(set.pop_from(0), None);

        set.insert(5);
        set.insert(70);
        assert_eq!(set.pop_from(6), Some(70));
        assert_eq!(set.pop_from(6), None);
        assert!(!set.is_empty());
        assert_eq!(from_first(&mut set), [5]);
    }

    #[test]
    fn numbers_may_be_added_ahead_while_it_is_emptied() {
        let mut set = BitSet::default();
        set.insert(1);
        assert_eq!(set.pop_from(0), Some(1));
        set.insert(10_000);
        assert_eq!(set.pop_from(2), Some(10_000));
    }
}
