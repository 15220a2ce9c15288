//! Materials, textures and images.

use std::io::Cursor;
use std::path::Path;

use base64::Engine;
use glam::{Affine2, Vec2, Vec3, Vec4};
use image::{DynamicImage, ImageFormat, RgbaImage};
use ropewalk::gltf::{self, BufferFault, GltfFault, ImportOptions, UriFault, WarningKind};
use ropewalk::graph::{AlphaMode, FilterMode, Sampler, TextureRef, WallKind, WrapMode};
use ropewalk::{Material, Scene, Texture};
use serde_json::{Value, json};

use super::fixture::*;
use ropewalk_testkit::Mesh;

/// A file whose triangle has this material, and two sets of texture coordinates.
fn with_material(material: Value) -> Fixture {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let uv = fixture.floats("VEC2", &[0.0; 6]);
    fixture.json["materials"] = json!([material]);
    let attributes = json!({"POSITION": positions, "TEXCOORD_0": uv, "TEXCOORD_1": uv});
    fixture.with_primitive(json!({"attributes": attributes, "material": 0}))
}

/// A 2 x 1 image, red and half transparent green, as a file.
fn encoded(format: ImageFormat) -> Vec<u8> {
    let image = RgbaImage::from_raw(2, 1, vec![255, 0, 0, 255, 0, 255, 0, 128]).unwrap();
    let mut bytes = Cursor::new(Vec::new());
    let image = DynamicImage::from(image);
    let image = if format == ImageFormat::Jpeg { image.to_rgb8().into() } else { image };
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// A file whose base colour texture is this image object; its buffer holds the PNG in view 2.
fn with_image(image: Value) -> Fixture {
    let mut fixture = with_material(json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}));
    let view = fixture.view(&encoded(ImageFormat::Png));
    assert_eq!(view, 2);
    fixture.json["textures"] = json!([{"source": 0}]);
    fixture.json["images"] = json!([image]);
    fixture
}

fn texture(imported: &Imported) -> &Texture {
    let reference = imported.material().base_color_texture.unwrap();
    imported.scene.texture(reference.texture).unwrap()
}

fn assert_is_placeholder(imported: &Imported, cause: &str) {
    let placeholder = texture(imported);
    assert!(placeholder.texels.contains(&[255, 0, 255, 255]) && placeholder.texels.contains(&[0, 0, 0, 255]));
    assert_eq!(placeholder.texels.len(), (placeholder.width * placeholder.height) as usize);
    let notes = imported.notes();
    assert!(notes.iter().any(|n| n.contains(cause) && n.contains("checkerboard")), "{cause}: {notes:?}");
}

#[test]
fn every_factor() {
    let imported = with_material(json!({
        "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.6},
        "emissiveFactor": [0.5, 0.25, 1], "alphaMode": "MASK", "alphaCutoff": 0.7, "doubleSided": true,
        "extensions": {
            "KHR_materials_emissive_strength": {"emissiveStrength": 4},
            "KHR_materials_ior": {"ior": 1.33},
            "KHR_materials_transmission": {"transmissionFactor": 0.8},
            "KHR_materials_unlit": {},
            "KHR_materials_volume": {"thicknessFactor": 0.1},
        },
    }))
    .import();
    let expected = Material {
        base_color: Vec4::new(0.1, 0.2, 0.3, 0.4),
        metallic: 0.5,
        roughness: 0.6,
        emissive: Vec3::new(2.0, 1.0, 4.0),
        alpha_mode: AlphaMode::Mask { cutoff: 0.7 },
        double_sided: true,
        transmission: 0.8,
        ior: 1.33,
        wall: WallKind::Solid,
        unlit: true,
        ..Material::default()
    };
    assert_eq!(*imported.material(), expected);
    assert!(imported.notes().is_empty(), "{:?}", imported.notes());
}

