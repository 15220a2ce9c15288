//! External files: where they may lie, and files that the application provides.

use std::io;
use std::path::Path;

use ropewalk::gltf::{self, BufferFault, FilePolicy, FileRule, GltfFault, ImportOptions, UriFault};
use ropewalk::{Error, Result, Scene};
use serde_json::json;

use super::fixture::*;

/// A secret that must not show in any message.
const SECRET: &str = "root:$6$salt:19000:0:99999";

/// A file whose buffer and image are one external file.
fn naming(uri: &str) -> String {
    let mut fixture = Fixture::triangle();
    fixture.json["images"] = json!([{"uri": uri}]);
    fixture.json["textures"] = json!([{"source": 0}]);
    fixture.json["materials"] = json!([{"emissiveTexture": {"index": 0}}]);
    fixture.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    fixture.json["buffers"] = json!([{"byteLength": 36, "uri": uri}]);
    fixture.json.to_string()
}

fn import(text: &str, path: &Path, options: &ImportOptions) -> Result<Imported> {
    let mut scene = Scene::new();
    let root = scene.root();
    let report = gltf::import_from_slice(text.as_bytes(), path, options, &mut scene, root)?;
    Ok(Imported { scene, report })
}

#[test]
fn a_file_outside_is_refused_by_rule_and_not_quoted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("download/scene.gltf");
    std::fs::create_dir(folder.path().join("download")).unwrap();
    std::fs::write(folder.path().join("secret"), SECRET.repeat(3)).unwrap();
    std::fs::write(folder.path().join("download/own"), SECRET.repeat(3)).unwrap();

    let outside = naming("../secret");
    for (policy, rule) in [
        (FilePolicy::default(), FileRule::OwnFolder),
        (FilePolicy::below([folder.path().join("download")]), FileRule::Below),
        (FilePolicy::below([""; 0]), FileRule::Below),
    ] {
        let error = import(&outside, &path, &ImportOptions::default().with_files(policy)).err().unwrap();
        let message = error.to_string();
        assert!(!message.contains("salt") && message.contains("../secret"), "{message}");
        let Error::Gltf { pointer, cause, .. } = error else { panic!("{error:?}") };
        let fault = BufferFault::Uri(UriFault::NotAllowed { uri: "../secret".into(), rule });
        assert_eq!((&*pointer, cause), ("/buffers/0", GltfFault::Buffer(fault)));
    }
    // What may be read and is no image is not quoted either.
    let allowed = ImportOptions::default().with_files(FilePolicy::below([folder.path()]));
    for (text, options) in [(&outside, &allowed), (&naming("own"), &ImportOptions::default())] {
        let imported = import(text, &path, options).unwrap();
        let notes = imported.notes().join("\n");
        assert!(notes.contains("neither PNG nor JPEG") && !notes.contains("salt"), "{notes}");
    }
    // An image that is refused is a checkerboard, with the rule in the note.
    let mut image_only: serde_json::Value = serde_json::from_str(&outside).unwrap();
    image_only["buffers"][0]["uri"] = json!("own");
    let notes = import(&image_only.to_string(), &path, &ImportOptions::default()).unwrap().notes().join("\n");
    assert!(notes.contains("\"../secret\" is not in the folder of the glTF file"), "{notes}");
}

#[test]
fn a_file_without_a_folder_imports_by_a_resolver() {
    let mut fixture = Fixture::triangle();
    fixture.json["buffers"] = json!([{"byteLength": 36, "uri": "pak://models/tri%20angle.bin"}]);
    let (text, bin) = (fixture.json.to_string(), fixture.bin.clone());
    let files = FilePolicy::resolver(move |request| match request.decoded_uri {
        "pak://models/tri angle.bin" => Ok(bin.iter().copied().chain([7; 100]).collect()),
        _ => Err(io::Error::other("no such entry")),
    });
    let options = ImportOptions::default().with_files(files);
    let imported = import(&text, Path::new("in a pak.gltf"), &options).unwrap();
    assert_eq!(imported.geometry().positions.len(), 3);
    assert_eq!(imported.geometry().positions[2].y, 2.0);

    // A resolver's error is the import's, and a resolver that returns too little is found out.
    let error = import(&naming("else.bin"), Path::new("in a pak.gltf"), &options).err().unwrap().to_string();
    assert!(error.contains("/buffers/0") && error.contains("\"else.bin\": no such entry"), "{error}");
    let short = ImportOptions::default().with_files(FilePolicy::resolver(|_| Ok(vec![0; 35])));
    let Err(Error::Gltf { cause, .. }) = import(&text, Path::new("a.gltf"), &short) else { panic!("imports") };
    assert_eq!(cause, GltfFault::Buffer(BufferFault::TooShort { found: 35, declared: 36 }));
}

#[test]
fn options_are_equal_if_they_share_the_resolver() {
    let resolver = FilePolicy::resolver(|_| Ok(Vec::new()));
    let options = ImportOptions::default().with_files(resolver.clone());
    assert_eq!(options, options.clone());
    assert_ne!(options, ImportOptions::default().with_files(FilePolicy::resolver(|_| Ok(Vec::new()))));
    assert_ne!(options, ImportOptions::default());
}
