//! External buffers and images: which files an import may read, and the reading.

use std::borrow::Cow;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use percent_encoding::percent_decode_str;

use super::uri::{check_relative, decode_data, read_file, scheme, strip_data_scheme};
use super::{FileRule, UriFault};

/// Which external files (buffers and images that a glTF file names by URI) an import may read.
///
/// A glTF file can name any file that the program can read, by `..` or through a symbolic link. What it names ends in
/// a scene, and in an image of that scene; so whoever sends the file and sees the image can learn what is on the disk.
/// How to decide:
///
/// - **The file comes from somebody else** (a download, an upload): the default. A folder of its own for each
///   download, with nothing else in it, is best.
/// - **The file has no folder** (its bytes come from the network or a database, and its path is only a name):
///   `FilePolicy::below([])`, with which no file is read, or a resolver. By default the files beside that path would
///   be read, which for a bare name is the current folder.
/// - **A library of assets that share textures** (`../textures/wood.png`): [`below`](Self::below) its topmost folder.
/// - **An archive, a pak, the network**: a [`resolver`](Self::resolver), which gets every URI but `data:` and returns
///   the bytes.
///
/// Under the first two policies only relative URIs are read; absolute paths and other schemes than `data:` are refused.
/// A path is judged after `..` and symbolic links are resolved. What is not guarded against is a program that
/// exchanges files for links while an import runs.
///
/// ```
/// use ropewalk::gltf::{self, FilePolicy, ImportOptions};
/// use ropewalk::Scene;
///
/// // The files of an archive, by their names.
/// let archive = std::collections::HashMap::from([("tri.bin".to_owned(), vec![0; 36])]);
/// let files = FilePolicy::resolver(move |request| {
///     archive.get(request.decoded_uri).cloned().ok_or_else(|| std::io::ErrorKind::NotFound.into())
/// });
///
/// let text = br#"{"asset": {"version": "2.0"}, "buffers": [{"uri": "tri.bin", "byteLength": 36}]}"#;
/// let mut scene = Scene::new();
/// let root = scene.root();
/// let options = ImportOptions::default().with_files(files);
/// gltf::import_from_slice(text, "in the archive.gltf".as_ref(), &options, &mut scene, root)?;
/// # Ok::<(), ropewalk::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum FilePolicy {
    /// Files in the folder of the glTF file, and in the folders in it.
    #[default]
    OwnFolder,
    /// Files anywhere below one of these folders; with none of them, no file. The glTF file's own folder counts only if
    /// it is below one too. Relative folders start at the current folder; one that does not exist has nothing below it.
    Below(Vec<PathBuf>),
    /// The bytes come from the application.
    Resolver(FileResolver),
}

impl FilePolicy {
    /// The policy [`Below`](Self::Below) for some folders.
    pub fn below<P: Into<PathBuf>>(folders: impl IntoIterator<Item = P>) -> Self {
        Self::Below(folders.into_iter().map(Into::into).collect())
    }

    /// The policy [`Resolver`](Self::Resolver) for a function of the application, see [`FileResolver`].
    pub fn resolver(resolve: impl Fn(&FileRequest) -> io::Result<Vec<u8>> + Send + Sync + 'static) -> Self {
        Self::Resolver(FileResolver::new(resolve))
    }
}

/// A function of the application that returns the bytes of external files, instead of the file system.
///
/// It is called on the thread that imports, once or more for each URI, and may block. An error fails the import if the
/// file is a buffer; an image is replaced by a checkerboard, with a warning. The text of the error becomes part of that
/// message. Two resolvers are equal if one is a clone of the other.
#[derive(Clone)]
pub struct FileResolver(Arc<ResolveFunction>);

type ResolveFunction = dyn Fn(&FileRequest) -> io::Result<Vec<u8>> + Send + Sync;

impl FileResolver {
    /// A resolver that calls a function.
    pub fn new(resolve: impl Fn(&FileRequest) -> io::Result<Vec<u8>> + Send + Sync + 'static) -> Self {
        Self(Arc::new(resolve))
    }
}

impl fmt::Debug for FileResolver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FileResolver").finish_non_exhaustive()
    }
}