/// A file that shows the cube from -1 to 1, without its top if it is open, with this material.
fn with_cube(material: Value, open: bool) -> Fixture {
    let mut fixture = Fixture::new();
    let cube = Mesh::cube();
    let positions = fixture.floats("VEC3", bytemuck::cast_slice(&cube.positions));
    let faces = if open { &cube.indices[2..] } else { &cube.indices[..] };
    let indices = fixture.accessor(U32, "SCALAR", 3 * faces.len(), bytemuck::cast_slice(faces));
    fixture.json["materials"] = json!([material]);
    fixture.with_primitive(json!({"attributes": {"POSITION": positions}, "indices": indices, "material": 0}))
}

#[test]
fn thickness_decides_what_glass_bounds() {
    let glass = |volume: Value| {
        let mut material = json!({
            "pbrMetallicRoughness": {"roughnessFactor": 0},
            "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}},
        });
        if !volume.is_null() {
            material["extensions"]["KHR_materials_volume"] = volume;
        }
        material
    };
    for (volume, expected) in [
        (json!({}), WallKind::Thin),
        (json!({"thicknessFactor": 0}), WallKind::Thin),
        (json!({"thicknessFactor": 0.5, "attenuationColor": [0.5, 1, 1]}), WallKind::Solid),
    ] {
        for open in [false, true] {
            let options = ImportOptions::default().with_wall(WallKind::Thin);
            for options in [ImportOptions::default(), options] {
                let imported = with_cube(glass(volume.clone()), open).try_import_with(&options).unwrap();
                assert_eq!((imported.material().wall, imported.notes()), (expected, vec![]), "{volume}");
            }
        }
    }
    // Light that would lose colour on its way is reported, where there is a way.
    for (thickness, notes) in [(0.0, 0), (0.5, 1)] {
        let colored = json!({"thicknessFactor": thickness, "attenuationColor": [0.5, 1, 1], "attenuationDistance": 2});
        let imported = with_cube(glass(colored), false).import();
        assert_eq!(imported.notes().len(), notes, "{:?}", imported.notes());
        assert!(imported.notes().iter().all(|note| note.contains("attenuation") && note.contains("without loss")));
    }
    // Without the extension the mesh is judged, and the report says so and names it.
    for (open, taken) in [(false, "a solid"), (true, "a thin wall")] {
        let mut fixture = with_cube(glass(Value::Null), open);
        fixture.json["meshes"][0]["name"] = json!("jar");
        let imported = fixture.import();
        assert_eq!(imported.material().wall, WallKind::Auto);
        let [note] = &imported.report.warnings[..] else { panic!("{:?}", imported.notes()) };
        assert_eq!((note.kind, &*note.pointer, &*note.name), (WarningKind::Guess, "/meshes/0/primitives/0", "jar"));
        assert!(note.fallback.contains(taken), "{note}");
        for wall in [WallKind::Thin, WallKind::Solid] {
            let imported = fixture.try_import_with(&ImportOptions::default().with_wall(wall)).unwrap();
            assert_eq!((imported.material().wall, imported.notes()), (wall, vec![]));
        }
    }
    // What transmits nothing is not judged.
    assert!(with_cube(json!({}), false).import().notes().is_empty());
}

#[test]
fn defaults_are_those_of_gltf() {
    let expected = Material { metallic: 1.0, roughness: 1.0, double_sided: false, ..Material::default() };
    assert_eq!(*with_material(json!({})).import().material(), expected);
    assert_eq!(*Fixture::triangle().import().material(), expected);
    let blend = with_material(json!({"alphaMode": "BLEND"})).import();
    assert_eq!(blend.material().alpha_mode, AlphaMode::Blend);
    let mask = with_material(json!({"alphaMode": "MASK"})).import();
    assert_eq!(mask.material().alpha_mode, AlphaMode::Mask { cutoff: 0.5 });
    let infinite = with_material(json!({"extensions": {"KHR_materials_ior": {"ior": 0}}})).import();
    assert_eq!(infinite.material().ior, 0.0);
    assert!(infinite.notes().is_empty());
}

