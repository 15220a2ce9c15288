//! Files made to exhaust memory, time or the stack: each would if its counts were taken on trust.

use ropewalk::Error;
use ropewalk::gltf::{AccessorFault, BufferFault, GltfFault, ImportOptions, WarningKind};
use serde_json::{Value, json};

use super::fixture::*;

/// Counts whose product with a size overflows, or exceeds all memory.
const HUGE: [u64; 5] = [1 << 28, u32::MAX as u64, 1 << 33, u64::MAX / 12 + 1, u64::MAX];

#[test]
fn counts_beyond_the_data() {
    for count in HUGE {
        let mut fixture = Fixture::triangle();
        fixture.json["accessors"][0]["count"] = json!(count);
        let (pointer, fault) = fixture.fault();
        assert_eq!(pointer, "/accessors/0", "{count}");
        assert!(matches!(fault, GltfFault::Accessor(AccessorFault::OutOfRange { .. })), "{count}: {fault:?}");
    }
}

#[test]
fn sparse_accessors_without_a_base() {
    for count in HUGE {
        let mut fixture = Fixture::triangle();
        let view = fixture.view(&[0; 12]);
        let place = json!({"bufferView": view, "componentType": U8});
        let sparse = json!({"count": 1, "indices": place, "values": {"bufferView": view}});
        let accessor = json!({"componentType": F32, "type": "VEC3", "count": count, "sparse": sparse});
        fixture.json["accessors"][0] = accessor.clone();
        fixture.error();

        // The cost of few indices into many vertices depends on the number of indices.
        let indices = fixture.accessor(U32, "SCALAR", 3, &[0; 12]);
        fixture.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
        if count <= 1 << 28 {
            assert!(fixture.exceeds_budget());
        } else {
            fixture.error();
        }
    }
}

#[test]
fn strides_and_offsets_that_overflow_or_stand_still() {
    for (member, value) in [
        ("byteStride", json!(0)),
        ("byteStride", json!(8)),
        ("byteStride", json!(u64::MAX)),
        ("byteOffset", json!(u64::MAX)),
        ("byteOffset", json!(1_u64 << 40)),
        ("byteLength", json!(u64::MAX)),
        ("byteLength", json!(37)),
    ] {
        let mut fixture = Fixture::triangle();
        fixture.json["bufferViews"][0][member] = value.clone();
        fixture.error();
    }
    for offset in [1_u64, 1 << 40, u64::MAX] {
        let mut fixture = Fixture::triangle();
        fixture.json["accessors"][0]["byteOffset"] = json!(offset);
        fixture.error();
    }
    let mut fixture = Fixture::triangle();
    fixture.json["buffers"] = json!([{"byteLength": u64::MAX}]);
    let (pointer, fault) = fixture.fault();
    assert_eq!(pointer, "/buffers/0");
    assert!(matches!(fault, GltfFault::Buffer(BufferFault::TooShort { declared: u64::MAX, .. })), "{fault:?}");
}

#[test]
fn indices_that_are_cut_to_32_bits_elsewhere() {
    let mut fixture = Fixture::triangle();
    fixture.json["nodes"][0]["mesh"] = json!(1_u64 << 32);
    let fault = GltfFault::IndexOutOfRange { index: 1 << 32, count: 1, target: "meshes" };
    assert_eq!(fixture.fault(), ("/nodes/0/mesh".into(), fault));
}

#[test]
fn deep_nesting() {
    for (open, close) in [("[", "]"), ("{\"extras\":", "}"), ("{\"a\":[", "]}")] {
        let depth = 100_000;
        let value = format!("{}0{}", open.repeat(depth), close.repeat(depth));
        let text = format!("{{\"asset\":{{\"version\":\"2.0\"}},\"extras\":{value}}}");
        let path = std::path::Path::new("deep.gltf");
        let mut scene = ropewalk::Scene::new();
        let root = scene.root();
        let options = Default::default();
        let error = ropewalk::gltf::import_from_slice(text.as_bytes(), path, &options, &mut scene, root).unwrap_err();
        let Error::Gltf { cause: GltfFault::TooDeep { max_depth }, .. } = error else { panic!("{error:?}") };
        assert_eq!(max_depth, 127);
    }
}

#[test]
fn a_long_chain_of_nodes() {
    let count = 20_000;
    let mut fixture = Fixture::new();
    let node = |i: usize| if i + 1 < count { json!({"children": [i + 1]}) } else { json!({}) };
    fixture.json["nodes"] = (0..count).map(node).collect();
    let imported = fixture.import();
    assert_eq!(imported.report.counts.file_nodes, count);
}

