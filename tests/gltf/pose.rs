//! The rest pose: morph targets and skins, applied once.

use glam::{DVec3, Vec3};
use ropewalk::gltf::{AccessorFault, GltfFault, PrimitiveFault, SkinFault};
use serde_json::json;

use super::fixture::*;

#[test]
fn morph_targets_are_added_by_their_default_weights() {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let normals = fixture.floats("VEC3", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let up = fixture.floats("VEC3", &[0.0, 0.0, 8.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let tilt = fixture.floats("VEC3", &[0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let targets = json!([{"POSITION": up}, {"POSITION": tilt, "NORMAL": tilt}]);
    let primitive = json!({"attributes": {"POSITION": positions, "NORMAL": normals}, "targets": targets});
    let mut fixture = fixture.with_primitive(primitive);

    // Without weights no morph target is applied.
    let imported = fixture.import();
    assert_eq!(imported.geometry().positions[0], Vec3::ZERO);
    assert!(imported.notes()[0].contains("morph targets: cannot be animated"));

    // The mesh's weights, and a node's own instead.
    fixture.json["meshes"][0]["weights"] = json!([0.25, 0.5]);
    fixture.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0, "weights": [-1, 0]}, {"mesh": 0}]);
    let imported = fixture.import();
    let geometry = imported.geometry();
    assert_eq!(*geometry.positions, [Vec3::Z * 2.0, Vec3::X * 2.0, Vec3::Y * 2.0]);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let normals = geometry.normals.as_ref().unwrap();
    assert!((normals[1] - Vec3::new(half, 0.0, half)).length() < 1e-6, "{normals:?}");
    let other = imported.drawn(imported.geometry_nodes(1)[0]).0;
    assert_eq!(*other.positions, [Vec3::Z * -8.0, Vec3::X, Vec3::Y * 2.0]);
    // Nodes with the same weights share the geometry and the core.
    let core = |i: usize| imported.scene.core_key(imported.geometry_nodes(i)[0]).unwrap();
    assert_eq!(core(0), core(2));
    assert_eq!(imported.scene.geometry_count(), 2);
}

/// A triangle that hangs on two joints: its first corner on the first, its second on the second, its third on both.
fn skinned() -> Fixture {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let normals = fixture.floats("VEC3", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let joints = fixture.accessor(U8, "VEC4", 3, &[0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0]);
    let weights = fixture.accessor(U8, "VEC4", 3, &[255, 0, 0, 0, 255, 0, 0, 0, 51, 204, 0, 0]);
    fixture.json["accessors"][weights]["normalized"] = json!(true);
    // The first joint was bound at (0, 0, 1), the second at the origin.
    let mut matrices = [0.0_f32; 32];
    for i in [0, 5, 10, 15, 16, 21, 26, 31] {
        matrices[i] = 1.0;
    }
    matrices[14] = -1.0;
    let matrices = fixture.floats("MAT4", &matrices);
    let attributes = json!({"POSITION": positions, "NORMAL": normals, "JOINTS_0": joints, "WEIGHTS_0": weights});
    let mut fixture = fixture.with_primitive(json!({ "attributes": attributes }));
    fixture.json["skins"] = json!([{"joints": [1, 2], "inverseBindMatrices": matrices}]);
    // The skinned node's own transform, and that of its parent, must not move the mesh.
    fixture.json["nodes"] = json!([
        {"mesh": 0, "skin": 0, "translation": [100, 0, 0], "scale": [2, 1, 1]},
        {"translation": [0, 0, 3]},
        {"rotation": [0, 1, 0, 1], "translation": [0, 10, 0]},
        {"children": [0], "translation": [0, 0, 77]},
    ]);
    fixture
}

#[test]
fn skins_are_applied_as_the_joints_stand() {
    let imported = skinned().import();
    let node = imported.geometry_nodes(0)[0];
    let world = imported.scene.world_from_local(node).unwrap();
    let geometry = imported.drawn(node).0;
    let corner = |i: usize| world.transform_point3(geometry.positions[i].as_dvec3());
    // On the first joint: up by 3 - 1 in z. On the second: a quarter turn about Y takes +X to -Z, then up by 10 in y.
    let expected = [DVec3::new(0.0, 0.0, 2.0), DVec3::new(0.0, 10.0, -1.0), {
        // 0.2 of (0, 2, 2) and 0.8 of (0, 12, 0).
        DVec3::new(0.0, 10.0, 0.4)
    }];
    for (i, expected) in expected.into_iter().enumerate() {
        assert!((corner(i) - expected).length() < 1e-5, "corner {i}: {} instead of {expected}", corner(i));
    }
    let normal = |i: usize| {
        let normals = geometry.normals.as_ref().unwrap();
        (world.matrix3.inverse().transpose() * normals[i].as_dvec3()).normalize()
    };
    assert!((normal(0) - DVec3::Z).length() < 1e-6);
    assert!((normal(1) - DVec3::X).length() < 1e-6);
    assert!(imported.notes().iter().any(|n| n.contains("skin: cannot be animated")));
}

#[test]
fn a_skin_that_cannot_be_applied_is_reported() {
    let mut fixture = Fixture::triangle();
    fixture.json["skins"] = json!([{"joints": [0]}]);
    fixture.json["nodes"][0]["skin"] = json!(0);
    let imported = fixture.import();
    assert!(imported.notes().iter().any(|n| n.contains("lacks JOINTS_0 or WEIGHTS_0")), "{:?}", imported.notes());
}

#[test]
fn a_pose_beyond_all_numbers_names_its_primitive() {
    let mut fixture = Fixture::new();
    let positions = fixture.floats("VEC3", &TRIANGLE);
    let far = fixture.floats("VEC3", &[f32::MAX; 9]);
    let targets = json!([{"POSITION": far}]);
    let mut fixture = fixture.with_primitive(json!({"attributes": {"POSITION": positions}, "targets": targets}));
    fixture.json["meshes"][0]["weights"] = json!([2]);
    assert_eq!(fixture.fault(), ("/meshes/0/primitives/0".into(), PrimitiveFault::PoseNotFinite.into()));
}

#[test]
fn a_skin_without_enough_matrices_or_joints_is_an_error() {
    let mut fixture = skinned();
    fixture.json["skins"][0]["joints"] = json!([1, 2, 3]);
    let too_few = SkinFault::TooFewMatrices { joints: 3, matrices: 2 };
    assert_eq!(fixture.fault(), ("/skins/0".into(), too_few.into()));
    let mut fixture = skinned();
    fixture.json["skins"][0]["joints"] = json!([1]);
    let out_of_range = GltfFault::from(AccessorFault::JointOutOfRange { joint: 1, joint_count: 1 });
    assert_eq!(fixture.fault().1, out_of_range);
    // Also if no node shows the mesh.
    fixture.json["scenes"] = json!([{"nodes": []}]);
    assert_eq!(fixture.fault().1, out_of_range);
}
