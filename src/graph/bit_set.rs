//! A set of small numbers that gives them back in order.

/// A set of numbers below its capacity: one bit each, and one for each word that has any, so that a sparse set is
/// drained quickly.
#[derive(Debug)]
pub(super) struct BitSet {
    words: Vec<u64>,
    /// Which words are not 0.
    summary: Vec<u64>,
    is_empty: bool,
}

impl BitSet {
    /// An empty set of numbers below `capacity`.
    pub(super) fn new(capacity: usize) -> Self {
        let word_count = capacity.div_ceil(64);
        Self { words: vec![0; word_count], summary: vec![0; word_count.div_ceil(64)], is_empty: true }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.is_empty
    }

    /// Adds a number. O(1).
    pub(super) fn insert(&mut self, number: usize) {
        let word = number / 64;
        self.words[word] |= 1 << (number % 64);
        self.summary[word / 64] |= 1 << (word % 64);
        self.is_empty = false;
    }

    /// Visits all numbers from the smallest up, and leaves the set empty. O(numbers + capacity / 4096).
    pub(super) fn drain(&mut self, mut visit: impl FnMut(usize)) {
        if std::mem::replace(&mut self.is_empty, true) {
            return;
        }
        for (i, summary) in self.summary.iter_mut().enumerate() {
            for word in take_bits(summary) {
                let word = i * 64 + word;
                for bit in take_bits(&mut self.words[word]) {
                    visit(word * 64 + bit);
                }
            }
        }
    }
}

/// The positions of the bits that are set, from the lowest up; none is set any more.
fn take_bits(bits: &mut u64) -> impl Iterator<Item = usize> + use<> {
    let mut rest = std::mem::take(bits);
    std::iter::from_fn(move || {
        let lowest = (rest != 0).then(|| rest.trailing_zeros() as usize)?;
        rest &= rest - 1;
        Some(lowest)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drains_in_order_what_was_inserted() {
        let mut set = BitSet::new(300_000);
        let mut numbers: Vec<usize> =
            (0..1000).map(|i: usize| i * i * 7919 % 300_000).chain([0, 63, 64, 299_999]).collect();
        for &number in &numbers {
            set.insert(number);
        }
        numbers.sort_unstable();
        numbers.dedup();

        let mut drained = Vec::new();
        set.drain(|number| drained.push(number));
        assert_eq!(drained, numbers);
        assert!(set.is_empty());

        set.insert(5);
        drained.clear();
        set.drain(|number| drained.push(number));
        assert_eq!(drained, [5]);
    }
}
