//! The shader of the example `ambient_occlusion`, which queries the scene itself, compared with exact queries on the
//! CPU.

#[path = "../../../examples/ambient_occlusion/occlusion.rs"]
mod example;

use std::f32::consts::TAU;

use example::Occlusion;
use glam::{DVec3, Vec3};
use ropewalk::query::Queries;
use ropewalk::trace::Cpu;
use ropewalk::{Core, DeviceChoice, Geometry, Material, Ray, Renderer, RendererOptions, Scene, Transform};

use ropewalk_testkit::gpu::usable;

/// A floor with a roof over half of it; both sides of the roof are hit.
fn scene() -> Scene {
    let mut scene = Scene::new();
    let square =
        [Vec3::new(-1.0, 0.0, -1.0), Vec3::new(-1.0, 0.0, 1.0), Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.0, 0.0, -1.0)];
    let geometry = scene.add_geometry(Geometry::new(square, [[0, 1, 2], [0, 2, 3]])).unwrap();
    let material = scene.add_material(Material::diffuse(Vec3::ONE)).unwrap();
    for place in [Transform::from_scale(DVec3::splat(4.0)), Transform::from_translation(DVec3::new(-1.0, 0.7, 0.0))] {
        let node = scene.add(scene.root(), place).unwrap();
        scene.add(node, Core::Geometry { geometry, material }).unwrap();
    }
    scene
}

const OCCLUSION: Occlusion = Occlusion {
    eye: DVec3::new(3.0, 2.5, 5.0),
    target: DVec3::new(0.0, 0.3, 0.0),
    size: [40, 30],
    samples: 16,
    radius: 2.0,
};

#[test]
fn an_applications_shader_sees_what_exact_queries_see() {
    let Some(mut renderer) = usable(Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Gpu))) else {
        return;
    };
    let mut scene = scene();
    let found = OCCLUSION.compute(&mut renderer, &mut scene).unwrap().unwrap();

    let params = OCCLUSION.params(DVec3::ZERO);
    let mut cpu = Renderer::with_tracer(Cpu::default());
    let queries = cpu.queries(&mut scene).unwrap();
    let expected: Vec<f32> =
        (0..params.width * params.height).map(|pixel| openness(&queries, &params, pixel)).collect();
    assert_eq!(found.len(), expected.len());
    // A ray that passes an edge at a distance within rounding may hit or miss.
    let (mut differ, mut shaded) = (0, 0);
    for (found, expected) in found.iter().zip(&expected) {
        differ += usize::from((found - expected).abs() > 1e-6);
        shaded += usize::from(*expected > 0.0 && *expected < 1.0);
    }
    println!("{differ} of {} pixels differ, {shaded} are half open", expected.len());
    assert!(shaded > 100, "{shaded}");
    assert!(differ * 200 <= expected.len(), "{differ} of {}", expected.len());
}

/// The directions of the shader's rays.
fn openness(queries: &Queries<'_>, params: &example::Params, pixel: u32) -> f32 {
    let (column, row) = (pixel % params.width, pixel / params.width);
    let x = (column as f32 + 0.5) / params.width as f32 * 2.0 - 1.0;
    let y = 1.0 - (row as f32 + 0.5) / params.height as f32 * 2.0;
    let direction = (params.forward + params.right * x + params.up * y).normalize();
    let Some(hit) = queries.closest_hit(&Ray::new(params.eye.as_dvec3(), direction.as_dvec3())).unwrap() else {
        return 1.0;
    };
    let side = if hit.back_face { -1.0 } else { 1.0 };
    let normal = (hit.shading_normal * side).as_vec3();
    let open = (0..params.samples).filter(|i| {
        let outward = outward(normal, pixel * params.samples + i).as_dvec3();
        let from = hit.position + hit.geometric_normal * side * 1e-6;
        let ray = Ray { t_max: params.radius.into(), ..Ray::new(from, outward) };
        !queries.any_hit(&ray).unwrap()
    });
    open.count() as f32 / params.samples as f32
}

fn outward(normal: Vec3, index: u32) -> Vec3 {
    let z = 1.0 - 2.0 * random(2 * index);
    let angle = TAU * random(2 * index + 1);
    let ring = (1.0 - z * z).max(0.0).sqrt();
    let sum = normal + Vec3::new(ring * angle.cos(), ring * angle.sin(), z);
    if sum.length_squared() > 1e-6 { sum.normalize() } else { normal }
}

fn random(index: u32) -> f32 {
    let state = index.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (((word >> 22) ^ word) >> 8) as f32 / (1 << 24) as f32
}
