//! Unlit colours reach the display as they are, on every executor.

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3, Vec4};
use ropewalk::compile::Compiler;
use ropewalk::graph::{AlphaMode, TextureRef};
use ropewalk::image::{Image, ToneMapping};
use ropewalk::trace::FrameRequest;
use ropewalk::{Material, Scene, Sky, Texture, View};
use ropewalk_testkit::tracers;

use super::scenes::{at, black, front, put, sphere, square};

const ORANGE: [u8; 4] = [255, 127, 0, 255];

/// The images of all executors, with their names.
fn images(scene: &mut Scene, view: &View) -> Vec<(String, Image)> {
    let image = |mut tracer: Box<dyn ropewalk::trace::Tracer>| {
        let mut compiler = Compiler::new();
        let needs = compiler.compile(scene, view.viewpoint()).unwrap().needs;
        let params = view.frame_params(compiler.origin(), compiler.arrays().lights.len() as u32);
        tracer.upload(compiler.arrays_mut()).unwrap();
        tracer.render(compiler.arrays(), &FrameRequest::new(params, needs)).unwrap();
        (format!("{:?}", tracer.device()), tracer.read_image().unwrap())
    };
    tracers().into_iter().map(image).collect()
}

fn linear(code: u8) -> f32 {
    let encoded = f64::from(code) / 255.0;
    (if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }) as f32
}

fn orange() -> Vec3 {
    Vec3::new(linear(255), linear(127), 0.0)
}

fn unlit(color: Vec3) -> Material {
    Material { unlit: true, ..Material::diffuse(color) }
}

/// How far two 8-bit colours are apart.
fn difference(a: [u8; 4], b: [u8; 4]) -> u8 {
    a.into_iter().zip(b).map(|(a, b)| a.abs_diff(b)).max().unwrap()
}

#[test]
fn unlit_colours_are_exact_in_eight_bits() {
    let mut textured = Scene::new();
    let texels: Arc<[[u8; 4]]> = [ORANGE].into();
    let texture = textured.add_texture(Texture { width: 1, height: 1, texels }).unwrap();
    let material = Material { base_color_texture: Some(TextureRef::new(texture)), ..unlit(Vec3::ONE) };
    put(&mut textured, square(2.0), material, DAffine3::IDENTITY);
    let mut plain = Scene::new();
    put(&mut plain, square(2.0), unlit(orange()), DAffine3::IDENTITY);
    for scene in [&mut textured, &mut plain] {
        for (executor, image) in images(scene, &front(4, Sky::default())) {
            assert_eq!(image.to_rgba8(), [ORANGE; 16], "{executor}");
            assert_eq!(image.downscaled(2).unwrap().to_rgba8(), [ORANGE; 4], "{executor}");
            // The linear colour is the material's, as it is.
            for color in &image.color {
                assert!(
                    (Vec4::from(*color) - orange().extend(1.0)).abs().max_element() < 1e-6,
                    "{executor}: {color:?}"
                );
            }
        }
    }
}

#[test]
fn unlit_colours_stay_in_mirrors_and_under_blended_panes() {
    // In a perfect mirror that faces the camera, what is behind the camera.
    let mut mirrored = Scene::new();
    put(&mut mirrored, square(2.0), Material::mirror(Vec3::ONE), DAffine3::IDENTITY);
    let behind = at(0.0, 0.0, 20.0) * DAffine3::from_rotation_y(std::f64::consts::PI);
    put(&mut mirrored, square(2.0), unlit(orange()), behind);
    for (executor, image) in images(&mut mirrored, &front(1, black())) {
        assert!(difference(image.to_rgba8()[0], ORANGE) <= 1, "{executor}: {:?}", image.to_rgba8()[0]);
    }
    // Under half of an unlit blue pane: the mean of both.
    let mut covered = Scene::new();
    put(&mut covered, square(2.0), unlit(orange()), DAffine3::IDENTITY);
    let pane = Material { alpha_mode: AlphaMode::Blend, base_color: Vec4::new(0.0, 0.0, 1.0, 0.5), ..unlit(Vec3::Z) };
    put(&mut covered, square(2.0), pane, at(0.0, 0.0, 1.0));
    let mean = (orange() + Vec3::Z) * 0.5;
    let expected = mean.map(ropewalk::image::srgb_from_linear) * 255.0;
    for (executor, image) in images(&mut covered, &front(1, black())) {
        let [r, g, b, _] = image.to_rgba8()[0].map(f32::from);
        assert!((Vec3::new(r, g, b) - expected).abs().max_element() <= 1.0, "{executor}: {r} {g} {b}, {expected}");
    }
}

#[test]
fn lit_colours_are_compressed_by_their_share() {
    // Lit white under a white sky, under half of an unlit orange pane.
    let mut scene = Scene::new();
    put(&mut scene, square(2.0), Material::diffuse(Vec3::ONE), DAffine3::IDENTITY);
    let sky = Sky::uniform(Vec3::ONE);
    for (executor, image) in images(&mut scene, &front(1, sky)) {
        assert!(image.unlit.is_empty(), "{executor}: {:?}", image.unlit);
        assert!(image.to_rgba8()[0][0] < 250, "{executor}: white is compressed");
        let all = image.with_tone_mapping(ToneMapping::None).to_rgba8();
        assert!(all[0][0] >= 254, "{executor}: {all:?} is not");
    }
    let pane = Material { alpha_mode: AlphaMode::Blend, base_color: orange().extend(0.5), ..unlit(orange()) };
    put(&mut scene, square(2.0), pane, at(0.0, 0.0, 1.0));
    for (executor, image) in images(&mut scene, &front(1, sky)) {
        let all: f32 = image.color[0][..3].iter().sum();
        let share = 0.5 * orange().element_sum() / all;
        assert!((image.unlit[0] - share).abs() < 1e-5, "{executor}: {:?}, {share}", image.unlit);
        assert_eq!(image.color[0][3], 1.0, "{executor}");
    }
}

/// A scene in which nothing lit is seen but the sky: it is compressed, and the unlit ball before it is not.
#[test]
fn each_pixel_has_its_own_share() {
    let mut scene = Scene::new();
    put(&mut scene, sphere(3), unlit(orange()), DAffine3::from_scale(DVec3::splat(0.5)));
    for (executor, image) in images(&mut scene, &front(8, Sky::uniform(Vec3::ONE))) {
        let shown = image.to_rgba8();
        assert_eq!(shown[4 * 8 + 4], ORANGE, "{executor}");
        assert!(shown[0][0] < 250 && image.unlit[0] == 0.0, "{executor}: {:?}", shown[0]);
    }
}
