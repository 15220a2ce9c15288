//! Real scenes read twice: by us, and by the reader of the crate `gltf`, which shares no code with our accessors,
//! indices, poses and hierarchy. Every triangle must be in the same place.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat4, DQuat, DVec3, Vec2, Vec3, Vec4};
use gltf::mesh::Mode;
use ropewalk::{Core, Geometry, NodeKey, Scene};

use ropewalk_testkit::corpus::{gltf_files, scenes};

/// A corner of a triangle in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Corner {
    position: DVec3,
    normal: Option<Vec3>,
    tex_coords: [Option<Vec2>; 2],
    color: Option<Vec4>,
}

/// The file as the crate `gltf` reads it: its document, and the data of its buffers.
struct Reference {
    document: gltf::Document,
    buffers: Vec<Vec<u8>>,
}

impl Reference {
    fn open(path: &Path) -> Self {
        // Without the crate's own validation: it refuses extensions that it has no types for.
        let gltf::Gltf { document, mut blob } =
            gltf::Gltf::from_slice_without_validation(&std::fs::read(path).unwrap()).unwrap();
        let buffers = document
            .buffers()
            .map(|buffer| match buffer.source() {
                gltf::buffer::Source::Bin => blob.take().unwrap(),
                gltf::buffer::Source::Uri(uri) => read_uri(path, uri),
            })
            .collect();
        Self { document, buffers }
    }

    /// The corners of a primitive's triangles, in the space of the mesh, and the weights of each on joints.
    fn corners(&self, primitive: &gltf::Primitive, weights: &[f32]) -> Vec<(Corner, [u16; 4], [f32; 4])> {
        let reader = primitive.reader(|buffer| self.buffers.get(buffer.index()).map(Vec::as_slice));
        let mut positions: Vec<Vec3> = reader.read_positions().unwrap().map(Vec3::from).collect();
        let mut normals: Option<Vec<Vec3>> = reader.read_normals().map(|n| n.map(Vec3::from).collect());
        for ((target_positions, target_normals, _), &weight) in reader.read_morph_targets().zip(weights) {
            for (position, delta) in positions.iter_mut().zip(target_positions.into_iter().flatten()) {
                *position += weight * Vec3::from(delta);
            }
            for (normal, delta) in normals.iter_mut().flatten().zip(target_normals.into_iter().flatten()) {
                *normal += weight * Vec3::from(delta);
            }
        }
        let tex_coords =
            [0, 1].map(|set| reader.read_tex_coords(set).map(|t| t.into_f32().map(Vec2::from).collect::<Vec<_>>()));
        let colors = reader.read_colors(0).map(|c| c.into_rgba_f32().map(Vec4::from).collect::<Vec<_>>());
        let joints = reader.read_joints(0).map(|j| j.into_u16().collect::<Vec<_>>());
        let joint_weights = reader.read_weights(0).map(|w| w.into_f32().collect::<Vec<_>>());

        let order: Vec<usize> = match reader.read_indices() {
            Some(indices) => indices.into_u32().map(|i| i as usize).collect(),
            None => (0..positions.len()).collect(),
        };
        let triangles: Vec<[usize; 3]> = match primitive.mode() {
            Mode::Triangles => order.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
            Mode::TriangleStrip => {
                (0..order.len() - 2).map(|i| [order[i], order[i + 1 + i % 2], order[i + 2 - i % 2]]).collect()
            }
            Mode::TriangleFan => (0..order.len() - 2).map(|i| [order[i + 1], order[i + 2], order[0]]).collect(),
            _ => Vec::new(),
        };
        let corner = |&i: &usize| {
            let corner = Corner {
                position: positions[i].as_dvec3(),
                normal: normals.as_ref().map(|n| n[i].normalize_or_zero()),
                tex_coords: [0, 1].map(|set: usize| tex_coords[set].as_ref().map(|t| t[i])),
                color: colors.as_ref().map(|c| c[i]),
            };
            let joints = joints.as_ref().map_or([0; 4], |j| j[i]);
            (corner, joints, joint_weights.as_ref().map_or([0.0; 4], |w| w[i]))
        };
        triangles.iter().flatten().map(corner).collect()
    }

