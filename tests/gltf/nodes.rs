//! Nodes: hierarchy, transforms, names, sharing, instances, cameras, lights, scenes; and what an error leaves behind.

use glam::{DMat3, DVec3, Vec2, Vec3};
use ropewalk::gltf::{self, GltfFault, ImportOptions, SceneSelector};
use ropewalk::graph::LightKind;
use ropewalk::{Camera, Core, Error, Light, Scene, Transform};
use serde_json::json;

use super::fixture::*;

#[test]
fn hierarchy_names_and_transforms_are_kept() {
    let mut fixture = Fixture::new();
    fixture.json["scenes"] = json!([{"nodes": [2, 0], "name": "M\u{f6}bel \u{2764}"}]);
    fixture.json["nodes"] = json!([
        {"name": "tisch", "children": [1], "translation": [6378137.123456, 0, 0], "scale": [2, -2, 2]},
        {"name": "\u{2764}\u{267b} a/b~c", "rotation": [0, 0, 1, 0], "translation": [1, 2, 3]},
        {"matrix": [1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1]},
    ]);
    let Imported { scene, report } = fixture.import();
    let node = |i: usize| report.nodes[i].unwrap();

    assert_eq!(scene.name(report.root).unwrap(), "M\u{f6}bel \u{2764}");
    assert_eq!(scene.children(scene.root()).unwrap().collect::<Vec<_>>(), [report.root]);
    assert_eq!(scene.children(report.root).unwrap().collect::<Vec<_>>(), [node(2), node(0)]);
    assert_eq!(scene.parent(node(1)).unwrap(), Some(node(0)));
    assert_eq!((report.node("tisch"), report.node("\u{2764}\u{267b} a/b~c")), (Some(node(0)), Some(node(1))));
    assert_eq!((report.node(""), report.node("stuhl")), (None, None));

    // Half a turn about Z, then twice the size and mirrored in y, then a long way.
    let world = scene.world_from_local(node(1)).unwrap();
    assert_eq!(world.translation, DVec3::new(6378137.123456 + 2.0, -4.0, 6.0));
    let expected = DMat3::from_cols(DVec3::X * -2.0, DVec3::Y * 2.0, DVec3::Z * 2.0);
    assert!((world.matrix3 - expected).abs_diff_eq(DMat3::ZERO, 1e-15));
    let Transform::Matrix(matrix) = scene.local(node(2)).unwrap() else { panic!("the matrix was taken apart") };
    assert_eq!(matrix.transform_point3(DVec3::Y), DVec3::new(5.0, 6.0, 6.0));
    assert_eq!(report.counts.file_nodes, 3);
    assert_eq!(report.counts.nodes, scene.node_count() - 1);
}

#[test]
fn a_root_without_scene_name_is_named_after_the_file() {
    let Imported { scene, report } = Fixture::triangle().import();
    assert_eq!(scene.name(report.root).unwrap(), "fixture");
}

#[test]
fn shared_meshes_share_cores_and_shared_data_shares_geometry() {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let mut twin = fixture.json["accessors"][positions].clone();
    twin["name"] = json!("another accessor of the same bytes");
    let twin = fixture.push("accessors", twin);
    fixture.json["materials"] = json!([{"name": "red"}, {"name": "blue"}]);
    let primitive =
        |positions: usize, material: usize| json!({"attributes": {"POSITION": positions}, "material": material});
    fixture.json["meshes"] = json!([
        {"primitives": [primitive(positions, 0), primitive(positions, 1)], "name": "both"},
        {"primitives": [primitive(twin, 0)]},
    ]);
    fixture.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0}, {"mesh": 1}]);
    let imported = fixture.import();
    let scene = &imported.scene;
    let cores = |i| imported.geometry_nodes(i).iter().map(|&n| scene.core_key(n).unwrap()).collect::<Vec<_>>();
    assert_eq!(cores(0).len(), 2);
    assert_eq!(cores(0), cores(1));
    assert_ne!(cores(0)[0], cores(0)[1]);
    // Another mesh is another object, even where it looks the same.
    assert!(!cores(0).contains(&cores(2)[0]));
    assert_eq!((scene.geometry_count(), scene.material_count()), (1, 2));
    assert_eq!(scene.name(imported.geometry_nodes(0)[1]).unwrap(), "both");
    let counts = imported.report.counts;
    assert_eq!((counts.geometry_triangles, counts.mesh_triangles, counts.scene_triangles), (1, 3, 5));
}

