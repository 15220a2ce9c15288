//! The memory that JSON text will take as parsed values and typed objects, estimated from above before anything of it
//! is parsed.

use std::collections::BTreeMap;
use std::fmt;

use ::gltf::json;
use json::extensions::scene::khr_lights_punctual::Light;
use serde::de::{DeserializeSeed, MapAccess, SeqAccess, Visitor};
use serde_json::Value;

use super::accessor::AccessorData;
use super::geometry::GeometrySource;
use crate::graph::{NodeKey, Transform};

/// A vector that grows by doubling is, while it moves, in two places: half a capacity and a capacity, for at least half
/// a capacity of elements. The fourth is for lists of references to the elements while they are searched.
const BYTES_PER_ELEMENT: usize = 4 * size_of::<Value>();
/// The least capacity of such a vector.
const MIN_CAPACITY: usize = 4;
/// A leaf of the tree that holds the members of an object. A leaf has room for eleven, and at least five in use.
const BYTES_PER_LEAF: usize = 11 * (size_of::<String>() + size_of::<Value>()) + 16;
const MIN_MEMBERS_PER_LEAF: usize = 5;
const MAX_MEMBERS_PER_LEAF: usize = 11;
/// What an allocation takes beyond its size.
const ALLOCATION_OVERHEAD: usize = 32;
/// A string of the file is in the parsed values, in a typed object and in the plan or the report.
const STRING_COPIES: usize = 3;
/// A number in an array is in a typed vector too.
const BYTES_PER_TYPED_NUMBER: usize = 16;
/// What is in `extensions` is copied into the typed object, by way of a third form of about half the size: so many
/// halves of its own size in all.
const EXTENSION_HALVES: u64 = 5;
/// An entry of a hash map that grows by doubling, relative to its content.
const MAP_OVERHEAD: usize = 4;

/// For each member of the root, the bytes of the typed objects that its values become, by their depth: the root is at
/// depth 0, its members at 1, the objects in a member that is an array at 2.
const TYPED: &[(&str, &[(usize, usize)])] = &[
    ("accessors", &[(2, BYTES_PER_ACCESSOR)]),
    ("bufferViews", &[(2, size_of::<json::buffer::View>())]),
    ("buffers", &[(2, size_of::<json::Buffer>() + MAP_OVERHEAD * size_of::<[usize; 8]>())]),
    ("cameras", &[(2, size_of::<Option<json::Camera>>())]),
    // The lights: "/extensions/KHR_lights_punctual/lights/*".
    ("extensions", &[(4, size_of::<Option<Light>>())]),
    // Of images and materials there are two lists, of which one may have gaps.
    ("images", &[(2, size_of::<Option<json::Image>>() + size_of::<json::Image>())]),
    ("materials", &[(2, size_of::<Option<json::Material>>() + size_of::<json::Material>())]),
    ("meshes", &[(2, size_of::<json::Mesh>() + size_of::<Vec<()>>()), (4, BYTES_PER_PRIMITIVE), (6, BYTES_PER_TARGET)]),
    ("nodes", &[(2, BYTES_PER_NODE)]),
    ("samplers", &[(2, size_of::<json::texture::Sampler>())]),
    // An empty scene gets a member, and its name is in the report, empty or not.
    ("scenes", &[(2, size_of::<json::Scene>() + BYTES_PER_LEAF + ALLOCATION_OVERHEAD + size_of::<String>())]),
    // A skin is in a set of those that are used.
    ("skins", &[(2, size_of::<json::Skin>() + 6 * size_of::<usize>())]),
    ("textures", &[(2, size_of::<json::Texture>())]),
];
/// An accessor is checked, and found again by what it reads.
const BYTES_PER_ACCESSOR: usize = size_of::<json::Accessor>()
    + size_of::<AccessorData>()
    + size_of::<usize>()
    + MAP_OVERHEAD * size_of::<[usize; 24]>();
/// A primitive has a map of attributes, and becomes the source of a geometry.
const BYTES_PER_PRIMITIVE: usize = size_of::<json::mesh::Primitive>()
    + size_of::<BTreeMap<(), ()>>()
    + BYTES_PER_LEAF
    + size_of::<Option<GeometrySource>>()
    + ALLOCATION_OVERHEAD;
