//! Arrays that are larger than a binding may be: they lie in several, and the kernel is told how.

use std::fmt::Write as _;

use crate::trace::Traversal;

/// How many bindings the arrays of a scene take where none is split: those of `types.wgsl`.
pub(crate) const ARRAY_COUNT: u32 = 13;

/// How an array lies in bindings: element `i` is element `i % 2^shift` of part `i >> shift`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ArraySplit {
    /// Parts after the first.
    extra_parts: u32,
    /// The logarithm of the elements of a part.
    shift: u32,
}

impl ArraySplit {
    /// One part, whatever its size.
    pub const WHOLE: Self = Self { extra_parts: 0, shift: 0 };

    /// As few parts as hold `len` elements where a part holds at most `limit`: a power of two each, the last what is left.
    /// Where the limit is 0 nothing does: then each element is a part.
    pub fn new(len: u64, limit: u64) -> Self {
        if len <= limit {
            return Self::WHOLE;
        }
        let shift = limit.max(1).ilog2();
        Self { extra_parts: (len.div_ceil(1 << shift) - 1) as u32, shift }
    }

    /// How many parts there are.
    pub fn parts(self) -> u32 {
        1 + self.extra_parts
    }

    /// Elements of each part but the last; `None` where there is but one.
    pub fn part_len(self) -> Option<u64> {
        (self.extra_parts > 0).then_some(1 << self.shift)
    }
}

/// How the arrays that can be split are. Those of a scene that fits its bindings are not, and its kernel is no slower for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ArraySplits {
    /// Of `blas_nodes` or `wide_nodes`, whichever are bound.
    pub nodes: ArraySplit,
    /// Of `triangles`.
    pub triangles: ArraySplit,
}

impl ArraySplits {
    /// Bindings beyond the [`ARRAY_COUNT`].
    pub(crate) fn extra_bindings(&self) -> u32 {
        self.nodes.extra_parts + self.triangles.extra_parts
    }

    /// Declares the arrays that can be split, their parts, and the functions by which the kernel reads them. Parts after the
    /// first are bound after all arrays, in the order of the members.
    pub(super) fn source(&self, layout: Traversal) -> String {
        let mut source = String::new();
        let element = ("i: u32", "");
        let child = ("i: u32, child: u32", ".children[child]");
        let nodes = ARRAY_COUNT;
        let triangles = nodes + self.nodes.extra_parts;
        match layout {
            Traversal::Rope => {
                self.nodes.write_declarations(&mut source, [2, nodes], "blas_nodes", "Node");
                self.nodes.read(&mut source, "blas_nodes", "blas_node_at", "Node", element);
            }
            Traversal::Wide => {
                self.nodes.write_declarations(&mut source, [2, nodes], "wide_nodes", "WideNode");
                self.nodes.read(&mut source, "wide_nodes", "wide_node_at", "WideNode", element);
                self.nodes.read(&mut source, "wide_nodes", "wide_child_at", "u32", child);
            }
        }
        self.triangles.write_declarations(&mut source, [3, triangles], "triangles", "Triangle");
        self.triangles.read(&mut source, "triangles", "triangle_at", "Triangle", element);
        source
    }
}

/// Writing to a string cannot fail: what it returns is dropped here.
impl ArraySplit {
    /// Declares the first part at one binding, the others from another on.
    fn write_declarations(self, source: &mut String, [first, others]: [u32; 2], array: &str, element: &str) {
        let _ = writeln!(source, "@group(0) @binding({first}) var<storage, read> {array}: array<{element}>;");
        for (part, binding) in (1..self.parts()).zip(others..) {
            let _ =
                writeln!(source, "@group(0) @binding({binding}) var<storage, read> {array}_{part}: array<{element}>;");
        }
    }

    /// A function that reads element `i`, or a member of it.
    fn read(self, source: &mut String, array: &str, name: &str, result: &str, (arguments, member): (&str, &str)) {
        let _ = writeln!(source, "fn {name}({arguments}) -> {result} {{");
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