impl PartialEq for FileResolver {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Eq for FileResolver {}

/// What a [`FileResolver`] is asked for.
///
/// Nothing is checked before: the URI may be absolute, have any scheme but `data:`, and lead anywhere by `..`.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct FileRequest<'a> {
    /// The URI as the glTF file has it: "tri%20angle.bin".
    pub uri: &'a str,
    /// The URI with percent escapes decoded: "tri angle.bin". As it was written if that is not UTF-8.
    pub decoded_uri: &'a str,
    /// The path of the glTF file, as it was given to the import. Relative URIs start at its folder.
    pub gltf_path: &'a Path,
    /// The number of bytes that the import will use; what a resolver returns beyond that is dropped. It is what the
    /// glTF file says, so allocate only for what is there.
    pub max_bytes: u64,
}

/// A resolved URI. Equal targets hold equal bytes, however the URIs of files are spelled.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum UriTarget<'u> {
    /// The part of a data URI after its scheme.
    Data(&'u str),
    /// A file, by its canonical path.
    File(PathBuf),
    /// What the application's resolver returns for this URI.
    Resolved(&'u str),
}

/// The external files of one glTF file.
pub(super) struct ExternalFiles<'a> {
    gltf_path: &'a Path,
    policy: &'a FilePolicy,
    /// The canonical paths of the folders below which files are read.
    roots: Vec<PathBuf>,
}

impl<'a> ExternalFiles<'a> {
    /// The external files of the glTF file at a path, as far as the policy allows.
    pub(super) fn new(gltf_path: &'a Path, policy: &'a FilePolicy) -> Self {
        let canonical = |folder: &Path| canonicalize(folder).ok();
        let roots = match policy {
            FilePolicy::OwnFolder => canonical(folder_of(gltf_path)).into_iter().collect(),
            FilePolicy::Below(folders) => folders.iter().filter_map(|folder| canonical(folder)).collect(),
            FilePolicy::Resolver(_) => Vec::new(),
        };
        Self { gltf_path, policy, roots }
    }

    /// Resolves a URI, or returns why it cannot be read. Relative files start at the folder of the glTF file.
    ///
    /// Unless the application resolves, absolute paths, percent-encoded or not, and all schemes except `data:` are
    /// refused: an import never accesses the network, nor a file that is not given relative to the glTF file.
    pub(super) fn resolve<'u>(&self, uri: &'u str) -> Result<UriTarget<'u>, UriFault> {
        // A data URI holds the bytes itself.
        if let Some(data) = strip_data_scheme(uri) {
            return Ok(UriTarget::Data(data));
        }
        if let FilePolicy::Resolver(_) = self.policy {
            return Ok(UriTarget::Resolved(uri));
        }
        if let Some(scheme) = scheme(uri) {
            return Err(UriFault::Scheme { scheme: scheme.to_owned() });
        }
        let decoded = decode(uri);
        // `Path::join` with an absolute path would discard the folder, so both spellings are checked.
        for path in [uri, &decoded] {
            check_relative(path)?;
        }
        // Find the canonical path, which is the same however the file is spelled.
        let folder = folder_of(self.gltf_path);
        let path = folder.join(decoded.as_ref());
        let canonical = match canonicalize(&path) {
            // A file name with a literal "%20" in it is not a valid URI, but some exporters write it.
            Err(e) if e.kind() == io::ErrorKind::NotFound && decoded != uri => {
                canonicalize(&folder.join(uri)).map_err(|_| e)
            }
            result => result,
        };
        match canonical {
            Ok(canonical) if self.allows(&canonical) => Ok(UriTarget::File(canonical)),
            // The message does not tell whether there is a file outside.
            Err(error) if self.allows(&existing_ancestor(&path)) => Err(io_fault(&path, &error)),
            _ => Err(UriFault::NotAllowed { uri: uri.to_owned(), rule: self.rule() }),
        }
    }

    /// Reads the bytes, at most `limit` of those of a file.
    pub(super) fn read(&self, target: &UriTarget, limit: u64) -> Result<Vec<u8>, UriFault> {
        match (target, self.policy) {
            (UriTarget::Data(data), _) => decode_data(data),
            (UriTarget::File(path), _) => read_file(path, limit).map_err(|e| io_fault(path, &e)),
            (UriTarget::Resolved(uri), FilePolicy::Resolver(FileResolver(resolve))) => {
                let decoded_uri = &*decode(uri);
                let request = FileRequest { uri, decoded_uri, gltf_path: self.gltf_path, max_bytes: limit };
                let fault = |e: io::Error| {
                    let uri = (*uri).to_owned();
                    UriFault::Resolver { uri, kind: e.kind(), message: e.to_string() }
                };
                let mut bytes = resolve(&request).map_err(fault)?;
                bytes.truncate(usize::try_from(limit).unwrap_or(usize::MAX));
                Ok(bytes)
            }
            // Only a resolver makes such targets.
            (UriTarget::Resolved(uri), _) => Err(UriFault::NotAllowed { uri: (*uri).to_owned(), rule: self.rule() }),
        }
    }

    /// Whether a canonical path is below one of the allowed folders.
    fn allows(&self, path: &Path) -> bool {
        self.roots.iter().any(|root| path.starts_with(root))
    }

    fn rule(&self) -> FileRule {
        match self.policy {
            FilePolicy::Below(_) => FileRule::Below,
            _ => FileRule::OwnFolder,
        }
    }
}

