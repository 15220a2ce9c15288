//! The scenes of the golden images, each for one feature.

use std::f32::consts::TAU;
use std::f64::consts::FRAC_PI_4;

use glam::{Affine2, DQuat, DVec3, Vec2, Vec3, Vec4, dvec3, vec2, vec3};
use ropewalk::graph::{AlphaMode, FilterMode, WrapMode};
use ropewalk::graph::{Geometry, Light, LightKind, Material, NodeKey, Sampler, Texture, TextureRef};
use ropewalk::{Camera, Core, Result, Scene, Sky, Transform, View};

use super::builtin::{self, shapes, textures};

/// The size of a golden image.
const WIDTH: u32 = 128;
const HEIGHT: u32 = 96;

/// The scene of the example, in a smaller image: it has so much detail that the file would otherwise be too large.
pub(crate) fn builtin_scene(scene: &mut Scene) -> Result<View> {
    let camera = builtin::build(scene)?;
    let mut view = View::from_camera(scene, camera, 96, 60)?;
    view.sky = builtin::sky();
    Ok(view)
}

/// A ball, a block and a lens of glass before a checkerboard: the ball shows it upside down, the block shifted.
pub(crate) fn glass(scene: &mut Scene) -> Result<View> {
    let checker = checkerboard(scene, FilterMode::Nearest)?;
    put(scene, shapes::cuboid(vec3(4.0, 2.0, 0.1)), checker, at(0.0, 1.0, -2.5))?;
    stand_on_floor(scene, Vec3::splat(0.4))?;
    put(scene, shapes::sphere(5), Material::glass(1.5), scaled(-1.3, 0.8, 0.0, DVec3::splat(0.8)))?;
    let turned = Transform::Trs {
        translation: dvec3(0.75, 0.7, 0.2),
        rotation: DQuat::from_rotation_y(0.6),
        scale: dvec3(0.45, 0.7, 0.45),
    };
    let green = Material { base_color: Vec4::new(0.5, 0.9, 0.6, 1.0), ..Material::glass(1.33) };
    put(scene, shapes::cuboid(Vec3::ONE), green, turned)?;
    put(scene, shapes::sphere(5), Material::glass(2.4), scaled(1.9, 0.5, 0.6, dvec3(0.5, 0.5, 0.15)))?;
    add_sun(scene, 2.0)?;
    let mut view = look(dvec3(0.2, 1.5, 5.0), dvec3(0.2, 0.8, 0.0));
    view.max_depth = 6;
    Ok(view)
}

/// A ball between two mirrors: each level of reflection shows one more image of it, and the last shows an empty mirror.
pub(crate) fn mirror_depth(scene: &mut Scene) -> Result<View> {
    stand_on_floor(scene, vec3(0.5, 0.45, 0.4))?;
    for (z, tint) in [(-2.0, vec3(0.9, 0.9, 0.95)), (2.6, vec3(0.95, 0.9, 0.85))] {
        put(scene, shapes::cuboid(vec3(3.0, 1.5, 0.05)), Material::mirror(tint), at(0.0, 1.2, z))?;
    }
    put(scene, shapes::sphere(4), Material::diffuse(vec3(0.8, 0.1, 0.05)), scaled(-0.3, 0.5, 0.4, DVec3::splat(0.5)))?;
    put(scene, shapes::cuboid(Vec3::splat(0.25)), Material::diffuse(vec3(0.1, 0.3, 0.8)), at(0.7, 0.25, -0.6))?;
    add_sun(scene, 2.0)?;
    let mut view = look(dvec3(1.3, 1.7, 2.4), dvec3(-0.1, 0.7, -2.0));
    view.max_depth = 8;
    Ok(view)
}

