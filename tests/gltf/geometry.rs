//! Accessors and primitives.

use glam::{Vec2, Vec3, Vec4};
use serde_json::json;

use super::fixture::*;

/// The corners of every triangle, in order.
fn corners(geometry: &ropewalk::Geometry) -> Vec<Vec3> {
    geometry.indices.iter().flatten().map(|&i| geometry.positions[i as usize]).collect()
}

#[test]
fn indices_of_every_type_and_none_make_the_same_triangles() {
    let positions: Vec<f32> = (0..12).map(|i| i as f32).collect();
    let order = [2_u8, 0, 1, 3, 1, 2];
    let p = |i: u8| Vec3::new(f32::from(i) * 3.0, f32::from(i) * 3.0 + 1.0, f32::from(i) * 3.0 + 2.0);
    let expected: Vec<Vec3> = order.iter().map(|&i| p(i)).collect();

    let indexed = |component: u32, bytes: &[u8]| {
        let mut fixture = Fixture::new();
        let positions = fixture.floats("VEC3", &positions);
        let indices = fixture.accessor(component, "SCALAR", order.len(), bytes);
        fixture.with_primitive(json!({"attributes": {"POSITION": positions}, "indices": indices})).import()
    };
    assert_eq!(corners(indexed(U8, &order).geometry()), expected);
    assert_eq!(corners(indexed(U16, bytemuck::cast_slice(&order.map(u16::from))).geometry()), expected);
    assert_eq!(corners(indexed(U32, bytemuck::cast_slice(&order.map(u32::from))).geometry()), expected);

    let mut fixture = Fixture::new();
    let unrolled: Vec<f32> = expected.iter().flat_map(Vec3::to_array).collect();
    let positions = fixture.floats("VEC3", &unrolled);
    let imported = fixture.with_primitive(json!({"attributes": {"POSITION": positions}})).import();
    assert_eq!(corners(imported.geometry()), expected);
}

#[test]
fn vertices_that_no_triangle_uses_are_left_out() {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &(0..300).map(|i| i as f32).collect::<Vec<_>>());
    let colors = fixture.accessor(U8, "VEC4", 100, &(0..400).map(|i| (i / 4) as u8).collect::<Vec<_>>());
    fixture.json["accessors"][colors]["normalized"] = json!(true);
    let indices = fixture.accessor(U8, "SCALAR", 3, &[90, 10, 50]);
    let attributes = json!({"POSITION": positions, "COLOR_0": colors});
    let imported = fixture.with_primitive(json!({"attributes": attributes, "indices": indices})).import();
    let geometry = imported.geometry();
    assert_eq!(geometry.positions.len(), 3);
    assert_eq!(corners(geometry).iter().map(|p| p.x).collect::<Vec<_>>(), [270.0, 30.0, 150.0]);
    let colors = geometry.colors.as_ref().unwrap();
    assert_eq!(geometry.indices[0].map(|i| colors[i as usize].x), [90.0 / 255.0, 10.0 / 255.0, 50.0 / 255.0]);
}