#[test]
fn numbers_out_of_range_are_put_right_and_reported() {
    let imported = with_material(json!({
        "pbrMetallicRoughness": {"baseColorFactor": [1.5, 0, -1, 1], "metallicFactor": 2, "roughnessFactor": -3},
        "emissiveFactor": [1, 0, 0], "alphaMode": "MASK", "alphaCutoff": -1,
        "extensions": {
            "KHR_materials_emissive_strength": {"emissiveStrength": 3e38},
            "KHR_materials_ior": {"ior": 0.5},
            "KHR_materials_transmission": {"transmissionFactor": 9},
            "KHR_materials_volume": {"thicknessFactor": -1},
        },
    }))
    .import();
    let material = imported.material();
    assert_eq!(material.base_color, Vec4::new(1.0, 0.0, 0.0, 1.0));
    assert_eq!((material.metallic, material.roughness, material.transmission, material.ior), (1.0, 0.0, 1.0, 1.0));
    assert_eq!(material.alpha_mode, AlphaMode::Mask { cutoff: 0.0 });
    assert_eq!(imported.notes().len(), 8, "{:?}", imported.notes());
    assert!(imported.notes()[0].contains("baseColorFactor: is 1.5, outside of its range: 1 is used"));

    let infinite = with_material(json!({"pbrMetallicRoughness": {"metallicFactor": 1e39}}));
    let not_finite = GltfFault::NotFinite { what: "metallicFactor" };
    assert_eq!(infinite.fault(), ("/materials/0".into(), not_finite));
    let solid = with_material(json!({"alphaMode": "SOLID"}));
    assert_eq!(solid.fault(), ("/materials/0/alphaMode".into(), GltfFault::UnknownMode));
}

#[test]
fn every_texture_with_its_sampler_set_and_transform() {
    let transform = json!({"offset": [0.5, 0.25], "scale": [2, 3], "texCoord": 1});
    let mut fixture = with_material(json!({
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": transform}},
            "metallicRoughnessTexture": {"index": 1, "texCoord": 1},
        },
        "normalTexture": {"index": 2, "scale": 0.5, "extensions": {"KHR_texture_transform": transform}},
        "emissiveTexture": {"index": 0},
        "occlusionTexture": {"index": 0},
        "extensions": {"KHR_materials_transmission": {"transmissionTexture": {"index": 1}}},
    }));
    fixture.json["extensionsRequired"] = json!(["KHR_texture_transform"]);
    let view = fixture.view(&encoded(ImageFormat::Png));
    fixture.json["images"] = json!([{"bufferView": view, "mimeType": "image/png"}]);
    fixture.json["samplers"] = json!([
        {"magFilter": 9728, "minFilter": 9728, "wrapS": 33071, "wrapT": 33648},
        {"magFilter": 9729, "minFilter": 9987, "wrapS": 10497},
    ]);
    fixture.json["textures"] = json!([{"source": 0, "sampler": 0}, {"source": 0, "sampler": 1}, {"source": 0}]);
    let imported = fixture.import();
    let material = imported.material();

    let transform =
        Affine2::from_mat2_translation(glam::Mat2::from_diagonal(Vec2::new(2.0, 3.0)), Vec2::new(0.5, 0.25));
    let base_color = material.base_color_texture.unwrap();
    let nearest = Sampler { wrap_u: WrapMode::Clamp, wrap_v: WrapMode::Mirror, filter: FilterMode::Nearest };
    let texture = base_color.texture;
    assert_eq!(base_color, TextureRef { texture, sampler: nearest, tex_coord: 1, transform });
    let plain = TextureRef::new(texture);
    assert_eq!(material.metallic_roughness_texture, Some(TextureRef { tex_coord: 1, ..plain }));
    assert_eq!(material.normal_texture, Some(TextureRef { tex_coord: 1, transform, ..plain }));
    assert_eq!(material.normal_scale, 0.5);
    assert_eq!(material.emissive_texture, Some(TextureRef { sampler: nearest, ..plain }));
    assert_eq!(material.transmission_texture, Some(plain));
    assert_eq!(imported.scene.texture_count(), 1);

    let notes = imported.notes();
    assert_eq!(notes.len(), 2, "{notes:?}");
    assert!(notes[0].starts_with("/materials/0: occlusion texture"));
    assert!(notes[1].starts_with("/samplers/1: minFilter and mipmaps"));
}