/// Two periods of a texture with four different corners. Columns: repeated, mirrored, clamped; turned by a texture
/// transform. Upper row: nearest texel; lower row: bilinear.
pub(crate) fn texture_wrap(scene: &mut Scene) -> Result<View> {
    let corner = |x: u32, y: u32| match (x / 2, y / 2) {
        _ if x == y => [255, 255, 255, 255],
        (0, 0) => [220, 40, 30, 255],
        (1, 0) => [40, 180, 60, 255],
        (0, _) => [40, 70, 220, 255],
        _ => [240, 200, 40, 255],
    };
    let texels = (0..4).flat_map(|y| (0..4).map(move |x| corner(x, y))).collect();
    let texture = scene.add_texture(Texture { width: 4, height: 4, texels })?;

    // Texture coordinates from -0.5 to 1.5.
    let mut quad = shapes::cuboid(vec3(0.46, 0.46, 0.01));
    let stretched = quad.tex_coords[0].iter().flat_map(|set| set.iter()).map(|&uv| uv * 2.0 - 0.5);
    quad.tex_coords[0] = Some(stretched.collect());
    let quad = scene.add_geometry(quad)?;
    for (row, filter) in [FilterMode::Nearest, FilterMode::Linear].into_iter().enumerate() {
        for column in 0..4 {
            let wrap = [WrapMode::Repeat, WrapMode::Mirror, WrapMode::Clamp, WrapMode::Repeat][column];
            let transform = if column == 3 {
                Affine2::from_scale_angle_translation(Vec2::splat(0.8), 0.5, vec2(0.2, 0.0))
            } else {
                Affine2::IDENTITY
            };
            let sampler = Sampler { wrap_u: wrap, wrap_v: wrap, filter };
            let texture = TextureRef { sampler, transform, ..TextureRef::new(texture) };
            let material = Material { base_color_texture: Some(texture), unlit: true, ..Material::default() };
            let material = scene.add_material(material)?;
            let place = scene.add(scene.root(), at(column as f64 - 1.5, 0.5 - row as f64, 0.0))?;
            scene.add(place, Core::Geometry { geometry: quad, material })?;
        }
    }
    let camera = Camera::orthographic(2.1, 1.1);
    Ok(View { camera, ..look(DVec3::Z * 5.0, DVec3::ZERO) })
}

/// Alpha masks with round holes, whose shadow has holes too, and three panes of blended colour one behind the other.
pub(crate) fn alpha(scene: &mut Scene) -> Result<View> {
    stand_on_floor(scene, Vec3::splat(0.6))?;
    let holes = |x: u32, y: u32| {
        let from_middle = vec2((x % 16) as f32 - 7.5, (y % 16) as f32 - 7.5).length();
        [230, 180, 90, if from_middle < 5.0 { 0 } else { 255 }]
    };
    let texels = (0..64).flat_map(|y| (0..64).map(move |x| holes(x, y))).collect();
    let texture = scene.add_texture(Texture { width: 64, height: 64, texels })?;
    let mask = Material {
        base_color_texture: Some(TextureRef::new(texture)),
        alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
        ..Material::default()
    };
    let sieve = scene.add_geometry(shapes::cuboid(vec3(0.8, 0.8, 0.005)))?;
    let material = scene.add_material(mask)?;
    let place = scene.add(scene.root(), turned(-1.0, 0.82, 0.0, 0.3))?;
    scene.add(place, Core::Geometry { geometry: sieve, material })?;

    let panes = [(vec3(0.9, 0.1, 0.1), 0.0), (vec3(0.1, 0.7, 0.2), -0.5), (vec3(0.1, 0.2, 0.9), -1.0)];
    for (i, (color, z)) in panes.into_iter().enumerate() {
        let pane = Material { base_color: color.extend(0.5), alpha_mode: AlphaMode::Blend, ..Material::default() };
        let i = i as f64;
        put(scene, shapes::cuboid(vec3(0.45, 0.6, 0.01)), pane, at(0.7 + 0.4 * i, 0.62 + 0.15 * i, z))?;
    }
    add_sun(scene, 3.0)?;
    Ok(look(dvec3(0.2, 1.6, 4.5), dvec3(0.15, 0.7, 0.0)))
}

/// One single-sided, unsymmetrical mesh under scales of every combination of signs, with flat and smooth normals: none
/// may appear inside out.
pub(crate) fn mirrored(scene: &mut Scene) -> Result<View> {
    stand_on_floor(scene, Vec3::splat(0.5))?;
    let part = Material { double_sided: false, ..Material::diffuse(vec3(0.85, 0.45, 0.15)) };
    let geometries = [shapes::cuboid(Vec3::ONE), shapes::sphere(3)];
    let [block, ball] = geometries.map(|geometry| scene.add_geometry(geometry));
    let (block, ball, material) = (block?, ball?, scene.add_material(part)?);
    for i in 0..8_u32 {
        let sign = |bit: u32| if i & bit == 0 { 1.0 } else { -1.0 };
        let center = dvec3(f64::from(i % 4) * 1.3 - 1.95, 0.62, -1.2 * f64::from(i / 4) + 0.6);
        let scale = dvec3(sign(1), sign(2), sign(4)) * 0.5;
        let rotation = DQuat::from_rotation_y(0.3);
        let piece = scene.add(scene.root(), Transform::Trs { translation: center, rotation, scale })?;
        let strokes = [
            (block, dvec3(-0.4, 0.0, 0.0), dvec3(0.2, 1.0, 0.2)),
            (block, dvec3(0.2, 0.8, 0.0), dvec3(0.5, 0.2, 0.2)),
            (ball, dvec3(0.15, 0.0, 0.25), dvec3(0.35, 0.3, 0.3)),
        ];
        for (geometry, translation, scale) in strokes {
            let rotation = DQuat::IDENTITY;
            let stroke = scene.add(piece, Transform::Trs { translation, rotation, scale })?;
            scene.add(stroke, Core::Geometry { geometry, material })?;
        }
    }
    add_sun(scene, 3.0)?;
    Ok(look(dvec3(0.8, 2.6, 4.4), dvec3(0.0, 0.4, -0.2)))
}

