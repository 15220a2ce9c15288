//! Arrays larger than a storage binding are split over several bindings; generated accessors select the part.

use std::fmt::Write as _;

use crate::trace::Traversal;

/// Number of bindings of a scene none of whose arrays is split. Those of nodes and triangles are declared by
/// [`ArraySplits::source`], the others by `types.wgsl`.
pub(crate) const ARRAY_COUNT: u32 = 13;

/// How an array is split over bindings: element `i` is element `i % 2^shift` of part `i >> shift`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ArraySplit {
    /// Number of parts beyond the first.
    extra_parts: u32,
    /// log2 of the elements per part.
    shift: u32,
}

impl ArraySplit {
    /// One part, whatever its size.
    pub const WHOLE: Self = Self { extra_parts: 0, shift: 0 };

    /// The fewest parts for `len` elements of which a binding holds at most `limit`. The size of each part is the same
    /// power of two; the last has the rest. A limit of 0 is treated as 1.
    pub fn new(len: u64, limit: u64) -> Self {
        if len <= limit {
            return Self::WHOLE;
        }
        // Parts of the greatest power of two that a binding holds.
        let shift = limit.max(1).ilog2();
        Self { extra_parts: (len.div_ceil(1 << shift) - 1) as u32, shift }
    }

    /// Number of parts.
    pub fn parts(self) -> u32 {
        1 + self.extra_parts
    }

    /// Elements of each part but the last; `None` if there is only one.
    pub fn part_len(self) -> Option<u64> {
        (self.extra_parts > 0).then_some(1 << self.shift)
    }
}

/// Splits of the arrays that can be split. A scene that fits has no splits and pays nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct ArraySplits {
    /// Split of `blas_nodes` or `wide_nodes`, whichever are bound.
    pub nodes: ArraySplit,
    /// Split of `triangles`.
    pub triangles: ArraySplit,
}

impl ArraySplits {
    /// Splits the BLAS nodes like this.
    #[must_use]
    pub fn with_nodes(self, nodes: ArraySplit) -> Self {
        Self { nodes, ..self }
    }

    /// Splits the triangles like this.
    #[must_use]
    pub fn with_triangles(self, triangles: ArraySplit) -> Self {
        Self { triangles, ..self }
    }

    /// Number of bindings beyond the [`ARRAY_COUNT`].
    pub(crate) fn extra_bindings(&self) -> u32 {
        self.nodes.extra_parts + self.triangles.extra_parts
    }

    /// WGSL that declares the arrays that can be split, their parts, and the functions by which the kernel reads them.
    /// Parts after the first are bound after all arrays, in the order of the members.
    pub(super) fn source(&self, traversal: Traversal) -> String {
        let mut source = String::new();
        // Accessors return a whole element, or one child of a node.
        let element = ("i: u32", "");
        let child = ("i: u32, child: u32", ".children[child]");
        // Bindings of the further parts: those of the nodes, then those of the triangles.
        let nodes = ARRAY_COUNT;
        let triangles = nodes + self.nodes.extra_parts;
        // Declare the nodes of the traversal in use.
        match traversal {
            Traversal::Rope => {
                self.nodes.write_declarations(&mut source, [2, nodes], "blas_nodes", "Node");
                self.nodes.write_accessor(&mut source, "blas_nodes", "blas_node_at", "Node", element);
            }
            Traversal::Wide => {
                self.nodes.write_declarations(&mut source, [2, nodes], "wide_nodes", "WideNode");
                self.nodes.write_accessor(&mut source, "wide_nodes", "wide_node_at", "WideNode", element);
                self.nodes.write_accessor(&mut source, "wide_nodes", "wide_child_at", "u32", child);
            }
        }
        // Declare the triangles.
        self.triangles.write_declarations(&mut source, [3, triangles], "triangles", "Triangle");
        self.triangles.write_accessor(&mut source, "triangles", "triangle_at", "Triangle", element);
        source
    }
}

// Writing to a string cannot fail: the results of `writeln` are dropped here.
impl ArraySplit {
    /// Declares the first part at one binding, the others from another on.
    fn write_declarations(self, source: &mut String, [first, others]: [u32; 2], array: &str, element: &str) {
        let _ = writeln!(source, "@group(0) @binding({first}) var<storage, read> {array}: array<{element}>;");
        for (part, binding) in (1..self.parts()).zip(others..) {
            let _ =
                writeln!(source, "@group(0) @binding({binding}) var<storage, read> {array}_{part}: array<{element}>;");
        }
    }

    /// Writes the function that reads element `i` of an array, or a member of it. For 20 triangles in parts of 8:
    ///
    /// ```wgsl
    /// fn triangle_at(i: u32) -> Triangle {
    ///     let j = i & 7u;
    ///     switch i >> 3u {
    ///         case 1u: { return triangles_1[j]; }
    ///         case 2u: { return triangles_2[j]; }
    ///         default: { return triangles[j]; }
    ///     }
    /// }
    /// ```
    fn write_accessor(
        self,
        source: &mut String,
        array: &str,
        name: &str,
        result: &str,
        (arguments, member): (&str, &str),
    ) {
        let _ = writeln!(source, "fn {name}({arguments}) -> {result} {{");
        // Split: the upper bits of the index choose the part, the lower ones the element.
        if self.extra_parts > 0 {
            let shift = self.shift;
            let _ = writeln!(source, "    let j = i & {}u;\n    switch i >> {shift}u {{", (1u64 << shift) - 1);
            for part in 1..self.parts() {
                let _ = writeln!(source, "        case {part}u: {{ return {array}_{part}[j]{member}; }}");
            }
            let _ = writeln!(source, "        default: {{ return {array}[j]{member}; }}\n    }}\n}}");
        } else {
            let _ = writeln!(source, "    return {array}[i]{member};\n}}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_hold_all_elements_and_none_is_empty() {
        for (len, limit, parts, part_len) in [
            (0, 10, 1, None),
            (10, 10, 1, None),
            (11, 10, 2, Some(8)),
            (16, 10, 2, Some(8)),
            (17, 10, 3, Some(8)),
            (3, 0, 3, Some(1)),
            (5 << 31, 3 << 30, 5, Some(1 << 31)),
        ] {
            let split = ArraySplit::new(len, limit);
            assert_eq!((split.parts(), split.part_len()), (parts, part_len), "{len} in parts of {limit}");
        }
    }

    #[test]
    fn a_whole_array_is_read_as_one() {
        let source = ArraySplits::default().source(Traversal::Rope);
        assert!(source.contains("return triangles[i];") && !source.contains("switch"), "{source}");
        let split = ArraySplits { triangles: ArraySplit::new(40, 10), ..ArraySplits::default() };
        let source = split.source(Traversal::Wide);
        assert!(
            source.contains("@binding(16) var<storage, read> triangles_4") && source.contains("i >> 3u"),
            "{source}"
        );
        assert_eq!(split.extra_bindings(), 4);
    }
}
