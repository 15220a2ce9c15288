//! From JSON to the crate's types, with errors in the words of glTF: which member of which object is missing, or is
//! something else than it must be.

use std::path::Path;

use serde::Deserialize;
use serde_json::Value;
use serde_path_to_error::Segment;

use super::references::push_key;
use super::{ContainerFault, GltfFault, error_at};
use crate::{Error, Result};

/// Why a JSON value is not an object of the expected type.
pub(super) struct SchemaFault {
    /// The keys that lead from the value to the offending part of it.
    pub(super) keys: Vec<String>,
    cause: GltfFault,
}

/// The value as an object of type `T`.
pub(super) fn parse<T: for<'de> Deserialize<'de>>(value: &Value) -> Result<T, SchemaFault> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let keys: Vec<String> = error.path().iter().filter_map(key_of).collect();
        let found = keys.iter().try_fold(value, |value, key| match value {
            Value::Array(elements) => elements.get(key.parse::<usize>().ok()?),
            value => value.get(key),
        });
        SchemaFault { keys, cause: fault_of(&error.inner().to_string(), found) }
    })
}

/// As [`parse`], for an object: serde would take an array for one too.
pub(super) fn parse_object<T: for<'de> Deserialize<'de>>(value: &Value) -> Result<T, SchemaFault> {
    if value.is_object() {
        return parse(value);
    }
    let cause = GltfFault::WrongType { found: describe(value), expected: "an object".to_owned() };
    Err(SchemaFault { keys: Vec::new(), cause })
}

impl SchemaFault {
    /// The error, for the value at `pointer`.
    pub(super) fn error_at(self, path: &Path, pointer: &str) -> Error {
        let mut pointer = pointer.to_owned();
        self.keys.iter().for_each(|key| push_key(&mut pointer, key));
        error_at(path, pointer, self.cause)
    }
}

/// Why a text is not JSON, by the parser's error.
pub(super) fn json_fault(text: &[u8], error: &serde_json::Error) -> GltfFault {
    let line = error.line();
    if let Err(utf8) = std::str::from_utf8(text) {
        // What does not even begin as an object is no text at all.
        if let Some((first_bytes, _)) = text.split_first_chunk().filter(|_| !text.trim_ascii_start().starts_with(b"{"))
        {
            return ContainerFault::Binary { first_bytes: *first_bytes }.into();
        }
        return GltfFault::Json(format!("byte {} is not UTF-8 text", utf8.valid_up_to()));
    }
    let message = error.to_string();
    if message.starts_with("recursion limit") {
        return GltfFault::TooDeep { max_depth: MAX_DEPTH };
    }
    if error.is_eof() {
        return GltfFault::Json(format!("the text ends in line {line}, before its last bracket: is it cut short?"));
    }
    GltfFault::Json(message)
}

/// The nesting that the parser allows.
const MAX_DEPTH: usize = 127;

fn key_of(segment: &Segment) -> Option<String> {
    match segment {
        Segment::Seq { index } => Some(index.to_string()),
        Segment::Map { key } => Some(key.clone()),
        Segment::Enum { .. } | Segment::Unknown => None,
    }
}

/// The fault that a message of serde is about. `found` is the offending value.
fn fault_of(message: &str, found: Option<&Value>) -> GltfFault {
    if let Some(member) = message.strip_prefix("missing field `").and_then(|rest| rest.split('`').next()) {
        return GltfFault::MissingMember { member: member.to_owned() };
    }
    let expected = message.split_once(", expected ").map_or("", |(_, expected)| expected);
    let expected = match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more".to_owned(),
        "i8" | "i16" | "i32" | "i64" => "a whole number".to_owned(),
        "f32" | "f64" => "a number".to_owned(),
        "a boolean" => "true or false".to_owned(),
        "a string" | "a borrowed string" => "a string".to_owned(),
        "a sequence" => "an array".to_owned(),
        "a map" => "an object".to_owned(),
        _ if expected.starts_with("struct ") => "an object".to_owned(),
        "index into child of root" => "an index".to_owned(),
        _ => match expected.split_once(": ") {
            // The values of an enumeration, as a list.
            Some(("any of", values)) => format!("one of {}", values.trim_matches(['[', ']'])),
            _ => match expected.strip_prefix("an array of length ").or(expected.strip_prefix("an array of size ")) {
                Some(length) => format!("an array of {length}"),
                None => "as the specification says".to_owned(),
            },
        },
    };
    GltfFault::WrongType { found: found.map_or_else(|| "missing".to_owned(), describe), expected }
}