/// The folder of a file; empty for a bare name.
fn folder_of(file: &Path) -> &Path {
    file.parent().unwrap_or(Path::new(""))
}

/// The canonical path. The empty path is the current folder.
fn canonicalize(path: &Path) -> io::Result<PathBuf> {
    if path == Path::new("") { Path::new(".") } else { path }.canonicalize()
}

/// A path percent-decoded; one that is not UTF-8 once decoded is taken as it is written.
fn decode(uri: &str) -> Cow<'_, str> {
    percent_decode_str(uri).decode_utf8().unwrap_or(Cow::Borrowed(uri))
}

/// The canonical path of the innermost folder on a path that exists.
fn existing_ancestor(path: &Path) -> PathBuf {
    path.ancestors().skip(1).find_map(|ancestor| canonicalize(ancestor).ok()).unwrap_or_default()
}

fn io_fault(path: &Path, error: &io::Error) -> UriFault {
    UriFault::Io { path: path.to_owned(), kind: error.kind(), message: error.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(uri: &str, gltf_path: &Path, limit: u64) -> Result<Vec<u8>, UriFault> {
        let files = ExternalFiles::new(gltf_path, &FilePolicy::OwnFolder);
        files.read(&files.resolve(uri)?, limit)
    }

    fn resolve<'u>(uri: &'u str, gltf_path: &Path) -> Result<UriTarget<'u>, UriFault> {
        ExternalFiles::new(gltf_path, &FilePolicy::OwnFolder).resolve(uri)
    }

    #[test]
    fn schemes_and_absolute_paths_are_refused() {
        for uri in ["http://host/a.bin", "file:///etc/hosts", "C:\\a.bin", "/etc/hosts", "\\\\host\\a", "//host/a"] {
            let fault = resolve(uri, Path::new("/nowhere/file.gltf")).unwrap_err();
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

    /// A folder with `allowed/own/scene.gltf`, whose own folder has `near.bin`; `allowed/shared.bin`, and `far.bin`
    /// outside of both.
    fn library() -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let own = folder.path().join("allowed/own");
        std::fs::create_dir_all(own.join("sub")).unwrap();
        for (path, bytes) in [("allowed/own/near.bin", "near"), ("allowed/shared.bin", "shared"), ("far.bin", "far")] {
            std::fs::write(folder.path().join(path), bytes).unwrap();
        }
        (folder, own.join("scene.gltf"))
    }

    #[test]
    fn only_files_below_the_allowed_folders_are_read() {
        let (folder, gltf_path) = library();
        let read = |uri: &str, policy: &FilePolicy| {
            let files = ExternalFiles::new(&gltf_path, policy);
            files.resolve(uri).and_then(|target| files.read(&target, 100)).ok()
        };
        let own = FilePolicy::OwnFolder;
        let below = FilePolicy::below([folder.path().join("nowhere"), folder.path().join("allowed")]);
        let empty_folder = FilePolicy::below([folder.path().join("allowed/own/sub")]);
        let none = FilePolicy::below([""; 0]);
        for (uri, bytes, allowed_by) in [
            ("near.bin", "near", [true, true, false, false]),
            ("sub/../near.bin", "near", [true, true, false, false]),
            ("../own/near.bin", "near", [true, true, false, false]),
            ("../shared.bin", "shared", [false, true, false, false]),
            ("%2e%2e/shared.bin", "shared", [false, true, false, false]),
            ("sub/../../shared.bin", "shared", [false, true, false, false]),
            ("../../far.bin", "far", [false, false, false, false]),
            ("../../allowed/../far.bin", "far", [false, false, false, false]),
        ] {
            for (policy, allowed) in [&own, &below, &empty_folder, &none].into_iter().zip(allowed_by) {
                assert_eq!(read(uri, policy), allowed.then(|| bytes.into()), "{uri}: {policy:?}");
            }
        }
    }

    /// A folder whose name merely begins like the allowed one is another folder.
    #[test]
    fn a_folder_with_a_longer_name_is_outside() {
        let (folder, gltf_path) = library();
        std::fs::create_dir(folder.path().join("allowed/own-not")).unwrap();
        std::fs::write(folder.path().join("allowed/own-not/a.bin"), "").unwrap();
        let fault = resolve("../own-not/a.bin", &gltf_path).unwrap_err();
        assert_eq!(fault, UriFault::NotAllowed { uri: "../own-not/a.bin".into(), rule: FileRule::OwnFolder });
    }

    #[cfg(unix)]
    #[test]
    fn links_are_judged_by_where_they_lead() {
        let (folder, gltf_path) = library();
        let link = |target: &str, name: &str| {
            std::os::unix::fs::symlink(folder.path().join(target), gltf_path.with_file_name(name)).unwrap();
        };
        link("far.bin", "file-out.bin");
        link("", "folder-out");
        link("allowed/own/near.bin", "file-in.bin");
        for uri in ["file-out.bin", "folder-out/far.bin", "folder-out/missing.bin", "folder-out"] {
            assert!(matches!(resolve(uri, &gltf_path), Err(UriFault::NotAllowed { .. })), "{uri}");
        }
        assert_eq!(read("file-in.bin", &gltf_path, 100).unwrap(), b"near");
        // A glTF file that is reached through a link has the link's folder.
        std::os::unix::fs::symlink(gltf_path.parent().unwrap(), folder.path().join("link")).unwrap();
        assert_eq!(read("near.bin", &folder.path().join("link/scene.gltf"), 100).unwrap(), b"near");
    }

    /// Whether a file outside exists must not show.
    #[test]
    fn a_refusal_is_the_same_whether_or_not_the_file_exists() {
        let (_folder, gltf_path) = library();
        let text = |uri: &str| resolve(uri, &gltf_path).unwrap_err().to_string().replace(uri, "");
        assert_eq!(text("../../far.bin"), text("../../missing.bin"));
        assert_eq!(text("../../far.bin"), text("../../far.bin/x"));
        let Err(UriFault::Io { kind, .. }) = resolve("missing.bin", &gltf_path) else { panic!("found") };
        assert_eq!(kind, io::ErrorKind::NotFound);
    }

    #[test]
    fn a_resolver_gets_every_uri_but_data() {
        let policy = FilePolicy::resolver(|request| match request.decoded_uri {
            "http://host/a b" | "/etc/hosts" | "../up" => {
                assert_eq!((request.gltf_path, request.max_bytes), (Path::new("no/such.gltf"), 3));
                Ok(request.uri.as_bytes().to_vec())
            }
            _ => Err(io::Error::new(io::ErrorKind::PermissionDenied, "not in the pak")),
        });
        let files = ExternalFiles::new(Path::new("no/such.gltf"), &policy);
        let read = |uri: &str| files.read(&files.resolve(uri).unwrap(), 3);
        for uri in ["http://host/a%20b", "/etc/hosts", "../up"] {
            assert_eq!(read(uri).unwrap(), uri.as_bytes()[..3], "{uri}");
        }
        assert_eq!(read("data:,abc").unwrap(), b"abc");
        let fault = UriFault::Resolver {
            uri: "x".into(),
            kind: io::ErrorKind::PermissionDenied,
            message: "not in the pak".into(),
        };
        assert_eq!(read("x"), Err(fault));
    }
}
