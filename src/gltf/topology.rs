//! Triangle topologies: list, strip, fan.

use ::gltf::json::mesh::Mode;

/// How a sequence of vertices forms triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Topology {
    List,
    Strip,
    Fan,
}

impl Topology {
    /// The topology of a primitive's mode; `None` for points and lines.
    pub(super) fn of(mode: Mode) -> Option<Self> {
        match mode {
            Mode::Triangles => Some(Self::List),
            Mode::TriangleStrip => Some(Self::Strip),
            Mode::TriangleFan => Some(Self::Fan),
            Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => None,
        }
    }

    /// The number of triangles that so many vertices form.
    pub(super) fn triangle_count(self, vertices: usize) -> usize {
        match self {
            Self::List => vertices / 3,
            Self::Strip | Self::Fan => vertices.saturating_sub(2),
        }
    }

    /// The triangles, each with the first vertex and the winding that the glTF specification (3.7.2.1) gives it.
    /// Vertices that complete no triangle are left out; triangles without area are kept, so that triangle indices stay
    /// those of the file.
    pub(super) fn triangles(self, vertices: &[u32]) -> Vec<[u32; 3]> {
        match self {
            Self::List => vertices.as_chunks::<3>().0.to_vec(),
            Self::Strip => {
                // Every second triangle of a strip is wound the other way: swap two of its vertices.
                let triangle =
                    |(i, v): (usize, &[u32])| if i % 2 == 0 { [v[0], v[1], v[2]] } else { [v[0], v[2], v[1]] };
                vertices.windows(3).enumerate().map(triangle).collect()
            }
            Self::Fan => vertices.windows(2).skip(1).map(|v| [v[0], v[1], vertices[0]]).collect(),
        }
    }
}

/// Compacts the index range: renumbers indices to the used vertices only, and returns these in ascending order; `None`
/// if all `vertex_count` vertices are used, so that nothing was renumbered. O(indices + vertices / 64).
///
/// Exporters often let many primitives share one vertex buffer, of which each uses a part.
pub(super) fn compact_vertices(indices: &mut [u32], vertex_count: usize) -> Option<Vec<u32>> {
    // 1. Mark the used vertices in a bit set that begins at the first of them.
    let (Some(&first), Some(&last)) = (indices.iter().min(), indices.iter().max()) else { return Some(Vec::new()) };
    let mut words = vec![0_u64; ((last - first) / u64::BITS) as usize + 1];
    let word_and_bit = |vertex: u32| (((vertex - first) / u64::BITS) as usize, (vertex - first) % u64::BITS);
    for &vertex in &*indices {
        let (word, bit) = word_and_bit(vertex);
        words[word] |= 1 << bit;
    }

    // 2. Prefix sums of the words' bit counts: the number of used vertices before each word.
    let mut total = 0;
    let ranks: Vec<u32> = words
        .iter()
        .map(|word| {
            let rank = total;
            total += word.count_ones();
            rank
        })
        .collect();
    // If all are used, the indices stay as they are.
    if total as usize == vertex_count {
        return None;
    }

    // 3. Renumber: the new index is the number of used vertices before the old one.
    for vertex in indices {
        let (word, bit) = word_and_bit(*vertex);
        *vertex = ranks[word] + (words[word] & ((1 << bit) - 1)).count_ones();
    }

    // 4. List the used vertices.
    let vertices_of_word = |(i, &word): (usize, &u64)| {
        let base = first + i as u32 * u64::BITS;
        (0..u64::BITS).filter(move |bit| word >> bit & 1 == 1).map(move |bit| base + bit)
    };
    Some(words.iter().enumerate().flat_map(vertices_of_word).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn strips_and_fans_wind_as_the_specification_says() {
        let v = [10, 11, 12, 13, 14];
        assert_eq!(Topology::List.triangles(&v), [[10, 11, 12]]);
        assert_eq!(Topology::Strip.triangles(&v), [[10, 11, 12], [11, 13, 12], [12, 13, 14]]);
        assert_eq!(Topology::Fan.triangles(&v), [[11, 12, 10], [12, 13, 10], [13, 14, 10]]);
        for topology in [Topology::List, Topology::Strip, Topology::Fan] {
            for length in 0..=v.len() {
                assert_eq!(topology.triangles(&v[..length]).len(), topology.triangle_count(length), "{topology:?}");
            }
        }
    }

    proptest! {
        #[test]
        fn compacting_names_the_same_vertices(indices in prop::collection::vec(0_u32..300, 0..400), spare in 0_usize..2) {
            let vertex_count = indices.iter().max().map_or(0, |&m| m as usize + 1) + spare;
            let mut renumbered = indices.clone();
            let used = compact_vertices(&mut renumbered, vertex_count);
            let used = used.unwrap_or_else(|| (0..vertex_count as u32).collect());
            let mut distinct = indices.clone();
            distinct.sort_unstable();
            distinct.dedup();
            prop_assert_eq!(&used, &distinct);
            let named: Vec<u32> = renumbered.iter().map(|&i| used[i as usize]).collect();
            prop_assert_eq!(named, indices);
        }
    }
}
