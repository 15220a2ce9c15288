//! The two containers of glTF: plain JSON (`.gltf`), and GLB (`.glb`), which carries JSON and one binary chunk.

use std::path::Path;

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
    pub(super) fn parse(bytes: &'a [u8], path: &Path) -> Result<Self> {
        // Split a GLB file into its chunks; any other file is JSON as a whole.
        let parts = if bytes.starts_with(MAGIC) { Self::parse_glb(bytes) } else { Ok(Self { json: bytes, bin: None }) };
        let mut parts = parts.map_err(|cause| error_at(path, "", cause))?;
        // Drop a byte order mark: glTF forbids it, but it does no harm.
        parts.json = parts.json.strip_prefix(BYTE_ORDER_MARK).unwrap_or(parts.json);
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
        let parts = Container::parse(&bytes, Path::new("a.glb")).unwrap();
        assert_eq!((parts.json, parts.bin), (&b"{}  "[..], Some(&b"abcd"[..])));
    }

    #[test]
    fn every_truncation_of_a_glb_is_an_error() {
        let bytes = glb(&[(b"JSON", b"{}  "), (b"BIN\0", b"abcd")]);
        for length in 4..bytes.len() {
            assert!(Container::parse(&bytes[..length], Path::new("a.glb")).is_err(), "{length} bytes");
        }
    }
}