/// A red spot light, a green point light whose range ends on the floor, and a dim blue directional light, all with
/// shadows.
pub(crate) fn lights(scene: &mut Scene) -> Result<View> {
    stand_on_floor(scene, Vec3::splat(0.8))?;
    for (x, z) in [(-1.4, 0.0), (0.0, -0.4), (1.4, 0.0)] {
        put(scene, shapes::sphere(4), Material::diffuse(Vec3::splat(0.8)), scaled(x, 0.4, z, DVec3::splat(0.4)))?;
    }
    let light = |kind, color, intensity, range| Light { kind, color, intensity, range };
    let spot = LightKind::Spot { inner_cone_angle: 0.3, outer_cone_angle: 0.45 };
    let spot = light(spot, vec3(1.0, 0.15, 0.1), 16.0, None);
    let point = light(LightKind::Point, vec3(0.1, 1.0, 0.2), 3.0, Some(1.9));
    let directional = light(LightKind::Directional, vec3(0.2, 0.3, 1.0), 0.6, None);
    for (light, from, to) in [
        (spot, dvec3(-2.4, 2.4, 1.2), dvec3(-1.4, 0.2, 0.0)),
        (point, dvec3(0.5, 1.0, 0.6), DVec3::ZERO),
        (directional, dvec3(2.0, 3.0, 1.0), DVec3::ZERO),
    ] {
        let pose = scene.add(scene.root(), Transform::looking_at(from, to, DVec3::Y))?;
        scene.add(pose, light)?;
    }
    let mut view = look(dvec3(0.0, 2.4, 4.6), dvec3(0.0, 0.1, 0.0));
    view.sky = Sky::uniform(Vec3::splat(0.03));
    Ok(view)
}

/// Colours by vertex: a cube in RGB space, and a ball striped by hue.
pub(crate) fn vertex_colors(scene: &mut Scene) -> Result<View> {
    stand_on_floor(scene, Vec3::splat(0.5))?;
    let colored = |mut geometry: Geometry, color: fn(Vec3) -> Vec3| {
        geometry.colors = Some(geometry.positions.iter().map(|&p| color(p).extend(1.0)).collect());
        geometry
    };
    let cube = colored(shapes::cuboid(Vec3::ONE), |p| p * 0.5 + 0.5);
    let pose = Transform::Trs {
        translation: dvec3(-0.9, 0.7, 0.0),
        rotation: DQuat::from_rotation_y(FRAC_PI_4),
        scale: DVec3::splat(0.6),
    };
    put(scene, cube, Material { unlit: true, ..Material::default() }, pose)?;
    let ball = colored(shapes::sphere(5), |p| {
        let hue = p.z.atan2(p.x) / TAU + p.y;
        vec3(hue, hue + 1.0 / 3.0, hue + 2.0 / 3.0).map(|h| 0.5 + 0.5 * (h * TAU).cos())
    });
    put(scene, ball, Material::default(), scaled(1.0, 0.8, 0.0, DVec3::splat(0.8)))?;
    add_sun(scene, 2.5)?;
    Ok(look(dvec3(0.0, 1.9, 4.0), dvec3(0.0, 0.7, 0.0)))
}