const BYTES_PER_TARGET: usize = 4 * size_of::<json::mesh::MorphTarget>();
/// A node has two transforms (its own and that in the scene), a parent, a place in two orders, a mark whether it is a
/// root, and a key in the report.
const BYTES_PER_NODE: usize = size_of::<json::Node>()
    + size_of::<Transform>()
    + size_of::<glam::DAffine3>()
    + size_of::<Option<usize>>()
    + 6 * size_of::<usize>()
    + size_of::<bool>()
    + size_of::<Option<NodeKey>>();

/// An upper bound of the memory that the values and objects of a JSON text take, in bytes; some number above `limit` if
/// it is above that. Counts as far as the text is JSON: the parser will report the error. O(length of the text), and
/// takes no memory itself.
pub(super) fn json_cost(text: &[u8], limit: u64) -> u64 {
    let mut cost = Cost { bytes: 0, limit };
    let root = Measure { cost: &mut cost, typed: &[], depth: 0, in_extensions: false };
    // An error is either that of the parser, or says that the limit is exceeded; the number tells which.
    let _ = root.deserialize(&mut serde_json::Deserializer::from_slice(text));
    cost.bytes
}

/// The sum so far.
struct Cost {
    bytes: u64,
    limit: u64,
}

/// Adds the cost of one value and of everything in it.
struct Measure<'c> {
    cost: &'c mut Cost,
    /// The typed objects in this member of the root, see [`TYPED`].
    typed: &'static [(usize, usize)],
    depth: usize,
    /// Whether the value is in an object of extensions.
    in_extensions: bool,
}

impl Measure<'_> {
    /// Adds bytes; an error, which ends the measuring, if the sum exceeds the limit.
    fn add<E: serde::de::Error>(&mut self, bytes: usize) -> Result<(), E> {
        let halves = if self.in_extensions { EXTENSION_HALVES } else { 2 };
        self.cost.bytes = self.cost.bytes.saturating_add(halves.saturating_mul(bytes as u64) / 2);
        if self.cost.bytes > self.cost.limit { Err(E::custom("above the limit")) } else { Ok(()) }
    }

    /// The measure of a value in this one.
    fn inner(&mut self) -> Measure<'_> {
        Measure { cost: self.cost, typed: self.typed, depth: self.depth + 1, in_extensions: self.in_extensions }
    }

    /// Adds the typed object that a value other than a number becomes.
    fn add_typed<E: serde::de::Error>(&mut self) -> Result<(), E> {
        match self.typed.iter().find(|(depth, _)| *depth == self.depth) {
            Some((_, bytes)) => self.add(*bytes),
            None => Ok(()),
        }
    }
}

impl<'de> DeserializeSeed<'de> for Measure<'_> {
    type Value = ();

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Measure<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("any value")
    }

    fn visit_unit<E: serde::de::Error>(mut self) -> Result<(), E> {
        self.add_typed()
    }

    fn visit_bool<E: serde::de::Error>(mut self, _: bool) -> Result<(), E> {
        self.add_typed()
    }

    fn visit_i64<E: serde::de::Error>(mut self, _: i64) -> Result<(), E> {
        self.add(BYTES_PER_TYPED_NUMBER)
    }

    fn visit_u64<E: serde::de::Error>(mut self, _: u64) -> Result<(), E> {
        self.add(BYTES_PER_TYPED_NUMBER)
    }

    fn visit_f64<E: serde::de::Error>(mut self, _: f64) -> Result<(), E> {
        self.add(BYTES_PER_TYPED_NUMBER)
    }

    fn visit_str<E: serde::de::Error>(mut self, text: &str) -> Result<(), E> {
        self.add(STRING_COPIES * (text.len() + ALLOCATION_OVERHEAD))?;
        self.add_typed()
    }

    fn visit_seq<A: SeqAccess<'de>>(mut self, mut elements: A) -> Result<(), A::Error> {
        self.add_typed()?;
        // Charge for the least capacity once there is an element, and for each element from then on.
        let mut count = 0;
        while elements.next_element_seed(self.inner())?.is_some() {
            count += 1;
            if count == 1 {
                self.add(ALLOCATION_OVERHEAD + MIN_CAPACITY * BYTES_PER_ELEMENT)?;
            } else if count > MIN_CAPACITY {
                self.add(BYTES_PER_ELEMENT)?;
            }
        }
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(mut self, mut members: A) -> Result<(), A::Error> {
        self.add_typed()?;
        let mut count = 0;
        while let Some(key) = members.next_key_seed(Key(&mut self, count))? {
            count += 1;
            let mut inner = self.inner();
            if let KeyKind::Extensions = key {
                inner.in_extensions = true;
            }
            if let KeyKind::Section(typed) = key {
                inner.typed = typed;
            }
            members.next_value_seed(inner)?;
        }
        Ok(())
    }
}