#[test]
fn texture_coordinates_that_are_not_there_are_reported() {
    let mut fixture = with_image(json!({"bufferView": 2}));
    fixture.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = json!(2);
    let imported = fixture.import();
    assert_eq!(imported.material().base_color_texture, None);
    assert!(imported.notes()[0].contains("texture coordinate set 2"));

    let mut fixture = with_image(json!({"bufferView": 2}));
    fixture.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut().unwrap().remove("TEXCOORD_0");
    let imported = fixture.import();
    assert!(imported.notes()[0].contains("missing texture coordinates"), "{:?}", imported.notes());
}

#[test]
fn images_from_everywhere() {
    let folder = tempfile::tempdir().unwrap();
    let png = encoded(ImageFormat::Png);
    std::fs::write(folder.path().join("caf\u{e9} \u{2764}.png"), &png).unwrap();
    let base64 = base64::engine::general_purpose::STANDARD.encode(&png);
    let percent: String = png.iter().map(|byte| format!("%{byte:02X}")).collect();
    for image in [
        json!({"bufferView": 2, "mimeType": "image/png"}),
        // The MIME type that the file gives is wrong.
        json!({"bufferView": 2, "mimeType": "image/jpeg"}),
        json!({"uri": format!("data:image/png;base64,{base64}")}),
        json!({"uri": format!("data:image/png,{percent}")}),
        json!({"uri": "caf%C3%A9%20%E2%9D%A4.png"}),
        json!({"uri": "caf\u{e9} \u{2764}.png"}),
        json!({"uri": "./nowhere/../caf\u{e9} \u{2764}.png"}),
    ] {
        std::fs::create_dir_all(folder.path().join("nowhere")).unwrap();
        let mut scene = Scene::new();
        let root = scene.root();
        let path = folder.path().join("scene.glb");
        std::fs::write(&path, with_image(image.clone()).glb()).unwrap();
        let report = gltf::import(&path, &mut scene, root).unwrap();
        let imported = Imported { scene, report };
        assert_eq!(*texture(&imported).texels, [[255, 0, 0, 255], [0, 255, 0, 128]], "{image}");
        assert!(imported.notes().is_empty(), "{:?}", imported.notes());
    }
}

#[test]
fn jpeg_images() {
    let mut fixture = with_image(json!({"bufferView": 3}));
    fixture.view(&encoded(ImageFormat::Jpeg));
    let imported = fixture.import();
    let texture = texture(&imported);
    assert_eq!((texture.width, texture.height), (2, 1));
    assert_eq!(texture.texels[0][3], 255);
    assert!(imported.notes().is_empty());
}

#[test]
fn images_that_cannot_be_had_are_replaced_by_a_checkerboard() {
    let png = encoded(ImageFormat::Png);
    let base64 = |bytes: &[u8]| base64::engine::general_purpose::STANDARD.encode(bytes);
    for (image, cause) in [
        (json!({"uri": "missing.png"}), "missing.png cannot be read"),
        (json!({"uri": "http://example.com/a.png"}), "\"http:\" is not supported"),
        (json!({"uri": "/etc/hostname"}), "absolute path"),
        (json!({"uri": "data:image/png;base64,????"}), "not valid base64"),
        (json!({"uri": format!("data:image/png;base64,{}", base64(&png[..png.len() - 20]))}), "image"),
        (json!({"uri": "data:image/webp;base64,UklGRhwAAABXRUJQ"}), "neither PNG nor JPEG"),
        (json!({"bufferView": 0}), "neither PNG nor JPEG"),
        (json!({}), "neither a bufferView nor a URI"),
    ] {
        assert_is_placeholder(&with_image(image).import(), cause);
    }
    let mut fixture = with_image(json!({"bufferView": 2}));
    fixture.json["textures"] = json!([{"extensions": {"KHR_texture_basisu": {"source": 0}}}]);
    assert_is_placeholder(&fixture.import(), "no image that can be read");
}