#[test]
fn the_same_bytes_in_another_shape_are_another_geometry() {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &[TRIANGLE, TRIANGLE].concat());
    let mut shorter = fixture.json["accessors"][positions].clone();
    shorter["count"] = json!(3);
    let shorter = fixture.push("accessors", shorter);
    let mut later = fixture.json["accessors"][shorter].clone();
    later["byteOffset"] = json!(12);
    let later = fixture.push("accessors", later);
    let primitives: Vec<_> =
        [positions, shorter, later].iter().map(|p| json!({"attributes": {"POSITION": p}})).collect();
    fixture.json["meshes"] = json!([{ "primitives": primitives }]);
    fixture.json["nodes"] = json!([{"mesh": 0}]);
    assert_eq!(fixture.import().scene.geometry_count(), 3);
}

#[test]
fn instances_get_a_transform_each_and_share_the_core() {
    let mut fixture = Fixture::triangle();
    let translations = fixture.floats("VEC3", &[0.0, 0.0, 0.0, 10.0, 0.0, 0.0]);
    let bytes = [0_i8, 0, 0, 127, 0, 0, 127, 0].map(|i| i as u8);
    let rotations = fixture.accessor(I8, "VEC4", 2, &bytes);
    fixture.json["accessors"][rotations]["normalized"] = json!(true);
    let scales = fixture.floats("VEC3", &[1.0, 1.0, 1.0, 1.0, 3.0, 1.0]);
    let attributes = json!({"TRANSLATION": translations, "ROTATION": rotations, "SCALE": scales, "_ID": scales});
    fixture.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    fixture.json["nodes"][0]["translation"] = json!([0, 0, 5]);
    fixture.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let imported = fixture.import();
    let scene = &imported.scene;
    let instances: Vec<_> = scene.children(imported.node(0)).unwrap().collect();
    assert_eq!(instances.len(), 2);
    let shown: Vec<_> = instances.iter().flat_map(|&i| scene.children(i).unwrap()).collect();
    assert_eq!(scene.core_key(shown[0]).unwrap(), scene.core_key(shown[1]).unwrap());
    // The corner (0, 2, 0), scaled by 3, turned by half a turn about Z, moved by 10, and by the node.
    let corner = scene.world_from_local(shown[1]).unwrap().transform_point3(DVec3::new(0.0, 2.0, 0.0));
    assert!((corner - DVec3::new(10.0, -6.0, 5.0)).length() < 1e-12, "{corner}");
    assert_eq!(imported.report.counts.scene_triangles, 2);
    assert!(imported.notes()[0].contains("_ID"), "{:?}", imported.notes());
}