#[test]
fn integers_are_read_as_they_are_or_as_fractions() {
    let quantized = |component: u32, normalized: bool, bytes: &[u8]| {
        let mut fixture = Fixture::new();
        let positions = fixture.accessor(component, "VEC3", 3, bytes);
        fixture.json["accessors"][positions]["normalized"] = json!(normalized);
        fixture.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
        let imported = fixture.with_primitive(json!({"attributes": {"POSITION": positions}})).import();
        imported.geometry().positions[0]
    };
    let i8s = [-128_i8, -127, 64, 0, 0, 0, 0, 0, 0].map(|i| i as u8);
    assert_eq!(quantized(I8, false, &i8s), Vec3::new(-128.0, -127.0, 64.0));
    // -128 is clamped: the most negative integer has no positive counterpart.
    assert_eq!(quantized(I8, true, &i8s), Vec3::new(-1.0, -1.0, 64.0 / 127.0));
    let u8s = [255_u8, 51, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(quantized(U8, false, &u8s), Vec3::new(255.0, 51.0, 0.0));
    assert_eq!(quantized(U8, true, &u8s), Vec3::new(1.0, 0.2, 0.0));
    let i16s = [-32768_i16, 32767, 1, 0, 0, 0, 0, 0, 0];
    assert_eq!(quantized(I16, false, bytemuck::cast_slice(&i16s)), Vec3::new(-32768.0, 32767.0, 1.0));
    assert_eq!(quantized(I16, true, bytemuck::cast_slice(&i16s)), Vec3::new(-1.0, 1.0, 1.0 / 32767.0));
    let u16s = [65535_u16, 13107, 1, 0, 0, 0, 0, 0, 0];
    assert_eq!(quantized(U16, true, bytemuck::cast_slice(&u16s)), Vec3::new(1.0, 0.2, 1.0 / 65535.0));
}

#[test]
fn interleaved_attributes_with_padding() {
    let mut fixture = Fixture::new();
    // A position, a normal and a padded colour for each of three vertices: 12 + 12 + 3 + 1 bytes.
    let mut bytes = Vec::new();
    for i in 0..3_u8 {
        let x = f32::from(i);
        bytes.extend(bytemuck::cast_slice(&[x, x * x, 1.0, 0.0, 0.0, x + 1.0]));
        bytes.extend([255 * (i % 2), 0, 255, 99]);
    }
    let view = fixture.view(&bytes);
    fixture.json["bufferViews"][view]["byteStride"] = json!(28);
    let mut accessor = |offset: u32, component: u32, normalized: bool| {
        fixture.push("accessors", json!({"bufferView": view, "byteOffset": offset, "componentType": component, "normalized": normalized, "type": "VEC3", "count": 3}))
    };
    let (positions, normals, colors) = (accessor(0, F32, false), accessor(12, F32, false), accessor(24, U8, true));
    let attributes = json!({"POSITION": positions, "NORMAL": normals, "COLOR_0": colors});
    let imported = fixture.with_primitive(json!({"attributes": attributes})).import();
    let geometry = imported.geometry();
    assert_eq!(*geometry.positions, [Vec3::new(0.0, 0.0, 1.0), Vec3::new(1.0, 1.0, 1.0), Vec3::new(2.0, 4.0, 1.0)]);
    assert_eq!(**geometry.normals.as_ref().unwrap(), [Vec3::Z; 3]);
    let blue = Vec4::new(0.0, 0.0, 1.0, 1.0);
    assert_eq!(**geometry.colors.as_ref().unwrap(), [blue, Vec4::new(1.0, 0.0, 1.0, 1.0), blue]);
}

#[test]
fn sparse_accessors_with_and_without_a_base() {
    for (with_base, others) in [(true, 7.0), (false, 0.0)] {
        for (component, indices) in [(U8, &[1_u8, 4][..]), (U16, &[1, 0, 4, 0]), (U32, &[1, 0, 0, 0, 4, 0, 0, 0])] {
            let mut fixture = Fixture::new();
            let base = fixture.view(bytemuck::cast_slice(&[7.0_f32; 18]));
            let indices = fixture.view(indices);
            let values = fixture.view(bytemuck::cast_slice(&[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0]));
            let sparse = json!({"count": 2, "indices": {"bufferView": indices, "componentType": component}, "values": {"bufferView": values}});
            let mut accessor = json!({"componentType": F32, "type": "VEC3", "count": 6, "sparse": sparse});
            if with_base {
                accessor["bufferView"] = json!(base);
            }
            let positions = fixture.push("accessors", accessor);
            let mut expected = [Vec3::splat(others); 6];
            (expected[1], expected[4]) = (Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.0));
            let imported = fixture.with_primitive(json!({"attributes": {"POSITION": positions}})).import();
            assert_eq!(*imported.geometry().positions, expected);
        }
    }
}

#[test]
fn sparse_values_reach_a_selection_of_vertices() {
    let mut fixture = Fixture::new();
    let indices = fixture.view(&[1, 3]);
    let values = fixture.view(bytemuck::cast_slice(&[1.0_f32, 2.0, 3.0, 4.0, 5.0, 6.0]));
    let sparse =
        json!({"count": 2, "indices": {"bufferView": indices, "componentType": U8}, "values": {"bufferView": values}});
    let positions =
        fixture.push("accessors", json!({"componentType": F32, "type": "VEC3", "count": 9, "sparse": sparse}));
    let order = fixture.accessor(U8, "SCALAR", 3, &[3, 2, 8]);
    let primitive = json!({"attributes": {"POSITION": positions}, "indices": order});
    let imported = fixture.with_primitive(primitive).import();
    assert_eq!(corners(imported.geometry()), [Vec3::new(4.0, 5.0, 6.0), Vec3::ZERO, Vec3::ZERO]);
}

