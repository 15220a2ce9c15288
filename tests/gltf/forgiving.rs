//! Faults that have one reading, or whose part can be left out: the rest of the file is imported with a note, and a
//! strict import refuses it.

use std::path::Path;

use base64::Engine;
use glam::{DVec3, Vec3, Vec4};
use ropewalk::gltf::{
    self, AccessorFault, BufferFault, ContainerFault, GltfFault, HierarchyFault, ImportOptions, PrimitiveFault,
    TransformFault, UriFault, WarningKind,
};
use ropewalk::graph::LightKind;
use ropewalk::{Core, Error, Light, Scene};
use serde_json::{Value, json};

use super::fixture::*;

/// Imports a file with one fault, which a strict import must refuse at `pointer`, and checks that exactly one note, at
/// the same place, tells of it with each of the `words`.
#[track_caller]
fn forgiven(fixture: &Fixture, pointer: &str, cause: impl Into<GltfFault>, words: &[&str]) -> Imported {
    let imported = forgiven_with(fixture, pointer, words);
    let (found_pointer, found_cause) = fixture.strict_fault();
    assert_eq!((&*found_pointer, found_cause), (pointer, cause.into()));
    imported
}

#[track_caller]
fn forgiven_with(fixture: &Fixture, pointer: &str, words: &[&str]) -> Imported {
    assert_eq!(fixture.strict_fault().0, pointer);
    let imported = fixture.import();
    let faults: Vec<_> = imported.report.warnings.iter().filter(|w| w.kind == WarningKind::Fault).collect();
    assert!(faults.len() == 1 && faults[0].pointer == pointer, "{:?}", imported.notes());
    let text = faults[0].to_string();
    assert!(words.iter().all(|word| text.contains(word)), "{words:?}: {text}");
    imported
}

/// A triangle with one more attribute, in an accessor of its own.
fn with_attribute(name: &str, component: u32, shape: &str, count: usize, bytes: &[u8]) -> Fixture {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let attribute = fixture.accessor(component, shape, count, bytes);
    fixture.with_primitive(json!({"attributes": {"POSITION": positions, name: attribute}}))
}

fn with_floats(name: &str, shape: &str, values: &[f32]) -> Fixture {
    with_attribute(name, F32, shape, 3, bytemuck::cast_slice(values))
}

#[test]
fn integer_colours_are_fractions_even_if_the_file_does_not_say_so() {
    let rgba = Vec4::new(1.0, 0.2, 0.0, 0.4);
    let found = |text: &str| AccessorFault::NotNormalized { found: text.to_owned() };
    for (component, shape, bytes, expected, format) in [
        (U8, "VEC4", [[255, 51, 0, 102]; 3].concat(), rgba, "VEC4 of unsigned byte"),
        (U8, "VEC3", vec![255, 51, 0, 255, 51, 0, 255, 51, 0], rgba.with_w(1.0), "VEC3 of unsigned byte"),
        (
            U16,
            "VEC4",
            bytemuck::cast_slice(&[[65535_u16, 13107, 0, 26214]; 3]).to_vec(),
            rgba,
            "VEC4 of unsigned short",
        ),
    ] {
        let fixture = with_attribute("COLOR_0", component, shape, 3, &bytes);
        let imported = forgiven(&fixture, "/accessors/1", found(format), &["COLOR_0", "read as normalized"]);
        assert_eq!(imported.geometry().colors.as_ref().unwrap()[0], expected);
    }
    // Signed integers have no such reading: they are left out.
    let fixture = with_attribute("COLOR_0", I8, "VEC4", 3, &[100; 12]);
    let imported = forgiven_with(&fixture, "/accessors/1", &["COLOR_0", "left out"]);
    assert_eq!(imported.geometry().colors, None);
}