#[test]
fn cameras() {
    let mut fixture = Fixture::new();
    fixture.json["cameras"] = json!([
        {"type": "perspective", "name": "main", "perspective": {"yfov": 0.5, "znear": 0.1, "aspectRatio": 1.5}},
        {"type": "orthographic", "orthographic": {"xmag": 2, "ymag": -3, "znear": 0, "zfar": 1}},
        {"type": "perspective", "perspective": {"yfov": 3.5, "znear": 0.1}},
        {"type": "fisheye"},
    ]);
    fixture.json["nodes"] =
        json!([{"camera": 0}, {"camera": 1, "name": "top"}, {"camera": 0}, {"camera": 2}, {"camera": 3}]);
    let imported = fixture.import();
    let Imported { scene, report } = &imported;
    let found: Vec<_> = report.cameras.iter().map(|c| (&*c.name, c.index)).collect();
    assert_eq!(found, [("main", 0), ("top", 1), ("main", 0), ("", 2)]);
    let core = |i: usize| scene.node_core(report.cameras[i].node).unwrap();
    assert_eq!(*core(0), Core::Camera(Camera::Perspective { y_fov: 0.5, aspect: Some(1.5), shift: Vec2::ZERO }));
    assert_eq!(*core(1), Core::Camera(Camera::orthographic(2.0, 3.0)));
    assert_eq!(scene.core_key(report.cameras[0].node).unwrap(), scene.core_key(report.cameras[2].node).unwrap());
    assert_eq!(scene.parent(report.cameras[1].node).unwrap(), report.nodes[1]);
    assert_eq!((report.camera("top"), report.camera("no")), (Some(report.cameras[1].node), None));
    // Clip planes of three, a sign, a width, and an unknown type.
    assert_eq!(imported.notes().len(), 6, "{:?}", imported.notes());

    for bad in [json!({"yfov": 0, "znear": 1}), json!({"yfov": -1, "znear": 1}), json!({"yfov": 1e39, "znear": 1})] {
        fixture.json["cameras"][0]["perspective"] = bad;
        let (pointer, fault) = fixture.strict_fault();
        assert_eq!(pointer, "/cameras/0");
        assert!(matches!(fault, GltfFault::OutOfRange { what: "yfov", .. }), "{fault:?}");
        // Otherwise the camera is left out of both nodes, and told of once.
        let imported = fixture.import();
        assert_eq!(imported.report.cameras.iter().map(|c| c.index).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(imported.notes().iter().filter(|note| note.contains("yfov is")).count(), 1);
    }
}

#[test]
fn lights() {
    let mut fixture = Fixture::new();
    fixture.json["extensionsUsed"] = json!(["KHR_lights_punctual"]);
    fixture.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "point", "name": "bulb", "color": [1, 0.5, 0], "intensity": 20, "range": 3},
        {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.2}},
        {"type": "directional", "intensity": -1},
        {"type": "spot", "spot": {"innerConeAngle": 2, "outerConeAngle": 3}},
        {"type": "laser"},
    ]}});
    let light = |i: usize| json!({"extensions": {"KHR_lights_punctual": {"light": i}}, "name": format!("n{i}")});
    fixture.json["nodes"] = json!([light(0), light(1), light(2), light(3), light(4), light(0)]);
    let imported = fixture.import();
    let Imported { scene, report } = &imported;
    let cores: Vec<_> = report.lights.iter().map(|l| scene.node_core(l.node).unwrap().clone()).collect();
    let spot = |inner_cone_angle, outer_cone_angle| LightKind::Spot { inner_cone_angle, outer_cone_angle };
    let white = |kind, intensity| Core::Light(Light { kind, color: Vec3::ONE, intensity, range: None });
    let right_angle = std::f32::consts::FRAC_PI_2;
    let bulb = Light { kind: LightKind::Point, color: Vec3::new(1.0, 0.5, 0.0), intensity: 20.0, range: Some(3.0) };
    let expected = [
        Core::Light(bulb),
        white(spot(0.1, 0.2), 1.0),
        white(LightKind::Directional, 0.0),
        white(spot(right_angle, right_angle), 1.0),
        Core::Light(bulb),
    ];
    assert_eq!(cores, expected);
    assert_eq!(scene.core_key(report.lights[0].node).unwrap(), scene.core_key(report.lights[4].node).unwrap());
    assert_eq!((report.light("bulb"), report.light("n1")), (Some(report.lights[0].node), Some(report.lights[1].node)));
    assert_eq!(imported.notes().len(), 3, "{:?}", imported.notes());
}

#[test]
fn the_product_of_a_light_s_color_and_intensity_is_finite() {
    let mut fixture = Fixture::new();
    for (color, intensity) in [([3.0, 1.0, 0.0], 3e38_f32), ([3e38, 0.5, 1.0], 1e30), ([1.0, 7.0, 1e-3], f32::MAX)] {
        let light = json!({"type": "point", "color": color, "intensity": intensity});
        fixture.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [light]}});
        fixture.json["extensionsUsed"] = json!(["KHR_lights_punctual"]);
        fixture.json["nodes"] = json!([{"extensions": {"KHR_lights_punctual": {"light": 0}}}]);
        let imported = fixture.import();
        let Core::Light(light) = imported.scene.node_core(imported.report.lights[0].node).unwrap() else { panic!() };
        assert_eq!(light.color, Vec3::from(color));
        let product = (light.color * light.intensity).max_element();
        assert!(product.is_finite(), "{light:?}");
        // A light of the greatest intensity that f32 can hold.
        assert!(product > f32::MAX * 0.999_999, "{light:?}");
        assert_eq!(imported.notes().len(), 1, "{:?}", imported.notes());
        assert!(imported.notes()[0].contains("intensity"), "{:?}", imported.notes());
    }
}

