//! Where the bytes of a buffer or an image are: in a data URI, or in a file near the glTF file.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};

use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use percent_encoding::percent_decode_str;

/// Base64 as exporters write it: with padding or without.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// Where a URI leads to. Equal locations hold equal bytes, however they are spelled.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum UriTarget<'u> {
    /// The part of a data URI after its scheme.
    Data(&'u str),
    /// A file, by its canonical path.
    File(PathBuf),
}

/// Where `uri` leads to, or why nowhere.
///
/// A relative URI is a file, looked for from the folder of the glTF file `base`; `..` may lead out of it, as in other importers.
/// Absolute paths, percent-encoded or not, and every scheme but `data:` are refused: an import reads no network, and names no place on the
/// machine that its file does not lead to step by step.
pub(super) fn resolve<'u>(uri: &'u str, base: &Path) -> Result<UriTarget<'u>, String> {
    if let Some(data) = strip_data_scheme(uri) {
        return Ok(UriTarget::Data(data));
    }
    if let Some(scheme) = scheme(uri) {
        return Err(format!("the URI scheme \"{scheme}:\" is not supported: only data: and relative files are"));
    }
    let folder = base.parent().unwrap_or(Path::new(""));
    let decoded = percent_decode_str(uri).decode_utf8().unwrap_or(Cow::Borrowed(uri));
    // Both are joined to the folder below, which an absolute path would replace.
    for path in [uri, &decoded] {
        check_relative(path)?;
    }
    let path = folder.join(decoded.as_ref());
    let canonical = match path.canonicalize() {
        // A name with a literal "%20" in it is not valid as a URI, but is written all the same.
        Err(e) if e.kind() == io::ErrorKind::NotFound && decoded != uri => {
            folder.join(uri).canonicalize().map_err(|_| e)
        }
        result => result,
    };
    canonical.map(UriTarget::File).map_err(|e| describe(&path, &e))
}

impl UriTarget<'_> {
    /// The bytes there, at most `limit` of those of a file; or why there are none.
    pub(super) fn read(&self, limit: u64) -> Result<Vec<u8>, String> {
        match self {
            Self::Data(data) => decode_data(data),
            Self::File(path) => read_file(path, limit).map_err(|e| describe(path, &e)),
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

fn describe(path: &Path, error: &io::Error) -> String {
    format!("the external file {} cannot be read: {error}", path.display())
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

/// Refuses absolute paths, those with a drive or a share, and those that no system takes. On every system alike: what one calls absolute
/// is no name to rely on elsewhere.
fn check_relative(path: &str) -> Result<(), String> {
    let is_anchor = |part| matches!(part, Component::Prefix(_) | Component::RootDir);
    let has_drive = matches!(path.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic());
    if path.starts_with(['/', '\\']) || has_drive || Path::new(path).components().any(is_anchor) {
        return Err(format!("{path} is an absolute path: only paths relative to the glTF file are read"));
    }
    if path.contains('\0') {
        return Err("the URI has a NUL byte in it, which no file name has".into());
    }
    Ok(())
}

/// RFC 2397: `[mime type][;base64],payload`. The MIME type is ignored; images are told by their first bytes.
fn decode_data(data: &str) -> Result<Vec<u8>, String> {
    let (kind, payload) = data.split_once(',').ok_or("the data URI has no comma, hence no data")?;
    let payload: Cow<'_, [u8]> = percent_decode_str(payload).into();
    if !kind.to_ascii_lowercase().ends_with(";base64") {
        return Ok(payload.into_owned());
    }
    BASE64.decode(payload).map_err(|e| format!("the data URI is not valid base64: {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(uri: &str, base: &Path, limit: u64) -> Result<Vec<u8>, String> {
        resolve(uri, base)?.read(limit)
    }

    fn read_here(uri: &str) -> Result<Vec<u8>, String> {
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
        assert!(read_here("data:abc").unwrap_err().contains("comma"));
        assert!(read_here("data:;base64,A*==").unwrap_err().contains("base64"));
    }

    #[test]
    fn schemes_and_absolute_paths_are_refused() {
        for uri in ["http://host/a.bin", "file:///etc/hosts", "C:\\a.bin", "/etc/hosts", "\\\\host\\a", "//host/a"] {
            let cause = read_here(uri).unwrap_err();
            assert!(cause.contains("not supported") || cause.contains("absolute"), "{uri}: {cause}");
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
            let cause = resolve(uri, &base).unwrap_err();
            assert!(cause.contains("not supported") || cause.contains("absolute"), "{uri}: {cause}");
        }
        assert!(resolve("a%00.bin", &base).unwrap_err().contains("NUL"));
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
        assert!(read(".", &base, u64::MAX).unwrap_err().contains("regular file"));
    }
}