    /// The matrix of each node into the scene, by walking up from it.
    fn worlds(&self) -> Vec<DAffine3> {
        let mut parents = vec![None; self.document.nodes().len()];
        let mut locals = Vec::new();
        for node in self.document.nodes() {
            node.children().for_each(|child| parents[child.index()] = Some(node.index()));
            locals.push(local(&node));
        }
        (0..locals.len())
            .map(|i| {
                let mut world = locals[i];
                let mut current = i;
                while let Some(parent) = parents[current] {
                    world = locals[parent] * world;
                    current = parent;
                }
                world
            })
            .collect()
    }
}

fn local(node: &gltf::Node) -> DAffine3 {
    match node.transform() {
        gltf::scene::Transform::Matrix { matrix } => {
            DAffine3::from_mat4(DMat4::from_cols_array_2d(&matrix.map(|column| column.map(f64::from))))
        }
        gltf::scene::Transform::Decomposed { translation, rotation, scale } => {
            DAffine3::from_scale_rotation_translation(
                DVec3::from(scale.map(f64::from)),
                DQuat::from_array(rotation.map(f64::from)).normalize(),
                DVec3::from(translation.map(f64::from)),
            )
        }
    }
}

fn read_uri(path: &Path, uri: &str) -> Vec<u8> {
    use base64::Engine;
    match uri.split_once(";base64,") {
        Some((_, data)) => base64::engine::general_purpose::STANDARD.decode(data).unwrap(),
        None => {
            let name = percent_encoding::percent_decode_str(uri).decode_utf8().unwrap();
            std::fs::read(path.with_file_name(&*name)).unwrap()
        }
    }
}

/// The corners of our triangles of one geometry, with positions in the scene.
fn ours(geometry: &Geometry, world: &DAffine3) -> Vec<Corner> {
    let corner = |&i: &u32| {
        let i = i as usize;
        Corner {
            position: world.transform_point3(geometry.positions[i].as_dvec3()),
            normal: geometry.normals.as_ref().map(|n| n[i]),
            tex_coords: [0, 1].map(|set: usize| geometry.tex_coords[set].as_ref().map(|t| t[i])),
            color: geometry.colors.as_ref().map(|c| c[i]),
        }
    };
    geometry.indices.iter().flatten().map(corner).collect()
}

/// Compares one file; returns the number of corners compared.
fn compare(path: &Path) -> usize {
    let mut scene = Scene::new();
    let root = scene.root();
    let report = ropewalk::gltf::import(path, &mut scene, root).unwrap_or_else(|e| panic!("{e}"));
    let reference = Reference::open(path);
    let worlds = reference.worlds();
    let mut compared = 0;
    for node in reference.document.nodes() {
        // Nodes of other scenes are not imported; instances have a test of their own.
        let (Some(mesh), Some(key)) = (node.mesh(), report.nodes[node.index()]) else { continue };
        let drawn: Vec<NodeKey> = scene
            .children(key)
            .unwrap()
            .filter(|&child| matches!(scene.node_core(child), Ok(Core::Geometry { .. })))
            .collect();
        let weights = node.weights().or(mesh.weights()).unwrap_or(&[]);
        let triangles =
            |p: &gltf::Primitive| matches!(p.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan);
        let primitives: Vec<_> = mesh.primitives().filter(triangles).collect();
        if drawn.is_empty() && path.to_str().unwrap().contains("SimpleInstancing") {
            continue;
        }
        assert_eq!(drawn.len(), primitives.len(), "{}", path.display());
        for (primitive, child) in primitives.iter().zip(drawn) {
            let Core::Geometry { geometry, .. } = *scene.node_core(child).unwrap() else { unreachable!() };
            let found = ours(scene.geometry(geometry).unwrap(), &scene.world_from_local(child).unwrap());
            let expected = reference.corners(primitive, weights);
            assert_eq!(found.len(), expected.len(), "{}", path.display());
            let palette = node.skin().map(|skin| palette(&reference, &skin, &worlds));
            for (i, (found, (expected, joints, weights))) in found.iter().zip(&expected).enumerate() {
                check(
                    found,
                    expected,
                    place(palette.as_deref(), *joints, *weights, &worlds[node.index()]),
                    palette.is_some(),
                )
                .unwrap_or_else(|e| panic!("{}: node {}, corner {i}: {e}", path.display(), node.index()));
                compared += 1;
            }
        }
    }
    compared
}

