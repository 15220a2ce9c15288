//! The white furnace test: under a uniform sky, a surface that absorbs nothing has the radiance of the sky.

use glam::{DAffine3, DQuat, DVec3, Vec3, Vec4};
use ropewalk::graph::AlphaMode;
use ropewalk::{Camera, Geometry, Material, Scene, Sky, View};

use super::scenes::{at, cube, put, render, sphere, square};

fn white_materials() -> Vec<(String, Material)> {
    let mut materials = Vec::new();
    for roughness in [0.0, 0.05, 0.2, 0.3, 0.45, 0.7, 1.0] {
        for metallic in [0.0, 0.4, 1.0] {
            let plain = Material { roughness, metallic, ..Material::default() };
            materials.push((format!("roughness {roughness}, metallic {metallic}"), plain.clone()));
            let blend = Material { base_color: Vec4::new(1.0, 1.0, 1.0, 0.6), alpha_mode: AlphaMode::Blend, ..plain };
            materials.push((format!("blend, roughness {roughness}, metallic {metallic}"), blend));
        }
        for (transmission, ior) in [(1.0, 1.5), (0.5, 1.5), (1.0, 2.4), (1.0, 1.0), (1.0, 0.0)] {
            let glass = Material { roughness, transmission, ior, ..Material::default() };
            materials.push((format!("glass {transmission} of ior {ior}, roughness {roughness}"), glass));
        }
    }
    materials
}

fn check(name: &str, geometry: &Geometry, material: &Material, place: DAffine3, depth: u32) {
    let mut scene = Scene::new();
    put(&mut scene, geometry.clone(), material.clone(), place);
    // A second object, so that reflections show more than the sky.
    put(&mut scene, geometry.clone(), material.clone(), at(0.7, 0.9, -1.5) * place);
    let mut view = View::look_at(DVec3::new(0.5, 0.8, 4.0), DVec3::ZERO, DVec3::Y, Camera::default(), 24, 24);
    view.sky = Sky::uniform(Vec3::ONE);
    view.max_depth = depth;
    view.aovs = true;
    let image = render(&mut scene, &view);
    let met = image.aovs.as_ref().unwrap().depth.iter().filter(|depth| depth.is_finite()).count();
    assert!(met > 100, "{name}: {met} pixels");
    for (i, color) in image.color.iter().enumerate() {
        let error = (Vec4::from_array(*color) - Vec4::ONE).abs().max_element();
        assert!(error < 2e-5, "{name}, depth {depth}, pixel {i}: {color:?}");
    }
}

#[test]
fn white_surfaces_vanish_in_a_white_sky() {
    let turned = DAffine3::from_rotation_y(0.6) * DAffine3::from_rotation_x(0.4);
    let mirrored = DAffine3::from_scale_rotation_translation(DVec3::new(-1.0, 0.7, 1.2), DQuat::IDENTITY, DVec3::ZERO);
    let (ball, coarse, cube, square) = (sphere(4), sphere(1), cube(), square(1.2));
    for (name, material) in white_materials() {
        check(&format!("sphere, {name}"), &ball, &material, turned, 3);
        check(&format!("coarse sphere, {name}"), &coarse, &material, mirrored, 8);
        check(&format!("cube, {name}"), &cube, &material, turned, 5);
        check(&format!("square, {name}"), &square, &material, turned, 0);
    }
}

#[test]
fn from_within_a_closed_furnace_too() {
    let mut scene = Scene::new();
    put(
        &mut scene,
        cube(),
        Material { roughness: 0.2, ..Material::default() },
        DAffine3::from_scale(DVec3::splat(5.0)),
    );
    put(&mut scene, sphere(3), Material::glass(1.5), DAffine3::IDENTITY);
    let mut view = View::look_at(DVec3::new(0.5, 0.8, 4.0), DVec3::ZERO, DVec3::Y, Camera::default(), 48, 48);
    view.sky = Sky::uniform(Vec3::ONE);
    for color in &render(&mut scene, &view).color {
        assert!((Vec4::from_array(*color) - Vec4::ONE).abs().max_element() < 2e-5, "{color:?}");
    }
}

#[test]
fn a_black_sky_is_black() {
    let mut scene = Scene::new();
    put(&mut scene, sphere(2), Material::glass(1.5), DAffine3::IDENTITY);
    let mut view = View::look_at(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, DVec3::Y, Camera::default(), 16, 16);
    view.sky = Sky::uniform(Vec3::ZERO);
    assert!(render(&mut scene, &view).color.iter().all(|color| *color == [0.0, 0.0, 0.0, 1.0]));
}
