//! The two containers of glTF: plain JSON (`.gltf`), and GLB (`.glb`), which carries JSON and one binary chunk.

use std::path::Path;

use serde_json::Value;

use super::warnings::Warnings;
use super::{ContainerFault, error_at};
use crate::Result;

const MAGIC: &[u8; 4] = b"glTF";
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;
const JSON_CHUNK: u32 = u32::from_le_bytes(*b"JSON");
const BIN_CHUNK: u32 = u32::from_le_bytes(*b"BIN\0");
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

/// The parts of a file, borrowed from its bytes.
pub(super) struct Container<'a> {
    /// The JSON text.
    pub(super) json: &'a [u8],
    /// The binary chunk of a GLB file: the data of buffer 0.
    pub(super) bin: Option<&'a [u8]>,
}

impl<'a> Container<'a> {
    /// Splits a file into its parts. GLB is detected by its magic number, not by the file extension. O(chunks).
    pub(super) fn parse(bytes: &'a [u8], path: &Path, warnings: &mut Warnings) -> Result<Self> {
        // Split a GLB file into its chunks; any other file is JSON as a whole.
        let parts = if bytes.starts_with(MAGIC) { Self::parse_glb(bytes) } else { Ok(Self { json: bytes, bin: None }) };
        let mut parts = parts.map_err(|cause| error_at(path, "", cause))?;
        // Drop a byte order mark: glTF forbids it, but it does no harm.
        parts.json = parts.json.strip_prefix(BYTE_ORDER_MARK).unwrap_or(parts.json);
        // Drop NUL bytes after the text, with which some exporters fill the chunk.
        let padding = parts.json.iter().rev().take_while(|byte| **byte == 0).count();
        let text = &parts.json[..parts.json.len() - padding];
        if let Some(fault) = not_text(text) {
            return Err(error_at(path, "", fault));
        }
        if padding > 0 {
            let error = error_at(path, "", ContainerFault::NulPadding);
            warnings.forgive(&Value::Null, "JSON chunk", "it ends in NUL bytes instead of spaces: left out", error)?;
            parts.json = text;
        }
        if parts.json.is_empty() {
            return Err(error_at(path, "", ContainerFault::NoJson));
        }
        Ok(parts)
    }

    fn parse_glb(bytes: &'a [u8]) -> Result<Self, ContainerFault> {
        // 1. Check the header: magic number, version, length.
        let (Some(version), Some(declared)) = (read_u32(bytes, 4), read_u32(bytes, 8)) else {
            return Err(ContainerFault::TruncatedHeader);
        };
        if version != 2 {
            return Err(ContainerFault::Version { found: version });
        }
        // Bytes after the declared length are not part of the file; the glTF validator only warns of them.
        let truncated = ContainerFault::TruncatedFile { declared, found: bytes.len() };
        let bytes = bytes.get(..declared as usize).ok_or(truncated)?;
        let mut rest = bytes.get(HEADER_BYTES..).ok_or(ContainerFault::LengthBelowHeader)?;

        // 2. Find the JSON chunk, which comes first, and the binary chunk.
        let (mut json, mut bin) = (None, None);
        while !rest.is_empty() {
            let (kind, data, after) = split_chunk(rest)?;
            rest = after;
            let chunk = match kind {
                JSON_CHUNK => &mut json,
                BIN_CHUNK => &mut bin,
                // Chunks of other kinds are ignored, but cannot precede the JSON chunk.
                _ if json.is_some() => continue,
                _ => return Err(ContainerFault::FirstChunkNotJson),
            };
            if chunk.replace(data).is_some() {
                return Err(ContainerFault::DuplicateChunk);
            }
            if json.is_none() {
                return Err(ContainerFault::FirstChunkNotJson);
            }
        }
        Ok(Self { json: json.ok_or(ContainerFault::NoJsonChunk)?, bin })
    }
}