#[test]
fn hidden_nodes_are_hidden() {
    let mut fixture = Fixture::triangle();
    fixture.json["nodes"][0]["extensions"] = json!({"KHR_node_visibility": {"visible": false}});
    let Imported { scene, report } = fixture.import();
    assert!(!scene.is_visible(report.nodes[0].unwrap()).unwrap());
    assert!(report.warnings.is_empty());
}

#[test]
fn one_scene_of_several() {
    let mut fixture = Fixture::new();
    fixture.json["nodes"] = json!([{"name": "a"}, {"name": "b"}, {"name": "c"}]);
    let imported = |fixture: &Fixture, scene: Option<SceneSelector>| {
        let Imported { report, .. } = fixture.try_import_with(&ImportOptions::default().with_scene(scene))?;
        let present: String = ["a", "b", "c"].into_iter().filter(|name| report.node(name).is_some()).collect();
        Ok::<_, Error>((report.scene, present))
    };
    // A file without scenes is imported with all its nodes.
    assert_eq!(imported(&fixture, None).unwrap(), (None, "abc".into()));

    fixture.json["scenes"] = json!([{"nodes": [0]}, {"nodes": [1, 2], "name": "second"}, {}]);
    assert_eq!(imported(&fixture, None).unwrap(), (Some(0), "a".into()));
    fixture.json["scene"] = json!(1);
    assert_eq!(imported(&fixture, None).unwrap(), (Some(1), "bc".into()));
    assert_eq!(imported(&fixture, Some(SceneSelector::Index(0))).unwrap(), (Some(0), "a".into()));
    assert_eq!(imported(&fixture, Some(SceneSelector::Index(2))).unwrap(), (Some(2), String::new()));
    assert_eq!(imported(&fixture, Some(SceneSelector::Name("second".into()))).unwrap(), (Some(1), "bc".into()));
    let error = imported(&fixture, Some(SceneSelector::Name("third".into()))).unwrap_err().to_string();
    assert_eq!(error, "fixture.glb: /scenes: there is no scene \"third\"; there are 3, with the names: second");
    let error = imported(&fixture, Some(SceneSelector::Index(3))).unwrap_err();
    let Error::Gltf { cause, .. } = error else { panic!("{error:?}") };
    assert_eq!(cause, GltfFault::NoSceneIndex { index: 3, count: 3 });
}

#[test]
fn an_error_leaves_the_scene_as_it_was() {
    let mut scene = Scene::new();
    let root = scene.root();
    let revision = scene.revision();
    let options = ImportOptions::default();
    let path = std::path::Path::new("fixture.glb");

    // Each of these fails at another stage; the last two after everything was read.
    let mut cycle = Fixture::triangle();
    cycle.json["nodes"] = json!([{"mesh": 0, "children": [0]}]);
    let mut nan = Fixture::triangle();
    nan.bin[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    let mut mode = Fixture::triangle();
    mode.json["materials"] = json!([{"alphaMode": "GLASS"}]);
    mode.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    for fixture in [cycle, nan, mode] {
        assert!(gltf::import_from_slice(&fixture.glb(), path, &options, &mut scene, root).is_err());
        assert_eq!(scene.revision(), revision);
    }

    let child = scene.add(root, Transform::IDENTITY).unwrap();
    scene.remove(child).unwrap();
    let revision = scene.revision();
    let stale = gltf::import_from_slice(&Fixture::triangle().glb(), path, &options, &mut scene, child);
    assert!(matches!(stale, Err(Error::StaleKey { .. })));
    assert_eq!(scene.revision(), revision);
    assert_eq!((scene.node_count(), scene.geometry_count(), scene.material_count()), (1, 0, 0));
}

#[test]
fn removing_the_root_undoes_an_import() {
    let mut fixture = Fixture::triangle();
    fixture.json["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]);
    fixture.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    fixture.json["textures"] = json!([{}]);
    let Imported { mut scene, report } = fixture.import();
    assert_eq!((scene.geometry_count(), scene.material_count(), scene.texture_count()), (1, 1, 1));
    scene.remove(report.root).unwrap();
    assert_eq!((scene.geometry_count(), scene.material_count(), scene.texture_count()), (0, 0, 0));
    assert_eq!((scene.node_count(), scene.core_count()), (1, 1));
}

#[test]
fn the_report_serializes() {
    let report = serde_json::to_value(Fixture::triangle().import().report).unwrap();
    assert_eq!(report["counts"]["scene_triangles"], 1);
    assert!(report["warnings"].is_array());
}