#[test]
fn a_scene_root_that_is_a_child_is_a_root_and_shown_once() {
    let mut fixture = Fixture::triangle();
    fixture.json["nodes"] = json!([
        {"children": [1], "translation": [10, 0, 0]},
        {"mesh": 0, "translation": [0, 1, 0], "children": [2]},
        {"mesh": 0, "translation": [0, 0, 1]},
    ]);
    let fault = HierarchyFault::NotARoot { node: 1, parent: 0 };
    let place = |imported: &Imported, i| imported.scene.world_from_local(imported.node(i)).unwrap().translation;
    for (roots, k, shown) in [(json!([1]), 0, 2), (json!([0, 1]), 1, 3), (json!([1, 0]), 0, 3)] {
        fixture.json["scenes"] = json!([{ "nodes": roots }]);
        let imported = forgiven(&fixture, &format!("/scenes/0/nodes/{k}"), fault, &["shown as a root"]);
        assert_eq!(place(&imported, 1), DVec3::Y);
        assert_eq!(place(&imported, 2), DVec3::new(0.0, 1.0, 1.0));
        assert_eq!(imported.scene.parent(imported.node(1)).unwrap(), Some(imported.report.root));
        let counts = imported.report.counts;
        assert_eq!((counts.file_nodes, counts.scene_triangles), (shown, 2), "{roots}");
    }
    // Another scene shows it below its parent.
    fixture.json["scenes"] = json!([{"nodes": [0]}, {"nodes": [1]}]);
    let imported = forgiven_with(&fixture, "/scenes/1/nodes/0", &[]);
    assert_eq!(place(&imported, 1), DVec3::new(10.0, 1.0, 0.0));
}

#[test]
fn a_skin_whose_joint_is_a_root_follows_it() {
    let mut fixture = skinned_at(&[1.0, 0.0, 0.0, 0.0], [0; 4]);
    fixture.json["nodes"] = json!([
        {"mesh": 0, "skin": 0},
        {"translation": [0, 3, 0]},
        {"children": [1], "translation": [50, 0, 0]},
    ]);
    fixture.json["scenes"] = json!([{"nodes": [0, 1]}]);
    let imported = forgiven_with(&fixture, "/scenes/0/nodes/1", &[]);
    assert_eq!(imported.geometry().positions[0], Vec3::Y * 3.0);
}

