//! All executors render the same image.

use std::sync::Arc;

use glam::{Affine2, DAffine3, DQuat, DVec3, Vec2, Vec3, Vec4};
use ropewalk::graph::{AlphaMode, FilterMode, LightKind, Sampler, TextureRef, WrapMode};
use ropewalk::image::Image;
use ropewalk::{Camera, DeviceChoice, Material, Renderer, RendererOptions, Scene, Texture, View};

use super::scenes::{at, cube, put, put_light, sphere, square};

/// A scene with all features of the kernel.
fn scene() -> Scene {
    let mut scene = Scene::new();
    let texels: Arc<[[u8; 4]]> =
        (0..64u32).map(|i| [(i * 37) as u8, (i * 91) as u8, (i * 13) as u8, (i * 53) as u8]).collect();
    let texture = scene.add_texture(Texture { width: 8, height: 8, texels }).unwrap();
    let wrapped = |wrap_u, wrap_v, filter| TextureRef {
        sampler: Sampler { wrap_u, wrap_v, filter },
        transform: Affine2::from_scale_angle_translation(Vec2::new(2.3, 1.7), 0.4, Vec2::new(-0.6, -0.3)),
        ..TextureRef::new(texture)
    };
    let repeat = wrapped(WrapMode::Repeat, WrapMode::Mirror, FilterMode::Linear);
    let floor =
        DAffine3::from_rotation_translation(DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2), DVec3::Y * -1.0);
    put(
        &mut scene,
        square(6.0),
        Material { base_color_texture: Some(repeat), roughness: 0.3, ..Material::default() },
        floor,
    );
    put(
        &mut scene,
        sphere(4),
        Material { base_color: Vec4::new(0.7, 0.9, 1.0, 1.0), ..Material::glass(1.5) },
        at(0.0, 0.0, 0.5),
    );
    put(
        &mut scene,
        sphere(3),
        Material { roughness: 0.2, ..Material::mirror(Vec3::new(1.0, 0.8, 0.4)) },
        at(-2.2, 0.0, -0.5),
    );
    let bent = Material {
        normal_texture: Some(wrapped(WrapMode::Clamp, WrapMode::Repeat, FilterMode::Nearest)),
        metallic_roughness_texture: Some(repeat),
        ..Material::default()
    };
    let leaning = DAffine3::from_scale_rotation_translation(
        DVec3::new(-0.8, 0.8, 0.8),
        DQuat::from_rotation_y(0.5),
        DVec3::new(2.2, 0.0, 0.0),
    );
    put(&mut scene, cube(), bent.clone(), leaning);
    put(
        &mut scene,
        square(1.0),
        bent,
        DAffine3::from_rotation_translation(DQuat::from_rotation_y(0.3), DVec3::new(0.0, 0.8, -2.5)),
    );
    let holes = Material {
        alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
        base_color_texture: Some(wrapped(WrapMode::Mirror, WrapMode::Clamp, FilterMode::Linear)),
        double_sided: false,
        ..Material::default()
    };
    put(&mut scene, square(0.8), holes, at(-1.3, 0.3, 1.2));
    let film = Material {
        base_color: Vec4::new(0.9, 0.3, 0.2, 0.4),
        alpha_mode: AlphaMode::Blend,
        roughness: 0.1,
        ..Material::default()
    };
    put(&mut scene, square(0.7), film, at(1.3, 0.2, 1.5));
    put_light(&mut scene, LightKind::Directional, 2.0, DVec3::new(2.0, 5.0, 3.0), DVec3::ZERO);
    put_light(&mut scene, LightKind::Point, 6.0, DVec3::new(-1.0, 2.0, 2.0), DVec3::ZERO);
    put_light(
        &mut scene,
        LightKind::Spot { inner_cone_angle: 0.2, outer_cone_angle: 0.5 },
        40.0,
        DVec3::new(3.0, 4.0, 1.0),
        DVec3::ZERO,
    );
    scene
}

fn view() -> View {
    let mut view = View::look_at(DVec3::new(0.6, 1.2, 6.0), DVec3::ZERO, DVec3::Y, Camera::default(), 160, 120);
    view.aovs = true;
    view.max_depth = 4;
    view
}

fn draw(mut renderer: Renderer) -> Image {
    renderer.render(&mut scene(), &view()).unwrap().image().unwrap()
}

fn open(device: DeviceChoice) -> ropewalk::Result<Renderer> {
    Renderer::new(&RendererOptions::default().with_device(device))
}

/// How many pixels differ at all, and by how much at most.
fn differences(a: &Image, b: &Image) -> (usize, f32) {
    assert_eq!(a.color.len(), b.color.len());
    let errors =
        a.color.iter().zip(&b.color).map(|(a, b)| (Vec4::from_array(*a) - Vec4::from_array(*b)).abs().max_element());
    errors.filter(|&e| e > 0.0).fold((0, 0.0), |(count, most), e| (count + 1, most.max(e)))
}

#[test]
fn emulated_and_cpu_draw_the_same_bits() {
    let (a, b) = (draw(open(DeviceChoice::Emulated).unwrap()), draw(open(DeviceChoice::Cpu).unwrap()));
    assert!(a.color.iter().any(|c| c[0] != a.color[0][0]), "a picture");
    assert_eq!(differences(&a, &b), (0, 0.0));
    assert_eq!(a, b);
}

#[cfg(feature = "gpu")]
#[test]
fn the_gpu_draws_the_same_picture() {
    let Some(renderer) = ropewalk_testkit::gpu::usable(open(DeviceChoice::Gpu)) else { return };
    let name = renderer.device_info().name.clone();
    let (a, b) = (draw(open(DeviceChoice::Cpu).unwrap()), draw(renderer));
    let (count, most) = differences(&a, &b);
    eprintln!("{name}: {count} of {} pixels differ, by at most {most:e}", a.color.len());
    let visible = a.color.iter().zip(&b.color).filter(|(a, b)| (0..3).any(|i| (a[i] - b[i]).abs() > 1e-3)).count();
    // A GPU may contract products and sums and rounds divisions differently, so a ray near an edge may pass on the
    // other side.
    assert!(visible * 200 < a.color.len(), "{name}: {visible} of {} pixels differ visibly", a.color.len());
    let (a, b) = (a.aovs.unwrap(), b.aovs.unwrap());
    let ids = a.triangle.iter().zip(&b.triangle).filter(|(a, b)| a != b).count();
    assert!(ids * 1000 < a.triangle.len(), "{name}: {ids} triangles differ");
}