/// Why the bytes cannot be JSON text in UTF-8, as far as the first of them tell.
fn not_text(bytes: &[u8]) -> Option<ContainerFault> {
    match bytes {
        // With a byte order mark, or an ASCII character in two bytes.
        [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] | [0, b'\t'..=b'~', ..] | [b'\t'..=b'~', 0, ..] => {
            Some(ContainerFault::Utf16)
        }
        // A control character, or a byte that begins no character: text has neither.
        [first, second, third, fourth, ..]
            if bytes[..4].iter().any(|byte| byte.is_ascii_control() && !byte.is_ascii_whitespace())
                || matches!(first, 0x80..=0xC1 | 0xF5..) =>
        {
            Some(ContainerFault::Binary { first_bytes: [*first, *second, *third, *fourth] })
        }
        _ => None,
    }
}

/// The first chunk's kind and data, and the bytes after it.
fn split_chunk(bytes: &[u8]) -> Result<(u32, &[u8], &[u8]), ContainerFault> {
    let (Some(declared), Some(kind)) = (read_u32(bytes, 0), read_u32(bytes, 4)) else {
        return Err(ContainerFault::TruncatedChunkHeader);
    };
    let body = &bytes[CHUNK_HEADER_BYTES..];
    match body.split_at_checked(declared as usize) {
        Some((data, after)) => Ok((kind, data, after)),
        None => Err(ContainerFault::TruncatedChunk { declared, found: body.len() }),
    }
}

/// The little-endian word at a byte offset.
fn read_u32(bytes: &[u8], offset: usize) -> Option<u32> {
    bytes.get(offset..offset + 4)?.try_into().ok().map(u32::from_le_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glb(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
        let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        for (kind, data) in chunks {
            bytes.extend((data.len() as u32).to_le_bytes());
            bytes.extend(*kind);
            bytes.extend(*data);
        }
        let length = bytes.len() as u32;
        bytes[8..12].copy_from_slice(&length.to_le_bytes());
        bytes
    }

    #[test]
    fn glb_parts_are_found_and_unknown_chunks_ignored() {
        let bytes = glb(&[(b"JSON", b"{}  "), (b"BIN\0", b"abcd"), (b"what", b"zzzz")]);
        let parts = Container::parse(&bytes, Path::new("a.glb"), &mut Warnings::new(false)).unwrap();
        assert_eq!((parts.json, parts.bin), (&b"{}  "[..], Some(&b"abcd"[..])));
    }

    #[test]
    fn text_that_is_not_utf8_and_binary_data_are_told_apart() {
        let fault = |bytes: &[u8]| {
            let result = Container::parse(bytes, Path::new("a.gltf"), &mut Warnings::new(false));
            result.err().map(|error| error.to_string())
        };
        let utf16 =
            |to_bytes: fn(u16) -> [u8; 2], text: &str| text.encode_utf16().flat_map(to_bytes).collect::<Vec<_>>();
        for text in ["{\"asset\": {}}", "\u{feff}{}"] {
            for bytes in [utf16(u16::to_le_bytes, text), utf16(u16::to_be_bytes, text)] {
                assert!(fault(&bytes).unwrap().contains("UTF-16"), "{bytes:?}");
            }
        }
        let png = fault(b"\x89PNG\r\n\x1a\n").unwrap();
        assert_eq!(png, "a.gltf: the file: is binary data, neither JSON text nor GLB: it begins with \"\\x89PNG\"");
        assert!(fault(b"\0\0\0\0\x01").unwrap().contains("binary data"));
        for text in ["{}", " \r\n\t{}", "{\"\u{f6}\": 1}", "\u{feff}{}", "{}\0\0", "{}\0"] {
            assert_eq!(fault(text.as_bytes()), None, "{text:?}");
        }
    }

    #[test]
    fn every_truncation_of_a_glb_is_an_error() {
        let bytes = glb(&[(b"JSON", b"{}  "), (b"BIN\0", b"abcd")]);
        for length in 4..bytes.len() {
            assert!(
                Container::parse(&bytes[..length], Path::new("a.glb"), &mut Warnings::new(false)).is_err(),
                "{length} bytes"
            );
        }
    }
}