/// Without lights: emissive materials, with and without a texture, and unlit ones are seen; the others are black.
pub(crate) fn emissive_unlit(scene: &mut Scene) -> Result<View> {
    let checker = checkerboard(scene, FilterMode::Nearest)?;
    let black = Material::diffuse(Vec3::ZERO);
    let materials = [
        Material { emissive: vec3(1.0, 0.5, 0.1), ..black.clone() },
        Material { emissive: vec3(0.2, 3.0, 4.0), ..black.clone() },
        Material { emissive: vec3(0.3, 1.0, 0.4), emissive_texture: checker.base_color_texture, ..black },
        Material { unlit: true, ..Material::diffuse(vec3(0.6, 0.1, 0.5)) },
        Material { unlit: true, ..checker },
        Material::diffuse(Vec3::splat(0.8)),
    ];
    for (i, material) in materials.into_iter().enumerate() {
        let textured = i == 2 || i == 4;
        let pose = Transform::Trs {
            translation: dvec3((i % 3) as f64 * 1.4 - 1.4, 0.65 - 1.3 * (i / 3) as f64, 0.0),
            rotation: DQuat::from_rotation_y(0.5) * DQuat::from_rotation_x(0.4),
            scale: DVec3::splat(if textured { 0.4 } else { 0.5 }),
        };
        put(scene, if textured { shapes::cuboid(Vec3::ONE) } else { shapes::sphere(4) }, material, pose)?;
    }
    let mut view = look(DVec3::Z * 4.5, DVec3::ZERO);
    view.sky = Sky::uniform(Vec3::ZERO);
    Ok(view)
}

/// A city of one shared block under an orthographic camera: parallel edges stay parallel.
pub(crate) fn orthographic_instances(scene: &mut Scene) -> Result<View> {
    stand_on_floor(scene, vec3(0.55, 0.6, 0.5))?;
    let block = scene.add_geometry(shapes::cuboid(Vec3::splat(0.5)))?;
    let palette = [vec3(0.85, 0.8, 0.7), vec3(0.7, 0.35, 0.25), vec3(0.35, 0.45, 0.6)];
    let mut cores = Vec::new();
    for color in palette {
        let material = scene.add_material(Material::diffuse(color))?;
        cores.push(scene.add_core(Core::Geometry { geometry: block, material })?);
    }
    for i in 0..12_i32 {
        for j in 0..12_i32 {
            let height = 0.3 + f64::from((i * 7 + j * 5 + i * j) % 11) * 0.14;
            let place = dvec3(f64::from(i) - 5.5, 0.5 * height, f64::from(j) - 5.5);
            let node = scene.add(scene.root(), scaled(place.x, place.y, place.z, dvec3(0.7, height, 0.7)))?;
            scene.add(node, cores[((i + 2 * j) % 3) as usize])?;
        }
    }
    add_sun(scene, 2.5)?;
    let camera = Camera::orthographic(5.0, 3.75);
    Ok(View { camera, ..look(dvec3(10.0, 8.0, 10.0), dvec3(0.0, 0.3, 0.0)) })
}

/// Balls from smooth to rough; upper row of metal, lower of plastic; the last of each by texture.
pub(crate) fn metallic_roughness(scene: &mut Scene) -> Result<View> {
    // Green is roughness, blue is metallic.
    let texels = [[0, 0, 255, 255], [0, 200, 255, 255], [0, 60, 0, 255], [0, 255, 0, 255]].into();
    let texture = scene.add_texture(Texture { width: 2, height: 2, texels })?;
    let sampler = Sampler { filter: FilterMode::Nearest, ..Sampler::default() };
    let by_texture = TextureRef { sampler, ..TextureRef::new(texture) };
    for row in 0..2 {
        for column in 0..5 {
            let material = Material {
                base_color: Vec4::new(0.9, 0.6, 0.2, 1.0),
                metallic: 1.0 - row as f32,
                roughness: column as f32 / 4.0,
                ..Material::default()
            };
            let place = scaled(column as f64 * 1.1 - 2.75, 0.6 - 1.2 * row as f64, 0.0, DVec3::splat(0.5));
            put(scene, shapes::sphere(4), material, place)?;
        }
        let texture = Some(by_texture);
        let base_color = Vec4::new(0.9, 0.6, 0.2, 1.0);
        let material =
            Material { base_color, metallic: 1.0, metallic_roughness_texture: texture, ..Material::default() };
        let place = turned(2.75, 0.6 - 1.2 * row as f64, 0.0, 0.6);
        put(scene, shapes::cuboid(Vec3::splat(0.4)), material, place)?;
    }
    add_sun(scene, 3.0)?;
    let camera = Camera::perspective(0.66);
    Ok(View { camera, ..look(dvec3(0.0, 0.6, 8.0), DVec3::ZERO) })
}

