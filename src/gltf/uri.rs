//! The parts of URIs, data URIs, and the reading of files.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path};

use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use percent_encoding::percent_decode_str;

use super::UriFault;

/// Base64 as exporters write it: with padding or without.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// A whole regular file, or its first `limit` bytes. A device or a pipe, which might have no end, is refused unread.
pub(super) fn read_file(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let metadata = std::fs::metadata(path)?;
    if !metadata.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "is not a regular file"));
    }
    let mut bytes = Vec::with_capacity(usize::try_from(metadata.len().min(limit)).unwrap_or(0));
    File::open(path)?.take(limit).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The part of a data URI after its scheme; `None` for any other URI.
pub(super) fn strip_data_scheme(uri: &str) -> Option<&str> {
    let (scheme, rest) = uri.split_at_checked("data:".len())?;
    scheme.eq_ignore_ascii_case("data:").then_some(rest)
}

/// The URI's scheme; a Windows drive ("C:") counts as one.
pub(super) fn scheme(uri: &str) -> Option<&str> {
    let (scheme, _) = uri.split_once(':')?;
    let is_scheme = scheme.starts_with(|c: char| c.is_ascii_alphabetic())
        && scheme.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'));
    is_scheme.then_some(scheme)
}

/// Rejects absolute paths, drive and share prefixes and NUL bytes, by the rules of all platforms, so that a file
/// imports the same everywhere.
pub(super) fn check_relative(path: &str) -> Result<(), UriFault> {
    // `Path` knows the rules of this platform only: drives and backslashes are checked by hand.
    let is_anchor = |part| matches!(part, Component::Prefix(_) | Component::RootDir);
    let has_drive = matches!(path.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic());
    if path.starts_with(['/', '\\']) || has_drive || Path::new(path).components().any(is_anchor) {
        return Err(UriFault::AbsolutePath { path: path.to_owned() });
    }
    if path.contains('\0') {
        return Err(UriFault::NulByte);
    }
    Ok(())
}

/// RFC 2397: `[mime type][;base64],payload`. The MIME type is ignored: the format of images is detected from their
/// first bytes.
pub(super) fn decode_data(data: &str) -> Result<Vec<u8>, UriFault> {
    let (kind, payload) = data.split_once(',').ok_or(UriFault::NoComma)?;
    let mut payload: Cow<'_, [u8]> = percent_decode_str(payload).into();
    if !kind.to_ascii_lowercase().ends_with(";base64") {
        return Ok(payload.into_owned());
    }
    if has_odd_spelling(&payload) {
        // In place, so that there is one copy of the text at most.
        payload.to_mut().retain_mut(|byte| plain_letter(*byte).map(|plain| *byte = plain).is_some());
    }
    BASE64.decode(payload).map_err(|e| UriFault::Base64(e.to_string()))
}

/// How a URI is spelled against the rules, although it can be read.
pub(super) fn spelling_fault(uri: &str) -> Option<UriFault> {
    let (kind, payload) = strip_data_scheme(uri)?.split_once(',')?;
    let payload: Cow<'_, [u8]> = percent_decode_str(payload).into();
    let is_odd = kind.to_ascii_lowercase().ends_with(";base64") && has_odd_spelling(&payload);
    is_odd.then_some(UriFault::Base64Spelling)
}

/// Whether base64 text has white space in it, or the letters of URLs.
fn has_odd_spelling(base64: &[u8]) -> bool {
    base64.iter().any(|&byte| plain_letter(byte) != Some(byte))
}

/// A letter of base64 as RFC 4648 has it in the standard alphabet; `None` for white space, which is left out.
fn plain_letter(byte: u8) -> Option<u8> {
    match byte {
        b'-' => Some(b'+'),
        b'_' => Some(b'/'),
        byte => (!byte.is_ascii_whitespace()).then_some(byte),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_here(uri: &str) -> Result<Vec<u8>, UriFault> {
        decode_data(strip_data_scheme(uri).unwrap())
    }

    #[test]
    fn data_uris_in_all_spellings() {
        for uri in ["data:;base64,AQL/", "DATA:application/octet-stream;BASE64,AQL%2F", "data:,%01%02%FF"] {
            assert_eq!(read_here(uri).unwrap(), [1, 2, 255], "{uri}");
        }
        assert_eq!(read_here("data:;base64,AQI=").unwrap(), [1, 2]);
        assert_eq!(read_here("data:;base64,AQI").unwrap(), [1, 2]);
        assert_eq!(read_here("data:,abc").unwrap(), b"abc");
        assert_eq!(read_here("data:abc"), Err(UriFault::NoComma));
        assert!(matches!(read_here("data:;base64,A*=="), Err(UriFault::Base64(_))));
        // 0xFB 0xFF is "+/8=" in the standard alphabet.
        for uri in ["data:;base64,-_8=", "data:;base64,-_8", "data:;base64, +/\r\n8=\n", "data:;base64,+/%0A8="] {
            assert_eq!(read_here(uri).unwrap(), [0xFB, 0xFF], "{uri}");
            assert_eq!(spelling_fault(uri), Some(UriFault::Base64Spelling), "{uri}");
        }
        assert_eq!(spelling_fault("data:;base64,+/8="), None);
        assert_eq!(spelling_fault("data:,-_ "), None);
        assert_eq!(spelling_fault("a-b_c.bin"), None);
    }
}