#[test]
fn an_image_that_claims_to_be_huge_is_not_decoded() {
    // A PNG of 2 x 1 whose header says 16,000 x 16,000: right in its checksum, but out of proportion to its size.
    let mut png = encoded(ImageFormat::Png);
    png[16..20].copy_from_slice(&16_000_u32.to_be_bytes());
    png[20..24].copy_from_slice(&16_000_u32.to_be_bytes());
    let checksum = crc32(&png[12..29]);
    png[29..33].copy_from_slice(&checksum.to_be_bytes());
    let mut fixture = with_image(json!({"bufferView": 3}));
    fixture.view(&png);
    assert_is_placeholder(&fixture.import(), "16000 x 16000 texels, with the others out of proportion");

    png[16..20].copy_from_slice(&60_000_u32.to_be_bytes());
    let checksum = crc32(&png[12..29]);
    png[29..33].copy_from_slice(&checksum.to_be_bytes());
    let mut fixture = with_image(json!({"bufferView": 3}));
    fixture.view(&png);
    assert_is_placeholder(&fixture.import(), "more than 16384 on a side");
}

/// The checksum of PNG chunks.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0_u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 })
    })
}

#[test]
fn external_and_embedded_buffers() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("sub folder")).unwrap();
    let mut fixture = Fixture::triangle();
    std::fs::write(folder.path().join("sub folder/tri angle.bin"), &fixture.bin).unwrap();
    let percent: String = fixture.bin.iter().map(|byte| format!("%{byte:02x}")).collect();
    let base64 = base64::engine::general_purpose::STANDARD.encode(&fixture.bin);
    for uri in [
        "sub%20folder/tri%20angle.bin".to_owned(),
        "sub folder/tri angle.bin".into(),
        format!("data:application/octet-stream;base64,{base64}"),
        format!("data:application/gltf-buffer;base64,{}", base64.trim_end_matches('=')),
        format!("data:,{percent}"),
    ] {
        fixture.json["buffers"] = json!([{"byteLength": 36, "uri": uri}]);
        let text = fixture.json.to_string();
        let mut scene = Scene::new();
        let root = scene.root();
        let path = folder.path().join("scene.gltf");
        let report =
            gltf::import_from_slice(text.as_bytes(), &path, &ImportOptions::default(), &mut scene, root).unwrap();
        let imported = Imported { scene, report };
        assert_eq!(*imported.geometry().positions, [Vec3::ZERO, Vec3::X, Vec3::Y * 2.0], "{uri}");
    }
    fixture.json["buffers"] = json!([{"byteLength": 36, "uri": "gone.bin"}]);
    let (pointer, fault) = fixture.fault();
    assert_eq!(pointer, "/buffers/0");
    let GltfFault::Buffer(BufferFault::Uri(UriFault::Io { path, kind, .. })) = fault else { panic!("{fault:?}") };
    assert_eq!((path.as_path(), kind), (Path::new("gone.bin"), std::io::ErrorKind::NotFound));
    fixture.json["buffers"] = json!([{"byteLength": 36, "uri": "data:;base64,AAAA"}]);
    let too_short = BufferFault::TooShort { found: 3, declared: 36 };
    assert_eq!(fixture.fault(), ("/buffers/0".into(), too_short.into()));
    assert!(gltf::import(Path::new("/dev/null"), &mut Scene::new(), Default::default()).is_err());
}

#[test]
fn extensions_that_are_not_honoured() {
    let mut fixture = with_material(json!({
        "name": "Lack", "extensions": {"KHR_materials_clearcoat": {}},
        "extras": {"extensions": {"NOT_an_extension": {}}},
    }));
    fixture.json["extensionsUsed"] = json!(["KHR_materials_clearcoat"]);
    fixture.json["extensions"] = json!({"VENDOR_x": {}});
    let imported = fixture.import();
    let expected = [
        "/: VENDOR_x: not supported: ignored",
        "/materials/0 \"Lack\": KHR_materials_clearcoat: not supported: shown without its clear coat",
    ];
    assert_eq!(imported.notes(), expected);
    assert!(imported.report.warnings.iter().all(|warning| warning.kind == WarningKind::Extension));

    fixture.json["extensionsRequired"] = json!(["KHR_texture_transform", "KHR_draco_mesh_compression"]);
    assert_eq!(
        fixture.error().to_string(),
        "fixture.glb: requires the extension KHR_draco_mesh_compression, which is not supported"
    );
}