/// The joint matrices of a skin.
fn palette(reference: &Reference, skin: &gltf::Skin, worlds: &[DAffine3]) -> Vec<DAffine3> {
    let reader = skin.reader(|buffer| reference.buffers.get(buffer.index()).map(Vec::as_slice));
    let inverse_bind: Vec<DMat4> = match reader.read_inverse_bind_matrices() {
        Some(matrices) => matrices.map(|m| DMat4::from_cols_array_2d(&m.map(|c| c.map(f64::from)))).collect(),
        None => vec![DMat4::IDENTITY; skin.joints().count()],
    };
    skin.joints().zip(inverse_bind).map(|(joint, m)| worlds[joint.index()] * DAffine3::from_mat4(m)).collect()
}

/// The matrix that places a vertex in the scene.
fn place(palette: Option<&[DAffine3]>, joints: [u16; 4], weights: [f32; 4], world: &DAffine3) -> DAffine3 {
    let Some(palette) = palette else { return *world };
    let total: f64 = weights.iter().copied().map(f64::from).sum();
    let columns = joints.iter().zip(weights).fold([0.0; 12], |mut sum, (&joint, weight)| {
        let matrix = palette[joint as usize].to_cols_array();
        sum.iter_mut().zip(matrix).for_each(|(sum, m)| *sum += m * f64::from(weight) / total);
        sum
    });
    DAffine3::from_cols_array(&columns)
}

fn check(found: &Corner, expected: &Corner, place: DAffine3, skinned: bool) -> Result<(), String> {
    let expected = Corner { position: place.transform_point3(expected.position), ..*expected };
    // The crate's transforms are f32, and skinned positions are stored in f32: a few units in the last place of the
    // largest number involved.
    let scale = expected.position.abs().max_element().max(place.translation.abs().max_element());
    let tolerance = scale.max(place.matrix3.to_cols_array().iter().fold(0.0, |a, m| m.abs().max(a))) * 1e-5;
    if (found.position - expected.position).length() > tolerance {
        return Err(format!("is at {}, expected {}", found.position, expected.position));
    }
    let same_normal = match (found.normal, expected.normal) {
        (Some(a), Some(b)) => skinned || (a - b).length() < 1e-6,
        (a, b) => a == b,
    };
    if same_normal && (found.tex_coords, found.color) == (expected.tex_coords, expected.color) {
        return Ok(());
    }
    Err(format!("is {found:?}, expected {expected:?}"))
}

#[test]
fn every_triangle_is_where_the_crate_s_reader_says() {
    let Some(folder) = scenes("every_triangle_is_where_the_crate_s_reader_says") else { return };
    let files: Vec<PathBuf> = ["gltf", "meshes", "scenes"].iter().flat_map(|f| gltf_files(&folder.join(f))).collect();
    let (mut files_compared, mut corners) = (0, 0);
    // Draco is refused, and the crate's reader knows no quantized positions.
    let unreadable = ["-Draco", "-Quantized"];
    for file in files.iter().filter(|f| !unreadable.iter().any(|u| f.to_str().unwrap().contains(u))) {
        corners += compare(file);
        files_compared += 1;
    }
    assert!(files_compared > 100 && corners > 8_000_000, "{files_compared} files, {corners} corners");
}
