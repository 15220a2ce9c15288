//! Coincident triangles: one stands for all, and rays hit what they would hit if each was there.

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3, Vec4};
use ropewalk::accel::BlasBuildParams;
use ropewalk::compile::Compiler;
use ropewalk::device::layout::{HitRecord, InstanceFlags, NONE, RayRecord};
use ropewalk::graph::{AlphaMode, BlasKind};
use ropewalk::trace::{Emulated, Tracer as _};
use ropewalk::{Camera, Core, DeviceChoice, Geometry, Light, Material, Ray, Renderer, RendererOptions, Scene, View};
use ropewalk_testkit::{Builder, Mesh, Placed, Random, arrays_by, tracers};

use super::meshes::{STRUCTURES, coincident, identical};

/// Rays towards points in the cube from -1 to 1.
fn rays(count: usize) -> Vec<RayRecord> {
    let mut random = Random::new(3);
    let ray = |_| {
        let origin = 3.0 * random.direction();
        let direction = random.in_cube() - origin;
        RayRecord { origin: origin.to_array(), t_min: 0.0, direction: direction.to_array(), t_max: f32::INFINITY }
    };
    (0..count).map(ray).collect()
}

/// What a hit says, but for the places in the arrays.
fn seen(hit: &HitRecord) -> (u32, u32, u32) {
    (hit.instance, hit.primitive, hit.back_face)
}

#[test]
fn every_executor_hits_what_it_hits_if_no_triangle_is_left_out() {
    let mesh = coincident();
    for flags in [InstanceFlags::empty(), InstanceFlags::CULL_BACK] {
        let placed = [Placed { flags, ..Placed::new(0, DAffine3::IDENTITY) }];
        let rays = rays(2000);
        for mut tracer in tracers() {
            // Made for each executor, since an upload takes the marks of what has changed.
            let [(expected, all), (hits, merged)] = Builder::BOTH.map(|builder| {
                let mut arrays = arrays_by(builder, std::slice::from_ref(&mesh), &placed);
                tracer.upload(&mut arrays).unwrap();
                (tracer.closest_hits(&arrays, &rays, 1).unwrap(), arrays.triangles.len())
            });
            assert!(all == mesh.indices.len() && merged < all);
            // From another corner, the same triangle may be an ulp nearer.
            let mut hit_count = 0;
            for (a, b) in expected.iter().zip(&hits).filter(|(a, b)| (a.instance, b.instance) != (NONE, NONE)) {
                let name = &tracer.device().name;
                assert!((a.t - b.t).abs() <= 1e-5 * a.t && a.instance == b.instance, "{name}: {a:?} and {b:?}");
                assert_eq!(corners(&mesh, a), corners(&mesh, b), "{name}");
                assert!(flags.is_empty() || (a.back_face, b.back_face) == (0, 0), "{name}: {a:?} and {b:?}");
                hit_count += 1;
            }
            assert!(hit_count > 500, "{hit_count}");
        }
    }
}

/// The corners of the triangle that was hit, sorted.
fn corners(mesh: &Mesh, hit: &HitRecord) -> [[u32; 3]; 3] {
    let mut corners = mesh.triangle(hit.primitive as usize).map(|corner| corner.to_array().map(f32::to_bits));
    corners.sort_unstable();
    corners
}

#[test]
fn a_ray_through_many_coincident_triangles_tests_one() {
    let placed = [Placed::new(0, DAffine3::IDENTITY)];
    let rays = [RayRecord { origin: [0.3, 0.3, 5.0], t_min: 0.0, direction: [0.0, 0.0, -1.0], t_max: f32::INFINITY }];
    let count = |n: usize| {
        let arrays = arrays_by(Builder::Product, &[identical(n)], &placed);
        let tracer = Emulated::default();
        [tracer.count_closest_hits(&arrays, &rays, 1), tracer.count_any_hits(&arrays, &rays, 1)]
    };
    let [closest, any] = count(1);
    assert_eq!((closest.triangles, any.triangles), (1, 1));
    assert_eq!(count(100_000), [closest, any]);
}