#[test]
fn nul_bytes_after_the_json() {
    let fixture = Fixture::triangle();
    let mut glb = fixture.glb();
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    // Three more bytes of padding and one in place of a space would not stay aligned: add four.
    glb.splice(20 + length..20 + length, [0; 4]);
    for (at, value) in [(8, glb.len() as u32), (12, length as u32 + 4)] {
        glb[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    let text = [Fixture::new().json.to_string().as_bytes(), &[0]].concat();
    for bytes in [glb, text] {
        let import = |strict| {
            let mut scene = Scene::new();
            let root = scene.root();
            let options = ImportOptions::default().with_strict(strict);
            gltf::import_from_slice(&bytes, Path::new("nul.glb"), &options, &mut scene, root)
        };
        let warnings = import(false).unwrap().warnings;
        assert_eq!(warnings.len(), 1);
        assert_eq!(warnings[0].to_string(), "the file: JSON chunk: it ends in NUL bytes instead of spaces: left out");
        let Err(Error::Gltf { cause, .. }) = import(true) else { panic!("a strict import accepts NUL bytes") };
        assert_eq!(cause, ContainerFault::NulPadding.into());
    }
}

#[test]
fn base64_with_white_space_and_letters_of_urls() {
    // Bytes whose base64 has both letters in which the alphabets differ.
    let mut fixture = Fixture::new();
    let positions = [[f32::from_bits(0x3FFF_FBFF); 9].as_slice(), &[1.0, 0.0, 0.0]].concat();
    let positions = fixture.accessor(F32, "VEC3", 4, bytemuck::cast_slice(&positions));
    let mut fixture = fixture.with_primitive(json!({"attributes": {"POSITION": positions}, "mode": 5}));
    let plain = base64::engine::general_purpose::STANDARD.encode(&fixture.bin);
    let url = plain.replace('+', "-").replace('/', "_");
    assert_ne!(plain, url);
    let broken: String =
        plain.as_bytes().chunks(20).map(|line| format!("{}\r\n", str::from_utf8(line).unwrap())).collect();
    let length = fixture.bin.len();
    let fault = GltfFault::Buffer(BufferFault::Uri(UriFault::Base64Spelling));
    for text in [url, broken] {
        let uri = format!("data:application/octet-stream;base64,{text}");
        fixture.json["buffers"] = json!([{"byteLength": length, "uri": uri}]);
        let imported = forgiven(&fixture, "/buffers/0/uri", fault.clone(), &["white space"]);
        assert_eq!(imported.geometry().positions[3], Vec3::X);
        assert_eq!(imported.geometry().positions[0].x.to_bits(), 0x3FFF_FBFF);
    }
}

#[test]
fn normals_without_direction_are_computed() {
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    let x = [1.0, 0.0, 0.0];
    for (normals, first, words) in [
        ([x, [nan, 0.0, 0.0], x], 1, &["computed from the triangles around it"][..]),
        ([[0.0; 3], x, [0.0, inf, 0.0]], 0, &["and 1 more", "computed from the triangles around them"]),
    ] {
        let fixture = with_floats("NORMAL", "VEC3", &normals.concat());
        let imported = forgiven(&fixture, "/accessors/1", AccessorFault::NoDirection { element: first }, words);
        let found = imported.geometry().normals.as_ref().unwrap();
        let expected = normals.map(|normal| if normal == x { Vec3::X } else { Vec3::Z });
        assert_eq!(**found, expected);
    }
    // Where no normal is one, the mesh is shaded as if it had none.
    let fixture = with_floats("NORMAL", "VEC3", &[nan; 9]);
    let imported = forgiven(&fixture, "/accessors/1", AccessorFault::NoDirection { element: 0 }, &["left out"]);
    assert_eq!(imported.geometry().normals, None);
}

/// A triangle of which each vertex has these weights on these joints of a skin with one joint, 3 up in y.
fn skinned_at(weights: &[f32; 4], joints: [u8; 4]) -> Fixture {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let joints = fixture.accessor(U8, "VEC4", 3, &[joints; 3].concat());
    let weights = fixture.floats("VEC4", &[*weights; 3].concat());
    let attributes = json!({"POSITION": positions, "JOINTS_0": joints, "WEIGHTS_0": weights});
    let mut fixture = fixture.with_primitive(json!({ "attributes": attributes }));
    fixture.json["skins"] = json!([{"joints": [1]}]);
    fixture.json["nodes"] = json!([{"mesh": 0, "skin": 0}, {"translation": [0, 3, 0]}]);
    fixture
}

#[test]
fn vertices_without_weights_hang_on_their_first_joint() {
    let mut fixture = skinned_at(&[0.0; 4], [1, 0, 0, 0]);
    fixture.json["skins"][0]["joints"] = json!([0, 1]);
    let fault = AccessorFault::NoWeight { element: 0 };
    let imported = forgiven(&fixture, "/accessors/2", fault, &["WEIGHTS_0", "and of 2 more", "first joint"]);
    assert_eq!(*imported.geometry().positions, [Vec3::Y * 3.0, Vec3::new(1.0, 3.0, 0.0), Vec3::Y * 5.0]);
    // A skin without joints moves nothing, and fails at nothing.
    fixture.json["skins"][0]["joints"] = json!([]);
    assert_eq!(fixture.import().geometry().positions[0], Vec3::ZERO);
}

#[test]
fn a_joint_that_is_out_of_range_matters_only_with_a_weight() {
    let fault = AccessorFault::JointOutOfRange { joint: 7, joint_count: 1 };
    let fixture = skinned_at(&[1.0, 0.0, 0.0, 0.0], [0, 7, 0, 0]);
    let imported = forgiven(&fixture, "/accessors/1", fault.clone(), &["joint 7", "and 2 more", "weight is zero"]);
    assert_eq!(imported.geometry().positions[0], Vec3::Y * 3.0);
    let fixture = skinned_at(&[1.0, 0.1, 0.0, 0.0], [0, 7, 0, 0]);
    assert_eq!(fixture.fault(), ("/accessors/1".into(), fault.into()));
}

#[test]
fn a_skinned_mesh_is_placed_by_its_joints_whatever_scales_its_node() {
    for scale in [[0.0; 3], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0], [2.0, 2.0, 2.0]] {
        let mut fixture = skinned_at(&[1.0, 0.0, 0.0, 0.0], [0; 4]);
        fixture.json["nodes"] = json!([
            {"mesh": 0, "skin": 0},
            {"translation": [0, 3, 0]},
            {"scale": scale, "rotation": [0.6, 0, 0, 0.8], "children": [0]},
        ]);
        let imported = fixture.import();
        let scene = &imported.scene;
        let is_drawn = |node: &_| matches!(scene.node_core(*node), Ok(Core::Geometry { .. }));
        let drawn = scene.subtree(imported.report.root).unwrap().find(is_drawn).unwrap();
        let world = scene.world_from_local(drawn).unwrap();
        let corners = imported.drawn(drawn).0.positions.iter().map(|p| world.transform_point3(p.as_dvec3()));
        let expected = [DVec3::Y * 3.0, DVec3::new(1.0, 3.0, 0.0), DVec3::Y * 5.0];
        for (corner, expected) in corners.zip(expected) {
            assert!((corner - expected).length() < 1e-6, "{scale:?}: {corner} instead of {expected}");
        }
        let notes = imported.notes();
        assert!(notes.len() == 1 && notes[0].contains("skin: cannot be animated"), "{scale:?}: {notes:?}");
    }
    // Hidden above, it stays hidden.
    let mut fixture = skinned_at(&[1.0, 0.0, 0.0, 0.0], [0; 4]);
    fixture.json["nodes"][0]["scale"] = json!([0, 0, 0]);
    fixture.json["nodes"][0]["extensions"] = json!({"KHR_node_visibility": {"visible": false}});
    let Imported { scene, report } = fixture.import();
    let drawn = scene.subtree(report.root).unwrap().find(|&n| matches!(scene.node_core(n), Ok(Core::Geometry { .. })));
    assert!(!scene.is_visible(drawn.unwrap()).unwrap());
}

#[test]
fn a_spot_light_without_cone_has_the_default_one() {
    let mut fixture = Fixture::new();
    fixture.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "spot"}]}});
    fixture.json["nodes"] = json!([{"extensions": {"KHR_lights_punctual": {"light": 0}}}]);
    let pointer = "/extensions/KHR_lights_punctual/lights/0";
    let Imported { scene, report } = forgiven(&fixture, pointer, GltfFault::NoProperties, &["spot", "45 degrees"]);
    let Core::Light(Light { kind, .. }) = *scene.node_core(report.lights[0].node).unwrap() else { panic!("no light") };
    let outer_cone_angle = std::f32::consts::FRAC_PI_4;
    assert_eq!(kind, LightKind::Spot { inner_cone_angle: 0.0, outer_cone_angle });
}