/// A JSON value in words, of limited length.
pub(super) fn describe(value: &Value) -> String {
    match value {
        Value::Null | Value::Bool(_) | Value::Number(_) => value.to_string(),
        Value::String(text) if text.chars().nth(40).is_none() => format!("the string \"{text}\""),
        Value::String(_) => "a string".to_owned(),
        Value::Array(elements) => format!("an array of {}", elements.len()),
        Value::Object(_) => "an object".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::gltf::json;
    use serde_json::json;

    fn fault<T: for<'de> Deserialize<'de>>(value: &Value) -> String {
        let Err(fault) = parse_object::<T>(value) else { panic!("{value} is of the type") };
        fault.error_at(Path::new("a.gltf"), "/x/0").to_string()
    }

    #[test]
    fn errors_name_the_innermost_member_in_words_of_gltf() {
        let mesh = json!({"primitives": [{"attributes": {}}, {"mode": 4}]});
        assert_eq!(fault::<json::Mesh>(&mesh), "a.gltf: /x/0/primitives/1: has no attributes, which glTF requires");
        let camera = json!({"type": "perspective", "perspective": {"yfov": "wide", "znear": 1}});
        assert_eq!(
            fault::<json::Camera>(&camera),
            "a.gltf: /x/0/perspective/yfov: is the string \"wide\", but must be a number"
        );
        let accessor = json!({"componentType": 5126, "type": "VEC3", "count": -1});
        assert_eq!(
            fault::<json::Accessor>(&accessor),
            "a.gltf: /x/0/count: is -1, but must be a whole number, 0 or more"
        );
        let transform = json!({"extensions": {"KHR_texture_transform": {"scale": [1]}}, "index": 0});
        assert_eq!(
            fault::<json::texture::Info>(&transform),
            "a.gltf: /x/0/extensions/KHR_texture_transform/scale: is an array of 1, but must be an array of 2"
        );
        let transform = json!({"extensions": {"KHR_texture_transform": 3}, "index": 0});
        assert_eq!(
            fault::<json::texture::Info>(&transform),
            "a.gltf: /x/0/extensions/KHR_texture_transform: is 3, but must be an object"
        );
        let material = json!({"alphaMode": 1});
        assert_eq!(
            fault::<json::Material>(&material),
            "a.gltf: /x/0/alphaMode: is 1, but must be one of \"OPAQUE\", \"MASK\", \"BLEND\""
        );
        assert_eq!(fault::<json::Node>(&json!([])), "a.gltf: /x/0: is an array of 0, but must be an object");
        assert_eq!(fault::<json::Node>(&json!({"name": 1})), "a.gltf: /x/0/name: is 1, but must be a string");
    }

    #[test]
    fn text_that_is_no_json_is_told_in_words() {
        let fault = |text: &[u8]| json_fault(text, &serde_json::from_slice::<Value>(text).unwrap_err()).to_string();
        assert_eq!(fault(b"{\"a\": \"\xE9\"}"), "is not valid JSON: byte 7 is not UTF-8 text");
        assert!(fault(b"%\xCC0\xFF\xFF\xFF").starts_with("is binary data"));
        assert_eq!(fault(&b"[".repeat(200)), "is nested deeper than the 127 levels that are read");
        assert!(fault(b"{\"a\":\n[1, 2").contains("ends in line 2"));
        let deepest = [b"[".repeat(MAX_DEPTH), b"]".repeat(MAX_DEPTH)].concat();
        assert!(serde_json::from_slice::<Value>(&deepest).is_ok());
    }
}
