//! How textures lie on surfaces, and how normal textures change shading.

use std::sync::Arc;

use glam::{Affine2, DAffine3, DVec3, Vec2, Vec3};
use ropewalk::graph::{FilterMode, LightKind, Sampler, TextureRef};
use ropewalk::{Geometry, Material, Scene, Texture};

use super::scenes::{black, front, middle, put, put_light, render, square};

/// Red, green over blue, white.
fn four_colors(scene: &mut Scene) -> TextureRef {
    let texels = Arc::new([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 255]]);
    let texture = scene.add_texture(Texture { width: 2, height: 2, texels }).unwrap();
    let sampler = Sampler { filter: FilterMode::Nearest, ..Sampler::default() };
    TextureRef { sampler, ..TextureRef::new(texture) }
}

/// The four quarters of the front view, row by row.
fn quarters(scene: &mut Scene) -> [Vec3; 4] {
    let image = render(scene, &front(2, black()));
    std::array::from_fn(|i| Vec3::from_slice(&image.color[i]))
}

fn unlit(texture: TextureRef) -> Material {
    Material { unlit: true, base_color_texture: Some(texture), ..Material::default() }
}

#[test]
fn images_are_upright() {
    let mut scene = Scene::new();
    let texture = four_colors(&mut scene);
    put(&mut scene, square(1.0), unlit(texture), DAffine3::IDENTITY);
    assert_eq!(quarters(&mut scene), [Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE]);
}

#[test]
fn a_transform_of_the_texture_moves_the_image() {
    let mut scene = Scene::new();
    let texture = four_colors(&mut scene);
    let half_right = TextureRef { transform: Affine2::from_translation(Vec2::new(0.5, 0.0)), ..texture };
    put(&mut scene, square(1.0), unlit(half_right), DAffine3::IDENTITY);
    assert_eq!(quarters(&mut scene), [Vec3::Y, Vec3::X, Vec3::ONE, Vec3::Z]);
}

#[test]
fn the_second_set_of_coordinates_is_used_where_asked_for() {
    let mut scene = Scene::new();
    let texture = TextureRef { tex_coord: 1, ..four_colors(&mut scene) };
    let mut geometry = square(1.0);
    let flipped: Vec<Vec2> =
        geometry.tex_coords[0].iter().flat_map(|set| set.iter()).map(|uv| Vec2::new(1.0 - uv.x, uv.y)).collect();
    geometry.tex_coords[1] = Some(flipped.into());
    put(&mut scene, geometry, unlit(texture), DAffine3::IDENTITY);
    assert_eq!(quarters(&mut scene), [Vec3::Y, Vec3::X, Vec3::ONE, Vec3::Z]);
}

#[test]
fn vertex_colors_are_mixed_by_weight() {
    let mut scene = Scene::new();
    let mut geometry = square(1.0);
    geometry.colors = Some(Arc::new([Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE].map(|c| c.extend(1.0))));
    put(&mut scene, geometry, Material { unlit: true, ..Material::default() }, DAffine3::IDENTITY);
    // The upper left pixel lies on the diagonal, 3/4 of the way from corner 2 to corner 0; the lower left one in its
    // triangle.
    let [upper_left, _, lower_left, _] = quarters(&mut scene);
    assert!((upper_left - Vec3::new(0.75, 0.0, 0.25)).abs().max_element() < 1e-5, "{upper_left}");
    assert!((lower_left - Vec3::new(0.25, 0.5, 0.25)).abs().max_element() < 1e-5, "{lower_left}");
}

/// How bright a square with a normal texture of one texel is under a light from a direction.
fn bent(normal: Vec3, geometry: &Geometry, place: DAffine3, to_light: DVec3) -> f32 {
    let mut scene = Scene::new();
    let [x, y, z] = ((normal.normalize() + Vec3::ONE) * 127.5).round().to_array().map(|c| c as u8);
    let texture = scene.add_texture(Texture { width: 1, height: 1, texels: Arc::new([[x, y, z, 255]]) }).unwrap();
    let material = Material { normal_texture: Some(TextureRef::new(texture)), ..Material::default() };
    put(&mut scene, geometry.clone(), material, place);
    put_light(&mut scene, LightKind::Directional, 1.0, to_light, DVec3::ZERO);
    middle(&mut scene, black()).x
}

#[test]
fn normal_textures_bend_towards_the_images_right_and_top() {
    let (plain, turned) = (DAffine3::IDENTITY, DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_2));
    let mirrored = DAffine3::from_scale(DVec3::new(-2.0, 0.5, 3.0));
    let behind = DAffine3::from_rotation_y(std::f64::consts::PI);
    let mut flipped = square(1.0);
    let coordinates: Vec<Vec2> =
        flipped.tex_coords[0].iter().flat_map(|set| set.iter()).map(|uv| Vec2::new(1.0 - uv.x, uv.y)).collect();
    flipped.tex_coords[0] = Some(coordinates.into());
    let (right, up) = (Vec3::new(0.5, 0.0, 1.0), Vec3::new(0.0, 0.5, 1.0));
    // The world directions of the image's right and top.
    let cases = [
        ("plain", square(1.0), plain, DVec3::X, DVec3::Y),
        ("a quarter turn", square(1.0), turned, DVec3::Y, DVec3::NEG_X),
        ("mirrored by its transform", square(1.0), mirrored, DVec3::NEG_X, DVec3::Y),
        ("mirrored by its coordinates", flipped, plain, DVec3::NEG_X, DVec3::Y),
        // Seen from behind, the shading normal is reversed.
        ("from behind", square(1.0), behind, DVec3::X, DVec3::NEG_Y),
    ];
    for (name, geometry, place, image_right, image_top) in cases {
        for (normal, towards) in [(right, image_right), (up, image_top)] {
            let lit = |side: DVec3| bent(normal, &geometry, place, side + DVec3::Z);
            let (with, against, flat) = (lit(towards), lit(-towards), lit(towards.cross(DVec3::Z)));
            assert!(with > flat * 1.1 && flat > against * 1.1, "{name}, {normal}: {with} > {flat} > {against}");
        }
    }
}