#[test]
fn a_leaf_of_two_coincident_triangles_is_treated_as_a_million_of_them() {
    for structure in STRUCTURES {
        let Mesh { positions, indices } = identical(2);
        let geometry = Geometry::new(positions, indices);
        let blas = ropewalk::accel::Blas::build(&geometry, &BlasBuildParams::new(structure)).unwrap();
        assert_eq!((blas.triangles.len(), blas.coincident_count()), (1, 1), "{structure:?}");
    }
}

const UP: [Vec3; 3] = [Vec3::new(-1.0, -1.0, 0.0), Vec3::new(1.0, -1.0, 0.0), Vec3::new(0.0, 1.0, 0.0)];

/// A scene of one geometry of layers in the plane z = 0: for each its winding and the alpha of its vertices.
fn layers(material: &Material, layers: &[(bool, f32)], structure: Option<BlasKind>) -> Scene {
    let mut scene = Scene::new();
    let mut geometry = Geometry::new(
        layers.iter().flat_map(|_| UP).collect::<Vec<_>>(),
        (0..)
            .zip(layers)
            .map(|(i, (up, _))| if *up { [3 * i, 3 * i + 1, 3 * i + 2] } else { [3 * i + 1, 3 * i, 3 * i + 2] })
            .collect::<Vec<_>>(),
    );
    geometry.colors = Some(layers.iter().flat_map(|&(_, alpha)| [Vec3::ONE.extend(alpha); 3]).collect());
    geometry.blas_kind = structure;
    let geometry = scene.add_geometry(geometry).unwrap();
    let material = scene.add_material(material.clone()).unwrap();
    scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
    scene
}

fn cpu() -> Renderer {
    Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap()
}

/// The triangles that a ray along -z and one along +z hit.
fn hit_from_both_sides(scene: &mut Scene) -> [Option<usize>; 2] {
    let mut renderer = cpu();
    let rays = [5.0, -5.0].map(|z| Ray::new(DVec3::new(0.0, 0.0, z), DVec3::new(0.0, 0.0, -z)));
    let batch = renderer.closest_hits(scene, &rays, ropewalk::render::RayMask::ALL).unwrap();
    let hits = [0, 1].map(|i| batch.get(i).map(|hit| hit.triangle as usize));
    let queries = renderer.queries(scene).unwrap();
    let exact = rays.map(|ray| queries.closest_hit(&ray).unwrap().map(|hit| hit.triangle as usize));
    assert_eq!(hits, exact);
    hits
}

#[test]
fn of_opposite_windings_each_is_seen_from_its_side() {
    let culled = Material { double_sided: false, ..Material::default() };
    for structure in STRUCTURES {
        let both = [(true, 1.0), (true, 1.0), (false, 1.0), (false, 1.0)];
        let mut scene = layers(&culled, &both, Some(structure));
        assert_eq!(hit_from_both_sides(&mut scene), [Some(0), Some(2)], "{structure:?}");
        let mut scene = layers(&culled, &both[..2], Some(structure));
        assert_eq!(hit_from_both_sides(&mut scene), [Some(0), None], "{structure:?}");
        // Both are seen from either side: the one that faces the ray comes first.
        let mut scene = layers(&Material::default(), &both, Some(structure));
        assert_eq!(hit_from_both_sides(&mut scene), [Some(0), Some(2)], "{structure:?}");
    }
}

#[test]
fn behind_one_that_is_cut_out_another_is_hit() {
    let cut_out = Material { alpha_mode: AlphaMode::Mask { cutoff: 0.5 }, ..Material::default() };
    for structure in STRUCTURES {
        let mut scene = layers(&cut_out, &[(true, 0.0), (true, 0.0), (true, 1.0), (true, 1.0)], Some(structure));
        assert_eq!(hit_from_both_sides(&mut scene), [Some(2), Some(2)], "{structure:?}");
    }
}

