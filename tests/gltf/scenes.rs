//! The sample scenes: node and triangle counts are those that their index file gives.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use ropewalk::gltf::{self, ImportCounts, ImportOptions, ImportReport, SceneSelector};
use ropewalk::{Error, Scene};

use ropewalk_testkit::corpus::{gltf_files, scenes};

/// A row of the index: the counts of a file, or of all variants of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Row {
    unique: u64,
    scene: u64,
    nodes: usize,
}

/// The rows of the index by where their files are: a file, or a folder with all variants of a model.
fn read_index(folder: &Path) -> HashMap<PathBuf, Row> {
    let text = std::fs::read_to_string(folder.join("INDEX.md")).unwrap();
    let mut rows = HashMap::new();
    for line in text.lines() {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let [_, name, _, _, unique, scene, nodes, ..] = cells[..] else { continue };
        let (Ok(unique), Ok(scene), Ok(nodes)) = (unique.parse(), scene.parse(), nodes.parse()) else { continue };
        // The index has "scenes/bart/x.glb" and "gltf-large/X/" where the files are in "scenes" and "gltf".
        let kind = name.split('/').next().unwrap().trim_end_matches("-large");
        if !["gltf", "meshes", "scenes"].contains(&kind) {
            continue;
        }
        let file = name.trim_end_matches('/').rsplit('/').next().unwrap();
        rows.insert(folder.join(kind).join(file), Row { unique, scene, nodes });
    }
    rows
}

/// The row for a file; for the files of the asset generator, which the index leaves out, what their names stand for.
fn row_of(rows: &HashMap<PathBuf, Row>, file: &Path) -> Row {
    if let Some(row) = file.ancestors().find_map(|place| rows.get(place)) {
        // The index counts the first variant; the quantized one has a second node, that undoes the quantization.
        let extra_nodes = usize::from(file.ends_with("AnimatedMorphCube/glTF-Quantized/AnimatedMorphCube.gltf"));
        return Row { nodes: row.nodes + extra_nodes, ..*row };
    }
    let name = file.file_name().unwrap().to_str().unwrap();
    if name.starts_with("Node_") {
        Row { unique: 54, scene: 54, nodes: 2 }
    } else if name.starts_with("Buffer_Interleaved_") {
        Row { unique: 2, scene: 2, nodes: 1 }
    } else {
        panic!("{}: not in INDEX.md", file.display())
    }
}

/// Imports a scene of a file, checks the counts against the scene graph's own, and takes it out again.
fn import(file: &Path, scene_choice: Option<SceneSelector>) -> Result<ImportReport, Error> {
    let mut scene = Scene::new();
    let root = scene.root();
    let report = gltf::import_with(file, &ImportOptions::default().with_scene(scene_choice), &mut scene, root)?;
    scene.validate().unwrap();
    let counts = report.counts;
    let name = file.display();
    assert_eq!(scene.triangle_count(), counts.geometry_triangles, "{name}");
    assert_eq!(scene.instanced_triangle_count(), counts.scene_triangles, "{name}");
    assert_eq!(scene.node_count() - 1, counts.nodes, "{name}");
    assert_eq!(report.nodes.iter().flatten().count(), counts.file_nodes, "{name}");
    let assets = (scene.geometry_count(), scene.material_count(), scene.texture_count());
    assert_eq!(assets, (counts.geometries, counts.materials, counts.textures), "{name}");

    scene.remove(report.root).unwrap();
    assert_eq!((scene.geometry_count(), scene.material_count(), scene.texture_count()), (0, 0, 0), "{name}");
    Ok(report)
}