#[test]
fn cameras_and_lights_below_a_scale_of_zero_are_left_out() {
    let zero = TransformFault::ZeroScale;
    let mut fixture = Fixture::triangle();
    fixture.json["cameras"] =
        json!([{"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0, "zfar": 1}}]);
    fixture.json["nodes"] = json!([
        {"mesh": 0},
        {"camera": 0, "name": "eye", "scale": [0, 0, 0]},
        {"camera": 0},
    ]);
    let imported =
        forgiven(&fixture, "/nodes/1", zero, &["/nodes/1 \"eye\"", "camera 0", "scaled to zero", "left out"]);
    assert_eq!(imported.report.cameras.len(), 1);
    assert_eq!(imported.report.counts.scene_triangles, 1);

    let mut fixture = Fixture::triangle();
    fixture.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "directional"}]}});
    let light = json!({"KHR_lights_punctual": {"light": 0}});
    fixture.json["nodes"] = json!([{"mesh": 0}, {"scale": [0, 0, 0], "children": [2]}, {"extensions": light}]);
    let imported = forgiven(&fixture, "/nodes/2", zero, &["light 0", "left out"]);
    assert_eq!((imported.report.lights.len(), imported.report.counts.scene_triangles), (0, 1));
}

#[test]
fn one_broken_part_costs_that_part() {
    // A file with a camera, a light, an image and a material extension, each broken in turn.
    let mut file = with_floats("TEXCOORD_0", "VEC2", &[0.0; 6]);
    file.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 1, "znear": 1}}]);
    file.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [{"type": "point"}]}});
    let light = json!({"KHR_lights_punctual": {"light": 0}});
    file.json["nodes"] = json!([{"mesh": 0}, {"camera": 0}, {"extensions": light}]);
    let texture = json!({"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}});
    file.json["materials"] = json!([{
        "pbrMetallicRoughness": {"baseColorTexture": texture, "roughnessFactor": 0.5}, "normalTexture": texture,
        "extensions": {"KHR_materials_ior": {"ior": 1.25}, "KHR_materials_unlit": {}},
    }]);
    file.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    file.json["textures"] = json!([{"source": 0}]);
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbaImage::new(1, 1).write_to(&mut png, image::ImageFormat::Png).unwrap();
    let view = file.view(&png.into_inner());
    file.json["images"] = json!([{"bufferView": view}]);
    let whole = file.import();
    assert!(whole.report.warnings.iter().all(|w| w.kind != WarningKind::Fault), "{:?}", whole.notes());
    let counts = |imported: &Imported| (imported.report.cameras.len(), imported.report.lights.len());

    let lights = "/extensions/KHR_lights_punctual/lights/0";
    for (place, value, pointer, expected) in [
        ("/cameras/0/perspective/yfov", json!("wide"), "/cameras/0/perspective/yfov", (0, 1)),
        ("/cameras/0/perspective/yfov", json!(-1), "/cameras/0", (0, 1)),
        ("/cameras/0/perspective", Value::Null, "/cameras/0", (0, 1)),
        ("/cameras/0", json!(7), "/cameras/0", (0, 1)),
        (lights, json!({"color": [1, 1, 1]}), lights, (1, 0)),
        (lights, json!({"type": "point", "color": [1, 1]}), "/extensions/KHR_lights_punctual/lights/0/color", (1, 0)),
        (lights, json!({"type": "point", "intensity": 1e39}), lights, (1, 0)),
        (
            "/materials/0/extensions/KHR_materials_ior/ior",
            json!([1]),
            "/materials/0/extensions/KHR_materials_ior/ior",
            (1, 1),
        ),
        ("/materials/0/extensions/KHR_materials_ior/ior", json!(1e39), "/materials/0", (1, 1)),
        (
            "/materials/0/pbrMetallicRoughness/baseColorTexture/extensions/KHR_texture_transform/scale",
            json!([1]),
            "/materials/0/pbrMetallicRoughness/baseColorTexture/extensions/KHR_texture_transform/scale",
            (1, 1),
        ),
        (
            "/materials/0/normalTexture/extensions/KHR_texture_transform/scale",
            json!([1]),
            "/materials/0/normalTexture/extensions/KHR_texture_transform/scale",
            (1, 1),
        ),
        ("/images/0/mimeType", json!(5), "/images/0/mimeType", (1, 1)),
        ("/bufferViews/2/byteLength", json!(20), "/images/0", (1, 1)),
    ] {
        let mut broken = Fixture { json: file.json.clone(), bin: file.bin.clone() };
        let (parent, member) = place.rsplit_once('/').unwrap();
        match broken.json.pointer_mut(parent).unwrap() {
            Value::Array(elements) => elements[member.parse::<usize>().unwrap()] = value.clone(),
            parent => parent[member] = value.clone(),
        }
        let imported = forgiven_with(&broken, pointer, &[]);
        assert_eq!(counts(&imported), expected, "{place} = {value}");
        // What is not broken is as in the whole file.
        let material = imported.material();
        assert!(material.unlit && material.roughness == 0.5, "{place} = {value}");
        assert_eq!(material.ior, if place.ends_with("ior") { 1.5 } else { 1.25 }, "{place} = {value}");
        assert!(material.base_color_texture.is_some() && material.normal_texture.is_some(), "{place} = {value}");
        assert_eq!(imported.report.counts.scene_triangles, 1, "{place} = {value}");
    }
}

#[test]
fn a_broken_vertex_stream_is_left_out() {
    let nan = f32::NAN;
    let format = |fixture: &Fixture, role: &str| {
        let imported = forgiven_with(fixture, "/accessors/1", &[role, "left out"]);
        let geometry = imported.geometry();
        assert!(
            geometry.normals.is_none() && geometry.colors.is_none() && geometry.tex_coords == [None, None],
            "{role}"
        );
    };
    format(&with_attribute("NORMAL", F32, "VEC2", 3, &[0; 24]), "NORMAL");
    format(&with_attribute("TEXCOORD_0", F32, "VEC3", 3, &[0; 36]), "TEXCOORD_0");
    format(&with_attribute("COLOR_0", F32, "SCALAR", 3, &[0; 12]), "COLOR_0");
    // A number that is not finite, found when the data is read.
    format(&with_floats("TEXCOORD_1", "VEC2", &[0.0, 0.0, 0.0, nan, 0.0, 0.0]), "TEXCOORD_1");
    format(&with_floats("COLOR_0", "VEC3", &[0.0, 0.0, 0.0, nan, 0.0, 0.0, 0.0, 0.0, 0.0]), "COLOR_0");
    // A stream of another length.
    let fixture = with_attribute("NORMAL", F32, "VEC3", 2, &[0; 24]);
    let fault = PrimitiveFault::AttributeCount { accessor: 1, count: 2, vertex_count: 3 };
    forgiven(&fixture, "/meshes/0/primitives/0", fault, &["NORMAL", "left out"]);
    // Positions are no part that can be missed.
    let mut fixture = Fixture::triangle();
    fixture.bin[4..8].copy_from_slice(&nan.to_le_bytes());
    assert_eq!(fixture.fault(), ("/accessors/0".into(), AccessorFault::NotFinite { element: 0 }.into()));
}

#[test]
fn values_that_are_out_of_range_are_refused_by_a_strict_import_alone() {
    let mut fixture = Fixture::triangle();
    fixture.json["materials"] = json!([{"pbrMetallicRoughness": {"roughnessFactor": 1.5}}]);
    fixture.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    let fault = GltfFault::OutOfRange { what: "roughnessFactor", value: 1.5, expected: "0 to 1" };
    let imported = forgiven(&fixture, "/materials/0", fault, &["is 1.5", "1 is used"]);
    assert_eq!(imported.material().roughness, 1.0);
}

#[test]
fn a_mesh_of_which_nothing_is_seen_is_named() {
    let mut fixture = Fixture::triangle();
    fixture.json["nodes"] = json!([
        {"mesh": 0, "name": "gone", "scale": [0, 0, 1]},
        {"mesh": 0, "scale": [1, 1, 0]},
        {"mesh": 0, "scale": [1, -1, 1]},
    ]);
    let notes = fixture.import().notes();
    assert!(notes.len() == 1 && notes[0].starts_with("/nodes/0 \"gone\": scale: is zero"), "{notes:?}");

    let mut fixture = Fixture::triangle();
    let scales = fixture.floats("VEC3", &[1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    fixture.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": {"SCALE": scales}}});
    let notes = fixture.import().notes();
    assert!(notes.len() == 1 && notes[0].contains("scale: of instance 1 and 1 more is zero"), "{notes:?}");
}

#[test]
fn notes_say_what_is_the_case() {
    // A fallback only where there is one.
    let mut fixture = Fixture::triangle();
    fixture.json["textures"] = json!([
        {"source": 0, "extensions": {"KHR_texture_basisu": {"source": 0}}},
        {"extensions": {"KHR_texture_basisu": {"source": 0}}},
    ]);
    fixture.json["images"] = json!([{"uri": "a.png"}]);
    let notes = fixture.import().notes();
    assert!(
        notes[0].ends_with("the PNG or JPEG fallback is shown") && notes[0].starts_with("/textures/0"),
        "{notes:?}"
    );
    assert!(notes[1].contains("the file has no fallback") && notes[1].starts_with("/textures/1"), "{notes:?}");

    let mut fixture = Fixture::triangle();
    fixture.json["meshes"][0]["primitives"][0]["extensions"] = json!({"KHR_draco_mesh_compression": {"bufferView": 0}});
    assert!(fixture.import().notes()[0].ends_with("the uncompressed data is read"));
    fixture.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    assert!(fixture.import().notes()[0].contains("no uncompressed data"));

    // A skin that only one of two primitives lacks is applied to the other; a skin that no node uses is not applied.
    let mut fixture = skinned_at(&[1.0, 0.0, 0.0, 0.0], [0; 4]);
    let positions = json!({"attributes": {"POSITION": 0}});
    fixture.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(positions);
    fixture.json["skins"] = json!([{"joints": [1]}, {"joints": [1]}]);
    let notes = fixture.import().notes();
    assert_eq!(notes.len(), 2, "{notes:?}");
    assert!(notes[0].starts_with("/skins/0: skin: cannot be animated"), "{notes:?}");
    assert!(notes[1].starts_with("/meshes/0/primitives/1: skin: that of node 0 is not applied"), "{notes:?}");

    // Rough glass is seen through as smooth glass.
    let mut fixture = Fixture::triangle();
    let glass = |roughness: f32| {
        json!({
            "name": "glass", "pbrMetallicRoughness": {"roughnessFactor": roughness},
            "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": {}},
        })
    };
    fixture.json["meshes"][0]["primitives"][0]["material"] = json!(0);
    fixture.json["materials"] = json!([glass(0.25)]);
    let notes = fixture.import().notes();
    assert!(notes.len() == 1 && notes[0].starts_with("/materials/0 \"glass\": rough transmission"), "{notes:?}");
    fixture.json["materials"] = json!([glass(0.0)]);
    assert!(fixture.import().notes().is_empty());
}

#[test]
fn errors_and_notes_are_short_and_hold_no_control_characters() {
    let evil = "\u{1b}[31mred\u{1b}[0m\n\u{202e}".repeat(300);
    let is_harmless =
        |text: &str| text.chars().count() < 1100 && !text.chars().any(|c| c.is_control() || c == '\u{202e}');
    let mut fixture = Fixture::triangle();
    fixture.json["buffers"] = json!([{"byteLength": 36, "uri": format!("{evil}.bin")}]);
    let error = fixture.error().to_string();
    assert!(is_harmless(&error) && error.contains("\\u{1b}[31mred"), "{error}");
    let mut fixture = Fixture::triangle();
    fixture.json["extensionsRequired"] = json!([evil]);
    assert!(is_harmless(&fixture.error().to_string()));
    let mut fixture = Fixture::triangle();
    fixture.json["meshes"][0]["primitives"][0]["attributes"] = json!({ evil.as_str(): 99 });
    assert!(is_harmless(&fixture.error().to_string()));
    let mut fixture = Fixture::triangle();
    fixture.json["nodes"][0]["name"] = json!(evil);
    fixture.json["nodes"][0]["extensions"] = json!({ evil.as_str(): {} });
    fixture.json["nodes"][0]["scale"] = json!([0, 0, 0]);
    let notes = fixture.import().notes();
    assert!(notes.len() == 2 && notes.iter().all(|note| is_harmless(note)), "{notes:?}");
}