/// Flat plates whose normals come from a texture of round bumps, at three strengths: 0, 1 and -1 (dents).
pub(crate) fn normal_texture(scene: &mut Scene) -> Result<View> {
    let bump = |p: Vec2| {
        let from_middle = (p * 4.0).fract() * 2.0 - 1.0;
        let inside = from_middle.length() < 0.8;
        // Texture coordinates run down, the tangent space of glTF runs up.
        let slope = if inside { from_middle * vec2(1.0, -1.0) } else { Vec2::ZERO };
        slope.extend((1.0 - slope.length_squared()).max(0.0).sqrt())
    };
    const SIZE: u32 = 64;
    let texel = |x: u32, y: u32| {
        let normal = bump((vec2(x as f32, y as f32) + 0.5) / SIZE as f32);
        let [r, g, b] = normal.to_array().map(|c| ((c * 0.5 + 0.5) * 255.0).round() as u8);
        [r, g, b, 255]
    };
    let texels = (0..SIZE).flat_map(|y| (0..SIZE).map(move |x| texel(x, y))).collect();
    let texture = scene.add_texture(Texture { width: SIZE, height: SIZE, texels })?;
    for (i, normal_scale) in [0.0, 1.0, -1.0].into_iter().enumerate() {
        let material = Material {
            normal_texture: Some(TextureRef::new(texture)),
            normal_scale,
            roughness: 0.4,
            ..Material::diffuse(vec3(0.3, 0.5, 0.7))
        };
        let place = scaled(i as f64 * 1.3 - 1.3, 0.0, 0.0, DVec3::ONE);
        put(scene, shapes::cuboid(vec3(0.6, 0.9, 0.05)), material, place)?;
    }
    add_sun(scene, 3.0)?;
    Ok(look(dvec3(0.0, 0.0, 3.8), DVec3::ZERO))
}

/// A view from `eye` at `target` under a grey sky.
fn look(eye: DVec3, target: DVec3) -> View {
    let mut view = View::look_at(eye, target, DVec3::Y, Camera::default(), WIDTH, HEIGHT);
    view.sky = grey_sky();
    view
}

fn grey_sky() -> Sky {
    let [zenith, horizon, ground] = [0.30, 0.36, 0.12].map(Vec3::splat);
    Sky { zenith, horizon, ground, up: Vec3::Y }
}

/// A material that shows light and dark squares, four along each side of the texture.
fn checkerboard(scene: &mut Scene, filter: FilterMode) -> Result<Material> {
    let color = |p: Vec2| {
        let square = (p * 4.0).floor();
        if (square.x + square.y) as i32 % 2 == 0 { vec3(0.9, 0.85, 0.7) } else { vec3(0.1, 0.12, 0.2) }
    };
    let texture = scene.add_texture(textures::from_fn(64, color))?;
    let sampler = Sampler { filter, ..Sampler::default() };
    let texture = TextureRef { sampler, ..TextureRef::new(texture) };
    Ok(Material { base_color_texture: Some(texture), ..Material::default() })
}

fn stand_on_floor(scene: &mut Scene, color: Vec3) -> Result<()> {
    put(scene, shapes::square(20.0), Material::diffuse(color), Transform::IDENTITY).map(|_| ())
}

/// From the upper left, behind the viewer.
fn add_sun(scene: &mut Scene, intensity: f32) -> Result<()> {
    let pose = Transform::looking_at(dvec3(-2.0, 4.0, 3.0), DVec3::ZERO, DVec3::Y);
    let pose = scene.add(scene.root(), pose)?;
    let sun = Light { kind: LightKind::Directional, color: Vec3::ONE, intensity, range: None };
    scene.add(pose, sun).map(|_| ())
}

fn put(scene: &mut Scene, geometry: Geometry, material: Material, transform: Transform) -> Result<NodeKey> {
    let (geometry, material) = (scene.add_geometry(geometry)?, scene.add_material(material)?);
    let place = scene.add(scene.root(), transform)?;
    scene.add(place, Core::Geometry { geometry, material })
}

fn at(x: f64, y: f64, z: f64) -> Transform {
    Transform::from_translation(dvec3(x, y, z))
}

fn scaled(x: f64, y: f64, z: f64, scale: DVec3) -> Transform {
    Transform::Trs { translation: dvec3(x, y, z), rotation: DQuat::IDENTITY, scale }
}

fn turned(x: f64, y: f64, z: f64, angle: f64) -> Transform {
    Transform::Trs { translation: dvec3(x, y, z), rotation: DQuat::from_rotation_y(angle), scale: DVec3::ONE }
}