#[test]
fn every_scene_has_the_counts_of_the_index() {
    let Some(folder) = scenes("every_scene_has_the_counts_of_the_index") else { return };
    let rows = read_index(&folder);
    assert!(rows.len() >= 49, "only {} rows in INDEX.md", rows.len());
    let files: Vec<PathBuf> = ["gltf", "meshes", "scenes"].iter().flat_map(|f| gltf_files(&folder.join(f))).collect();
    assert!(files.len() > 110, "only {} files", files.len());

    let mut seen = Vec::new();
    for file in &files {
        let name = file.display();
        let expected = row_of(&rows, file);
        seen.extend(file.ancestors().find(|place| rows.contains_key(*place)).map(Path::to_owned));
        if name.to_string().contains("-Draco") {
            let Err(Error::UnsupportedExtension { extension, .. }) = import(file, None) else { panic!("{name}") };
            assert_eq!(extension, "KHR_draco_mesh_compression");
            continue;
        }
        let default = import(file, None).unwrap_or_else(|e| panic!("{e}"));
        // "Nodes" and "unique" count the whole file, "scene" its default scene.
        let of_all: Vec<ImportCounts> =
            (0..default.scenes.len()).map(|i| import(file, Some(SceneSelector::Index(i))).unwrap().counts).collect();
        let found = Row {
            unique: of_all.iter().map(|counts| counts.mesh_triangles).sum(),
            scene: default.counts.scene_triangles,
            nodes: of_all.iter().map(|counts| counts.file_nodes).sum(),
        };
        assert_eq!(found, expected, "{name}");
    }
    let unseen: Vec<_> = rows.keys().filter(|place| !seen.contains(place)).collect();
    assert!(unseen.is_empty(), "in INDEX.md, but not there: {unseen:?}");
}

#[test]
fn a_million_triangles_from_one_sphere() {
    let Some(folder) = scenes("a_million_triangles_from_one_sphere") else { return };
    let file = folder.join("gltf/MetalRoughSpheresNoTextures/glTF-Binary/MetalRoughSpheresNoTextures.glb");
    let counts = import(&file, None).unwrap().counts;
    // 98 spheres of one geometry and 25 letters and signs.
    assert_eq!((counts.geometries, counts.geometry_triangles, counts.scene_triangles), (26, 12_209, 1_040_409));
}

#[test]
fn what_is_not_honoured_is_reported() {
    let Some(folder) = scenes("what_is_not_honoured_is_reported") else { return };
    for (file, expected) in [
        ("CesiumMan/glTF-Binary/CesiumMan.glb", &["animation", "skin", "minFilter and mipmaps"][..]),
        ("AnimatedMorphCube/glTF/AnimatedMorphCube.gltf", &["animation", "morph targets"]),
        ("MeshPrimitiveModes/glTF/MeshPrimitiveModes.gltf", &["points", "lines"]),
        (
            "AttenuationTest/glTF/AttenuationTest.gltf",
            &["minFilter and mipmaps", "attenuation", "transmission without KHR_materials_volume"],
        ),
        (
            "ToyCar/glTF/ToyCar.gltf",
            &[
                "KHR_materials_clearcoat",
                "KHR_materials_sheen",
                "occlusion texture",
                "minFilter and mipmaps",
                "clip planes",
                "transmission without KHR_materials_volume",
            ],
        ),
        (
            "TransmissionTest/glTF-Binary/TransmissionTest.glb",
            &["KHR_xmp", "clip planes", "rough transmission", "transmission without KHR_materials_volume"],
        ),
        ("Avocado/glTF/Avocado.gltf", &["TANGENT"]),
        ("NegativeScaleTest/glTF/NegativeScaleTest.gltf", &["minFilter and mipmaps"]),
        ("Box/glTF/Box.gltf", &[]),
        ("SimpleInstancing/glTF/SimpleInstancing.gltf", &[]),
    ] {
        let report = import(&folder.join("gltf").join(file), None).unwrap();
        let mut features: Vec<String> = Vec::new();
        for note in report.warnings {
            if !features.contains(&note.feature) {
                features.push(note.feature);
            }
        }
        assert_eq!(features, expected, "{file}");
    }
}
