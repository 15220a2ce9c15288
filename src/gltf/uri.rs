//! URIs of buffers and images: data URIs, and files relative to the glTF file.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

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

/// A resolved URI. Equal targets hold equal bytes, however the URIs are spelled.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum UriTarget<'u> {
    /// The part of a data URI after its scheme.
    Data(&'u str),
    /// A file, by its canonical path.
    File(PathBuf),
}

/// Resolves a URI, or returns why it cannot be read. Relative files are looked for in the folder of the glTF file
/// `base`; `..` may lead out of it, as in other importers.
///
/// Absolute paths, percent-encoded or not, and all schemes except `data:` are rejected: an import never accesses the
/// network, nor a file that is not given relative to the glTF file.
pub(super) fn resolve<'u>(uri: &'u str, base: &Path) -> Result<UriTarget<'u>, UriFault> {
    // A data URI holds the bytes itself; any other scheme is refused.
    if let Some(data) = strip_data_scheme(uri) {
        return Ok(UriTarget::Data(data));
    }
    if let Some(scheme) = scheme(uri) {
        return Err(UriFault::Scheme { scheme: scheme.to_owned() });
    }
    // Decode the path; one that is not UTF-8 once decoded is taken as it is written.
    let folder = base.parent().unwrap_or(Path::new(""));
    let decoded = percent_decode_str(uri).decode_utf8().unwrap_or(Cow::Borrowed(uri));
    // `Path::join` with an absolute path would discard the folder, so both spellings are checked.
    for path in [uri, &decoded] {
        check_relative(path)?;
    }
    // Find the canonical path, which is the same however the file is spelled.
    let path = folder.join(decoded.as_ref());
    let canonical = match path.canonicalize() {
        // A file name with a literal "%20" in it is not a valid URI, but some exporters write it.
        Err(e) if e.kind() == io::ErrorKind::NotFound && decoded != uri => {
            folder.join(uri).canonicalize().map_err(|_| e)
        }
        result => result,
    };
    canonical.map(UriTarget::File).map_err(|e| io_fault(&path, &e))
}

impl UriTarget<'_> {
    /// Reads the bytes, at most `limit` of those of a file.
    pub(super) fn read(&self, limit: u64) -> Result<Vec<u8>, UriFault> {
        match self {
            Self::Data(data) => decode_data(data),
            Self::File(path) => read_file(path, limit).map_err(|e| io_fault(path, &e)),
        }
    }
}

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

fn io_fault(path: &Path, error: &io::Error) -> UriFault {
    UriFault::Io { path: path.to_owned(), kind: error.kind(), message: error.to_string() }
}

fn strip_data_scheme(uri: &str) -> Option<&str> {
    let (scheme, rest) = uri.split_at_checked("data:".len())?;
    scheme.eq_ignore_ascii_case("data:").then_some(rest)
}

/// The URI's scheme; a Windows drive ("C:") counts as one.
fn scheme(uri: &str) -> Option<&str> {
    let (scheme, _) = uri.split_once(':')?;
    let is_scheme = scheme.starts_with(|c: char| c.is_ascii_alphabetic())
        && scheme.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'));
    is_scheme.then_some(scheme)
}

/// Rejects absolute paths, drive and share prefixes and NUL bytes, by the rules of all platforms, so that a file
/// imports the same everywhere.
fn check_relative(path: &str) -> Result<(), UriFault> {
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
fn decode_data(data: &str) -> Result<Vec<u8>, UriFault> {
    let (kind, payload) = data.split_once(',').ok_or(UriFault::NoComma)?;
    let payload: Cow<'_, [u8]> = percent_decode_str(payload).into();
    if !kind.to_ascii_lowercase().ends_with(";base64") {
        return Ok(payload.into_owned());
    }
    BASE64.decode(payload).map_err(|e| UriFault::Base64(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(uri: &str, base: &Path, limit: u64) -> Result<Vec<u8>, UriFault> {
        resolve(uri, base)?.read(limit)
    }

    fn read_here(uri: &str) -> Result<Vec<u8>, UriFault> {
        read(uri, Path::new("/nowhere/file.gltf"), u64::MAX)
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
    }

    #[test]
    fn schemes_and_absolute_paths_are_refused() {
        for uri in ["http://host/a.bin", "file:///etc/hosts", "C:\\a.bin", "/etc/hosts", "\\\\host\\a", "//host/a"] {
            let fault = read_here(uri).unwrap_err();
            assert!(matches!(fault, UriFault::Scheme { .. } | UriFault::AbsolutePath { .. }), "{uri}: {fault}");
        }
    }

    #[test]
    fn an_encoded_absolute_path_is_refused_too() {
        let folder = tempfile::tempdir().unwrap();
        let base = folder.path().join("sub").join("scene.gltf");
        std::fs::create_dir(folder.path().join("sub")).unwrap();
        let outside = folder.path().join("outside.bin");
        std::fs::write(&outside, "").unwrap();
        // A file that is there, so that only a refusal keeps it from being read.
        let path = outside.to_str().unwrap();
        let encoded = path.replace('/', "%2F").replace('\\', "%5C").replace(':', "%3A");
        let first_encoded = format!("%{:02X}{}", path.as_bytes()[0], &path[1..]);
        for uri in [path, &encoded, &first_encoded, "%2Fetc%2Fpasswd", "C%3A\\a.bin", "%43:a.bin", "%5C%5Chost%5Ca"] {
            let fault = resolve(uri, &base).unwrap_err();
            assert!(matches!(fault, UriFault::Scheme { .. } | UriFault::AbsolutePath { .. }), "{uri}: {fault}");
        }
        assert_eq!(resolve("a%00.bin", &base), Err(UriFault::NulByte));
        assert!(resolve("../outside.bin", &base).is_ok());
    }

    #[test]
    fn spellings_of_one_file_are_one_location() {
        let folder = tempfile::tempdir().unwrap();
        let base = folder.path().join("scene.gltf");
        std::fs::write(folder.path().join("a.bin"), "").unwrap();
        std::fs::create_dir(folder.path().join("sub")).unwrap();
        for uri in ["./a.bin", "././a.bin", "sub/../a.bin", "%61.bin"] {
            assert_eq!(resolve(uri, &base), resolve("a.bin", &base), "{uri}");
        }
    }

    #[test]
    fn files_with_spaces_and_percent_signs_are_found() {
        let folder = tempfile::tempdir().unwrap();
        let base = folder.path().join("scene.gltf");
        for name in ["a b.bin", "\u{2764}.bin", "c%20d.bin"] {
            std::fs::write(folder.path().join(name), name).unwrap();
        }
        for (uri, name) in [
            ("a%20b.bin", "a b.bin"),
            ("a b.bin", "a b.bin"),
            ("%E2%9D%A4.bin", "\u{2764}.bin"),
            ("c%20d.bin", "c%20d.bin"),
        ] {
            assert_eq!(read(uri, &base, u64::MAX).unwrap(), name.as_bytes(), "{uri}");
        }
        assert_eq!(read("a b.bin", &base, 2).unwrap(), b"a ");
        let Err(UriFault::Io { kind, message, .. }) = read(".", &base, u64::MAX) else { panic!("reads a folder") };
        assert!(kind == io::ErrorKind::InvalidInput && message.contains("regular file"), "{kind:?}: {message}");
    }
}