#[test]
fn light_that_passes_is_dimmed_once_by_all_that_coincide() {
    let pane = Material { alpha_mode: AlphaMode::Blend, ..Material::diffuse(Vec3::X) };
    // A floor below the pane, lit through it, and seen from between them.
    let (eye, target) = (DVec3::new(0.0, -0.4, -0.5), DVec3::new(0.0, 0.0, -1.0));
    let view = View::look_at(eye, target, DVec3::Z, Camera::default(), 8, 8);
    let image = |count: usize, structure| {
        let mut scene = layers(&pane, &vec![(true, 0.5); count], Some(structure));
        let floor = UP.map(|corner| 10.0 * corner - Vec3::Z);
        let geometry = scene.add_geometry(Geometry::new(floor, [[0, 1, 2]])).unwrap();
        let material = scene.add_material(Material::default()).unwrap();
        scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
        scene.add(scene.root(), Light::directional(Vec3::ONE, 3.0)).unwrap();
        cpu().render(&mut scene, &view).unwrap().image().unwrap()
    };
    for structure in STRUCTURES {
        let once = image(1, structure);
        assert_ne!(image(0, structure), once, "the pane dims the light");
        assert_eq!(image(2, structure), once, "{structure:?}");
        assert_eq!(image(1000, structure), once, "{structure:?}");
    }
}

/// Compiles, and returns how many structures were refitted and built; what rays hit must be as compiled from nothing.
fn compile(compiler: &mut Compiler, scene: &mut Scene) -> (usize, usize) {
    let report = compiler.compile(scene, DVec3::ZERO).unwrap();
    let mut anew = Compiler::new();
    anew.compile(scene, DVec3::ZERO).unwrap();
    let rays = rays(300);
    let [hits, expected] = [&*compiler, &anew].map(|compiler| {
        let hits = Emulated::default().closest_hits(compiler.arrays(), &rays, 1).unwrap();
        hits.iter().map(|hit| (hit.t.to_bits(), seen(hit))).collect::<Vec<_>>()
    });
    assert!(hits == expected);
    (report.blas_refitted, report.blas_built)
}

#[test]
fn what_coincides_is_refitted_together_and_what_comes_apart_is_built() {
    let Mesh { positions, indices } = Mesh::soup(4, 300);
    // The second half are the triangles of the first half, with vertices of their own.
    let count = positions.len() as u32;
    let doubled: Vec<Vec3> = positions.iter().chain(&positions).copied().collect();
    let triangles: Vec<[u32; 3]> =
        indices.iter().copied().chain(indices.iter().map(|t| t.map(|v| v + count))).collect();
    let mut scene = Scene::new();
    let key = scene.add_geometry(Geometry::new(doubled.clone(), triangles)).unwrap();
    let material =
        scene.add_material(Material { alpha_mode: AlphaMode::Mask { cutoff: 0.5 }, ..Material::default() }).unwrap();
    scene.add(scene.root(), Core::Geometry { geometry: key, material }).unwrap();
    let mut compiler = Compiler::new();
    assert_eq!(compile(&mut compiler, &mut scene), (0, 1));
    assert_eq!(compiler.arrays().triangles.len(), indices.len());

    // Together.
    let moved: Vec<Vec3> = doubled.iter().map(|p| *p * Vec3::new(1.0, 0.9, 1.0)).collect();
    scene.set_positions(key, moved.clone(), None).unwrap();
    assert_eq!(compile(&mut compiler, &mut scene), (1, 0));
    // Apart: the copy of the first triangle.
    let mut apart = moved;
    apart[count as usize..][..3].iter_mut().for_each(|p| *p += 0.01);
    scene.set_positions(key, apart, None).unwrap();
    assert_eq!(compile(&mut compiler, &mut scene), (0, 1));
    assert_eq!(compiler.arrays().triangles.len(), indices.len() + 1);

    // The positions stay, but the copies are now opaque where the first are cut out.
    scene.set_positions(key, doubled, None).unwrap();
    compile(&mut compiler, &mut scene);
    let colors = (0..2 * count).map(|v| if v < count { Vec4::ZERO } else { Vec4::ONE });
    let geometry = Geometry { colors: Some(Arc::from_iter(colors)), ..scene.geometry(key).unwrap().clone() };
    scene.set_geometry(key, geometry).unwrap();
    assert_eq!(compile(&mut compiler, &mut scene).1, 1);
    assert_eq!(compiler.arrays().triangles.len(), 2 * indices.len());
}