/// Adds the cost of a member of an object but for its value: of its key, and of its place in the object, which has so
/// many members already.
struct Key<'k, 'c>(&'k mut Measure<'c>, usize);

/// What the key of a member says about the value.
enum KeyKind {
    /// It is a member of the root, and has such typed objects in it.
    Section(&'static [(usize, usize)]),
    /// It is an object of extensions of some object.
    Extensions,
    Other,
}

impl<'de> DeserializeSeed<'de> for Key<'_, '_> {
    type Value = KeyKind;

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<KeyKind, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for Key<'_, '_> {
    type Value = KeyKind;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E: serde::de::Error>(self, key: &str) -> Result<KeyKind, E> {
        let Self(object, count) = self;
        object.add(key.len() + ALLOCATION_OVERHEAD)?;
        // Members are in leaves of a tree; the first leaf has room for eleven.
        if count == 0 || count >= MAX_MEMBERS_PER_LEAF && count.is_multiple_of(MIN_MEMBERS_PER_LEAF) {
            object.add(BYTES_PER_LEAF + ALLOCATION_OVERHEAD)?;
        }
        if object.depth == 0 {
            let section = TYPED.iter().find(|(name, _)| *name == key);
            return Ok(section.map_or(KeyKind::Other, |(_, typed)| KeyKind::Section(typed)));
        }
        Ok(if key == "extensions" { KeyKind::Extensions } else { KeyKind::Other })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_object_is_counted() {
        let cost = |text: &str| json_cost(text.as_bytes(), u64::MAX);
        let nodes = |n: usize| cost(&format!("{{\"nodes\":[{}]}}", vec!["{}"; n].join(",")));
        let of_a_node = (BYTES_PER_NODE + BYTES_PER_ELEMENT) as u64;
        assert_eq!(nodes(1004) - nodes(4), 1000 * of_a_node);
        // What is not glTF's counts as JSON does.
        let others = |n: usize| cost(&format!("{{\"what\":[{}]}}", vec!["{}"; n].join(",")));
        assert_eq!(others(1004) - others(4), 1000 * BYTES_PER_ELEMENT as u64);
        // Lights are typed, and what is in the extensions of an object counts more than once.
        let light = cost(r#"{"extensions":{"x":{"lights":[{}]}}}"#) - cost(r#"{"extensionX":{"x":{"lights":[{}]}}}"#);
        assert_eq!(light, size_of::<Option<Light>>() as u64);
        let inside = cost(r#"{"asset":{"extensions":{"x":{"a":1}}}}"#) - cost(r#"{"asset":{"extensions":{}}}"#);
        let outside = cost(r#"{"asset":{"extension5":{"x":{"a":1}}}}"#) - cost(r#"{"asset":{"extension5":{}}}"#);
        assert!((EXTENSION_HALVES * outside / 2).abs_diff(inside) <= 4, "{inside} and {outside}");
    }

    #[test]
    fn measuring_ends_at_the_limit_and_at_errors() {
        let text = format!("[{}]", vec!["{}"; 1_000_000].join(","));
        let cost = json_cost(text.as_bytes(), 10_000);
        assert!(cost > 10_000 && cost < 20_000, "{cost}");
        assert_eq!(json_cost(b"{\"a\": ", u64::MAX), json_cost(b"{\"a\": null}", u64::MAX));
    }
}