#[test]
fn strips_fans_and_what_is_no_triangle() {
    let import = |mode: u32| {
        let mut fixture = Fixture::new();
        let positions = fixture.floats("VEC3", &(0..15).map(|i| i as f32).collect::<Vec<_>>());
        fixture.with_primitive(json!({"attributes": {"POSITION": positions}, "mode": mode})).import()
    };
    assert_eq!(*import(4).geometry().indices, [[0, 1, 2]]);
    assert_eq!(*import(5).geometry().indices, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
    assert_eq!(*import(6).geometry().indices, [[1, 2, 0], [2, 3, 0], [3, 4, 0]]);
    for (mode, name) in [(0, "points"), (1, "lines"), (2, "lines"), (3, "lines")] {
        let imported = import(mode);
        assert!(imported.geometry_nodes(0).is_empty());
        assert_eq!(imported.notes(), [format!("/meshes/0/primitives/0: {name}: not drawn: only triangles are")]);
    }
}

#[test]
fn colours_of_every_type() {
    let import = |component: u32, shape: &str, bytes: &[u8]| {
        let mut fixture = Fixture::new();
        let positions = fixture.floats("VEC3", &TRIANGLE);
        let colors = fixture.accessor(component, shape, 3, bytes);
        fixture.json["accessors"][colors]["normalized"] = json!(component != F32);
        let attributes = json!({"POSITION": positions, "COLOR_0": colors});
        let imported = fixture.with_primitive(json!({"attributes": attributes})).import();
        imported.geometry().colors.as_ref().unwrap()[0]
    };
    let floats = |values: &[f32]| bytemuck::cast_slice(values).to_vec();
    let (rgb, rgba) = (Vec4::new(1.0, 0.2, 0.0, 1.0), Vec4::new(1.0, 0.2, 0.0, 0.4));
    assert_eq!(import(F32, "VEC3", &floats(&[1.0, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])), rgb);
    assert_eq!(import(F32, "VEC4", &floats(&[[7.0, 0.2, -1.0, 0.4]; 3].concat())), rgba);
    assert_eq!(import(U8, "VEC3", &[255, 51, 0, 0, 0, 0, 0, 0, 0]), rgb);
    assert_eq!(import(U8, "VEC4", &[[255, 51, 0, 102]; 3].concat()), rgba);
    assert_eq!(import(U16, "VEC3", bytemuck::cast_slice(&[[65535_u16, 13107, 0]; 3])), rgb);
    assert_eq!(import(U16, "VEC4", bytemuck::cast_slice(&[[65535_u16, 13107, 0, 26214]; 3])), rgba);
}

#[test]
fn two_sets_of_texture_coordinates() {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let first = fixture.floats("VEC2", &[0.0, 0.5, 1.0, 1.5, 2.0, -2.5]);
    let second = fixture.accessor(U16, "VEC2", 3, bytemuck::cast_slice(&[0_u16, 13107, 65535, 0, 0, 0]));
    fixture.json["accessors"][second]["normalized"] = json!(true);
    let attributes = json!({"POSITION": positions, "TEXCOORD_0": first, "TEXCOORD_1": second});
    let imported = fixture.with_primitive(json!({"attributes": attributes})).import();
    let [first, second] = &imported.geometry().tex_coords;
    assert_eq!(**first.as_ref().unwrap(), [Vec2::new(0.0, 0.5), Vec2::new(1.0, 1.5), Vec2::new(2.0, -2.5)]);
    assert_eq!(**second.as_ref().unwrap(), [Vec2::new(0.0, 0.2), Vec2::X, Vec2::ZERO]);
}

#[test]
fn normals_get_length_one() {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let normals = fixture.floats("VEC3", &[0.0, 0.0, 5.0, 3.0, 0.0, 4.0, 0.0, 0.0, 0.0]);
    let attributes = json!({"POSITION": positions, "NORMAL": normals});
    let imported = fixture.with_primitive(json!({"attributes": attributes})).import();
    let expected = [Vec3::Z, Vec3::new(0.6, 0.0, 0.8), Vec3::Z];
    assert_eq!(**imported.geometry().normals.as_ref().unwrap(), expected);
}

#[test]
fn no_normals_mean_flat_shading() {
    assert_eq!(Fixture::triangle().import().geometry().normals, None);
}