/// A small file that shows something many times is limited by its size, not by the product of its counts.
#[test]
fn small_files_that_multiply() {
    let primitive: Value = json!({"attributes": {"POSITION": 0}});

    // Nodes times primitives.
    let mut fixture = Fixture::triangle();
    fixture.json["meshes"] = json!([{"primitives": vec![primitive.clone(); 2_000]}]);
    fixture.json["nodes"] = vec![json!({"mesh": 0}); 2_000].into();
    assert!(fixture.exceeds_budget());

    // Instances times primitives.
    let mut fixture = Fixture::triangle();
    fixture.json["meshes"] = json!([{"primitives": vec![primitive; 2_000]}]);
    let translations = fixture.floats("VEC3", &[0.0; 30_000]);
    let attributes = json!({"TRANSLATION": translations});
    fixture.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    assert!(fixture.exceeds_budget());

    // Instances without data.
    let mut fixture = Fixture::triangle();
    let nothing = fixture.push("accessors", json!({"componentType": F32, "type": "VEC3", "count": 1_u64 << 30}));
    let attributes = json!({"TRANSLATION": nothing});
    fixture.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}});
    assert!(fixture.exceeds_budget());

    // Accessors that overlap: each reads nearly the whole buffer.
    let mut fixture = Fixture::new();
    let view = fixture.view(&vec![0; 1 << 20]);
    let count = (1 << 20) / 12 - 1_000;
    for i in 0..900 {
        fixture.push(
            "accessors",
            json!({"bufferView": view, "byteOffset": 12 * i, "componentType": F32, "type": "VEC3", "count": count}),
        );
    }
    let primitives = (0..900).map(|i| json!({"attributes": {"POSITION": i}})).collect::<Value>();
    fixture.json["meshes"] = json!([{ "primitives": primitives }]);
    fixture.json["nodes"] = json!([{"mesh": 0}]);
    assert!(fixture.exceeds_budget());
    // Index accessors that overlap, in meshes that no node shows.
    for accessor in fixture.json["accessors"].as_array_mut().unwrap() {
        *accessor = json!({"bufferView": view, "byteOffset": accessor["byteOffset"], "componentType": U8, "type": "SCALAR", "count": 1_000_000});
    }
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let primitive = |i| json!({"attributes": {"POSITION": positions}, "indices": i});
    let primitives = (0..900).map(primitive).collect::<Value>();
    fixture.json["meshes"] = json!([{ "primitives": primitives }]);
    fixture.json["nodes"] = json!([]);
    assert!(fixture.exceeds_budget());
}

/// A million notes would take more memory than the file: of each kind a thousand are listed, the others counted.
#[test]
fn notes_beyond_a_thousand_of_a_kind_are_counted() {
    let mut fixture = Fixture::new();
    fixture.json["animations"] = vec![json!({}); 3_000].into();
    let report = fixture.import().report;
    assert_eq!(report.warnings.len(), 1_000);
    assert_eq!(report.warnings[999].pointer, "/animations/999");
    let [more] = report.unlisted_warnings.as_slice() else { panic!("{:?}", report.unlisted_warnings) };
    assert_eq!((more.kind, &*more.feature, more.count), (WarningKind::Feature, "animation", 2_000));
    assert_eq!(more.to_string(), "2000 more: animation");

    // Each note is about another feature.
    let names = (0..12_000).map(|i| (format!("EXT_{i}"), json!({}))).collect::<serde_json::Map<_, _>>();
    let mut fixture = Fixture::new();
    fixture.json["nodes"] = json!([{ "extensions": names }]);
    let report = fixture.import().report;
    assert_eq!(report.warnings.len(), 10_000);
    let [more] = report.unlisted_warnings.as_slice() else { panic!("{:?}", report.unlisted_warnings) };
    assert_eq!((more.kind, &*more.feature, more.count), (WarningKind::Extension, "", 2_000));
}

#[test]
fn an_application_can_allow_less_memory_than_the_file_justifies() {
    let fixture = Fixture::triangle();
    let import = |limit| fixture.try_import_with(&ImportOptions::default().with_memory_limit(limit)).err();
    assert!(import(1 << 20).is_none());
    let Some(Error::Gltf { cause, .. }) = import(1 << 10) else { panic!("imports in 1 KiB") };
    assert_eq!(cause, GltfFault::Budget { limit_bytes: 1 << 10 });
}
