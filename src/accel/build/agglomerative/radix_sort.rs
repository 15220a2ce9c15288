//! Sorts keys by their upper bits, stably and in parallel.

use rayon::prelude::*;

/// Bits that one pass sorts by.
const DIGIT_BITS: u32 = 8;
const DIGIT_COUNT: usize = 1 << DIGIT_BITS;

/// Fewer keys than this are sorted by comparison.
const RADIX_SORT_THRESHOLD: usize = 1 << 14;

/// The keys are processed in this many chunks whatever the number of threads, so that the order of equal keys is fixed.
const CHUNK_COUNT: usize = 16;

/// Sorts by the bits from `first_bit` on; keys that agree in them keep their order. O(n).
pub(super) fn sort(keys: &mut Vec<u64>, first_bit: u32) {
    if keys.len() < RADIX_SORT_THRESHOLD {
        keys.sort_by_key(|key| key >> first_bit);
        return;
    }
    let mut target: Vec<u64> = bytemuck::zeroed_vec(keys.len());
    for shift in (first_bit..u64::BITS).step_by(DIGIT_BITS as usize) {
        if sort_by_digit(keys, &mut target, shift) {
            std::mem::swap(keys, &mut target);
        }
    }
}

/// One pass of a least-significant-digit radix sort: writes the keys to `target` sorted by one digit, unless all keys
/// have the same digit. Returns whether it wrote.
fn sort_by_digit(keys: &[u64], mut target: &mut [u64], shift: u32) -> bool {
    let digit = |key: u64| (key >> shift) as usize % DIGIT_COUNT;
    // 1. Count the digits of each chunk.
    let chunk_len = keys.len().div_ceil(CHUNK_COUNT).max(1);
    let count = |chunk: &[u64]| {
        let mut counts = [0_usize; DIGIT_COUNT];
        chunk.iter().for_each(|&key| counts[digit(key)] += 1);
        counts
    };
    let counts: Vec<[usize; DIGIT_COUNT]> = keys.par_chunks(chunk_len).map(count).collect();
    // 2. If all keys have the same digit, the pass has nothing to do.
    if keys.first().is_none_or(|&key| counts.iter().map(|c| c[digit(key)]).sum::<usize>() == keys.len()) {
        return false;
    }
    // 3. Divide the target: for each digit, one piece for each chunk, in this order.
    let mut pieces: Vec<Vec<&mut [u64]>> = counts.iter().map(|_| Vec::with_capacity(DIGIT_COUNT)).collect();
    for digit in 0..DIGIT_COUNT {
        for (counts, pieces) in counts.iter().zip(&mut pieces) {
            pieces.push(target.split_off_mut(..counts[digit]).unwrap_or_default());
        }
    }
    // 4. Scatter the chunks in parallel, each into its own pieces.
    keys.par_chunks(chunk_len).zip(pieces).for_each(|(chunk, mut pieces)| {
        let mut next = [0; DIGIT_COUNT];
        for &key in chunk {
            let digit = digit(key);
            pieces[digit][next[digit]] = key;
            next[digit] += 1;
        }
    });
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sorts_as_a_stable_comparison_sort_does() {
        let mut random = fastrand::Rng::with_seed(1);
        for len in [0, 1, 1000, RADIX_SORT_THRESHOLD, RADIX_SORT_THRESHOLD + 12_345] {
            for bits in [0..64, 20..64, 61..64] {
                // A quarter of the keys are equal.
                let key = |_| if random.u8(..4) == 0 { u64::MAX } else { random.u64(..) };
                let mut keys: Vec<u64> = (0..len).map(key).collect();
                let mut expected = keys.clone();
                expected.sort_by_key(|key| key >> bits.start);
                sort(&mut keys, bits.start);
                assert_eq!(keys, expected);
            }
        }
    }
}
