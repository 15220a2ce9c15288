//! The two containers of glTF: plain JSON (`.gltf`), and GLB (`.glb`), which carries JSON and one binary chunk.

use std::path::Path;

use super::error_at;
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
    /// Tells the container by its magic number, not by the file's name. O(chunks).
    pub(super) fn parse(bytes: &'a [u8], path: &Path) -> Result<Self> {
        let parts = if bytes.starts_with(MAGIC) { Self::parse_glb(bytes) } else { Ok(Self { json: bytes, bin: None }) };
        let mut parts = parts.map_err(|cause| error_at(path, "", cause))?;
        parts.json = parts.json.strip_prefix(BYTE_ORDER_MARK).unwrap_or(parts.json);
        if parts.json.is_empty() {
            return Err(error_at(path, "", "there is no JSON in it: neither a glTF nor a GLB file"));
        }
        Ok(parts)
    }

    fn parse_glb(bytes: &'a [u8]) -> Result<Self, String> {
        let (Some(version), Some(length)) = (read_u32(bytes, 4), read_u32(bytes, 8)) else {
            return Err("the GLB header is cut short".into());
        };
        if version != 2 {
            return Err(format!("is GLB version {version}; only version 2 is known"));
        }
        // What follows the declared length is not part of the file; the glTF validator only warns of it.
        let bytes = bytes.get(..length as usize).ok_or_else(|| {
            format!("the GLB header says {length} bytes, but the file has {}: was the download cut short?", bytes.len())
        })?;
        let (mut json, mut bin) = (None, None);
        let mut rest = bytes.get(HEADER_BYTES..).ok_or("the GLB length is shorter than its own header")?;

        while !rest.is_empty() {
            let (kind, data, after) = split_chunk(rest)?;
            let slot = match kind {
                JSON_CHUNK => &mut json,
                BIN_CHUNK => &mut bin,
                // Chunks of other kinds are to be ignored, but never before the JSON chunk.
                _ if json.is_some() => {
                    rest = after;
                    continue;
                }
                _ => return Err("the first GLB chunk is not JSON".into()),
            };
            if slot.replace(data).is_some() {
                return Err("a GLB chunk of the same kind appears twice".into());
            }
            if json.is_none() {
                return Err("the first GLB chunk is not JSON".into());
            }
            rest = after;
        }
        Ok(Self { json: json.ok_or("the GLB file has no JSON chunk")?, bin })
    }
}

/// The first chunk's kind and data, and what comes after it.
fn split_chunk(bytes: &[u8]) -> Result<(u32, &[u8], &[u8]), String> {
    let (Some(length), Some(kind)) = (read_u32(bytes, 0), read_u32(bytes, 4)) else {
        return Err("a GLB chunk header is cut short".into());
    };
    let body = &bytes[CHUNK_HEADER_BYTES..];
    if length as usize > body.len() {
        return Err(format!("a GLB chunk says {length} bytes, but only {} are left", body.len()));
    }
    let (data, after) = body.split_at(length as usize);
    Ok((kind, data, after))
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
