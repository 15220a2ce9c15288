//! The scene that is rendered when no file is named: a knot of golden rope in a round colonnade, with garlands of
//! beads.
//!
//! It is made in code, so that the first picture needs no download. Some eight hundred nodes share two dozen cores:
//! each column, bead and ball is a transform above a shared core.

pub(crate) mod shapes;
pub(crate) mod textures;

use std::f64::consts::TAU;

use glam::{DQuat, DVec3, Vec2, Vec3, dvec3, vec2};
use ropewalk::graph::{CoreKey, Geometry, Light, LightKind, Material, NodeKey, TextureRef};
use ropewalk::{Camera, Core, Result, Scene, Sky, Transform};

/// Columns around the court.
const COLUMNS: u32 = 14;
/// From the center of the court to the axes of the columns.
const RING_RADIUS: f64 = 6.0;
/// Height of a column with base and capital.
const COLUMN_HEIGHT: f64 = 4.0;
/// Beads on each garland between two columns.
const BEADS: u32 = 25;

/// Adds the colonnade and its light to an empty scene and returns its camera's node.
pub(crate) fn build(scene: &mut Scene) -> Result<NodeKey> {
    let root = scene.root();
    let texture = scene.add_texture(textures::marble(256))?;
    let marble = Material { base_color_texture: Some(TextureRef::new(texture)), roughness: 0.5, ..Material::default() };
    add_court(scene, root, &marble)?;
    add_colonnade(scene, root, &marble)?;
    add_knot(scene, root, &marble)?;
    add_balls(scene, root)?;

    // A low sun from the left, slightly behind the knot: columns and beads cast long shadows over the floor.
    let sun = Light { kind: LightKind::Directional, color: Vec3::new(1.0, 0.80, 0.56), intensity: 5.5, range: None };
    let sun_pose = Transform::looking_at(dvec3(-5.5, 2.9, 1.26), DVec3::ZERO, DVec3::Y);
    let sun_node = scene.add(root, sun_pose)?;
    scene.set_name(sun_node, "sun")?;
    scene.add(sun_node, sun)?;

    let eye = Transform::looking_at(dvec3(0.50, 1.66, 5.25), dvec3(0.05, 1.34, 0.0), DVec3::Y);
    let eye_node = scene.add(root, eye)?;
    let camera = scene.add(eye_node, Camera::perspective(0.80))?;
    scene.set_name(camera, "camera")?;
    Ok(camera)
}

/// The evening sky of the scene.
pub(crate) fn sky() -> Sky {
    Sky {
        zenith: Vec3::new(0.0, 0.22, 0.95),
        horizon: Vec3::new(0.78, 0.71, 0.62),
        ground: Vec3::new(0.16, 0.15, 0.15),
        up: Vec3::Y,
    }
}

/// The floor, the sea around it, and the steps below the knot.
fn add_court(scene: &mut Scene, root: NodeKey, marble: &Material) -> Result<()> {
    let texture = scene.add_texture(textures::marble_checker(512))?;
    let polished =
        Material { base_color_texture: Some(TextureRef::new(texture)), roughness: 0.0, ..Material::default() };
    let floor = core(scene, shapes::disk(7.4, 128, 2.0), polished)?;
    let node = scene.add(root, floor)?;
    scene.set_name(node, "floor")?;

    let water = Material { roughness: 0.0, ..Material::diffuse(Vec3::new(0.01, 0.03, 0.04)) };
    let sea = core(scene, shapes::square(4000.0), water)?;
    let node = add_at(scene, root, at(dvec3(0.0, -0.9, 0.0), 1.0), sea)?;
    scene.set_name(node, "sea")?;

    let step = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.9), (0.96, 1.0), (0.0, 1.0)];
    let step = core(scene, shapes::lathe(&points(&step), 96, 0, 0.0), marble.clone())?;
    let steps = group(scene, root, "steps")?;
    for (radius, bottom, height) in [(1.45, 0.0, 0.14), (1.15, 0.14, 0.14)] {
        let scale = dvec3(radius, height, radius);
        add_at(
            scene,
            steps,
            Transform::Trs { translation: DVec3::Y * bottom, rotation: DQuat::IDENTITY, scale },
            step,
        )?;
    }
    Ok(())
}

/// Columns, the ring of stone on top of them, and a garland from each to the next.
fn add_colonnade(scene: &mut Scene, root: NodeKey, marble: &Material) -> Result<()> {
    let colonnade = group(scene, root, "colonnade")?;

    // One profile for each part of a column; heights are measured from the floor.
    let height = COLUMN_HEIGHT as f32;
    let base = [(0.45, 0.06), (0.46, 0.12), (0.40, 0.15), (0.43, 0.18), (0.43, 0.24), (0.36, 0.28), (0.33, 0.32)];
    let shaft: Vec<(f32, f32)> =
        (0..=12).map(|i| i as f32 / 12.0).map(|t| (0.32 - 0.05 * t * t, 0.32 + t * (height - 0.72))).collect();
    let capital =
        [(0.27, -0.40), (0.29, -0.37), (0.27, -0.34), (0.30, -0.28), (0.42, -0.14), (0.45, -0.12), (0.45, 0.0)];
    let capital = capital.map(|(radius, below_top)| (radius, height + below_top));
    let parts = [
        core(scene, shapes::cuboid(Vec3::new(0.48, 0.06, 0.48)), marble.clone())?,
        core(scene, shapes::lathe(&points(&base), 48, 0, 0.0), marble.clone())?,
        core(scene, shapes::lathe(&points(&shaft), 192, 16, 0.10), marble.clone())?,
        core(scene, shapes::lathe(&points(&capital), 48, 0, 0.0), marble.clone())?,
    ];
    for i in 0..COLUMNS {
        let column = scene.add(colonnade, Transform::from_translation(column_axis(i)))?;
        scene.set_name(column, format!("column {i}"))?;
        for part in parts {
            scene.add(column, part)?;
        }
    }

    let (inner, outer) = (RING_RADIUS as f32 - 0.42, RING_RADIUS as f32 + 0.42);
    let ring = [
        (inner, 0.0),
        (outer, 0.0),
        (outer, 0.30),
        (outer + 0.08, 0.34),
        (outer + 0.08, 0.56),
        (inner - 0.08, 0.56),
        (inner - 0.08, 0.34),
        (inner, 0.30),
        (inner, 0.0),
    ];
    let ring = ring.map(|(radius, above)| (radius, height + above));
    let ring = core(scene, shapes::lathe(&points(&ring), 128, 0, 0.0), marble.clone())?;
    let ring = scene.add(colonnade, ring)?;
    scene.set_name(ring, "ring")?;

    add_garlands(scene, colonnade)
}

/// Beads on a parabola from each column to the next, every fifth a larger one of glass.
fn add_garlands(scene: &mut Scene, colonnade: NodeKey) -> Result<()> {
    let bead = scene.add_geometry(shapes::sphere(3))?;
    let mut bead_of = |material: Material| -> Result<CoreKey> {
        let material = scene.add_material(material)?;
        scene.add_core(Core::Geometry { geometry: bead, material })
    };
    let gold = bead_of(Material { roughness: 0.15, ..Material::mirror(Vec3::new(1.0, 0.72, 0.30)) })?;
    let coral = bead_of(Material { roughness: 0.25, ..Material::diffuse(Vec3::new(0.70, 0.10, 0.07)) })?;
    let turquoise = bead_of(Material { roughness: 0.25, ..Material::diffuse(Vec3::new(0.03, 0.38, 0.40)) })?;
    let glass = bead_of(Material::glass(1.5))?;

    for i in 0..COLUMNS {
        let garland = group(scene, colonnade, &format!("garland {i}"))?;
        let (from, to) = (column_axis(i), column_axis(i + 1));
        for b in 0..BEADS {
            let t = (f64::from(b) + 0.5) / f64::from(BEADS);
            let sag = 1.0 - (2.0 * t - 1.0).powi(2);
            let position = from.lerp(to, t) + DVec3::Y * (COLUMN_HEIGHT - 0.30 - 0.85 * sag);
            let (core, radius) = match b % 5 {
                2 => (glass, 0.085),
                1 | 3 => (gold, 0.045),
                _ if i.is_multiple_of(2) => (coral, 0.058),
                _ => (turquoise, 0.058),
            };
            add_at(scene, garland, at(position, radius), core)?;
        }
    }
    Ok(())
}

/// The rope: three strands of one geometry, tied into a trefoil knot, on a drum of marble.
fn add_knot(scene: &mut Scene, root: NodeKey, marble: &Material) -> Result<()> {
    let drum = [
        (0.62, 0.28),
        (0.62, 0.36),
        (0.56, 0.40),
        (0.50, 0.44),
        (0.50, 1.00),
        (0.54, 1.04),
        (0.60, 1.07),
        (0.60, 1.13),
        (0.57, 1.16),
        (0.0, 1.16),
    ];
    let drum = core(scene, shapes::lathe(&points(&drum), 96, 0, 0.0), marble.clone())?;
    let drum = scene.add(root, drum)?;
    scene.set_name(drum, "drum")?;

    let pose = Transform::Trs {
        translation: dvec3(0.0, 2.02, 0.0),
        rotation: DQuat::from_rotation_y(0.35) * DQuat::from_rotation_x(-0.10),
        scale: DVec3::splat(0.60),
    };
    let knot = scene.add(root, pose)?;
    scene.set_name(knot, "knot")?;
    let strand = scene.add_geometry(shapes::trefoil_strand(0.235))?;
    for (third, color) in [(0.98, 0.69, 0.27), (1.0, 0.78, 0.40), (0.93, 0.58, 0.20)].into_iter().enumerate() {
        let gold = Material { roughness: 0.12, ..Material::mirror(Vec3::from(color)) };
        let material = scene.add_material(gold)?;
        let rotation = DQuat::from_rotation_z(TAU / 3.0 * third as f64);
        let node = scene.add(knot, Transform::from_rotation(rotation))?;
        scene.add(node, Core::Geometry { geometry: strand, material })?;
    }
    Ok(())
}

/// Balls of mirror, glass and lacquer on the floor, and a ring of small ones around the steps.
fn add_balls(scene: &mut Scene, root: NodeKey) -> Result<()> {
    let ball = scene.add_geometry(shapes::sphere(5))?;
    let balls = group(scene, root, "balls")?;
    let mut ball_of = |material: Material| -> Result<CoreKey> {
        let material = scene.add_material(material)?;
        scene.add_core(Core::Geometry { geometry: ball, material })
    };
    let chrome = ball_of(Material::mirror(Vec3::splat(0.95)))?;
    let glass = ball_of(Material::glass(1.5))?;
    let green = ball_of(Material { base_color: Vec3::new(0.55, 0.95, 0.70).extend(1.0), ..Material::glass(1.5) })?;
    let red = ball_of(Material { roughness: 0.05, ..Material::diffuse(Vec3::new(0.62, 0.03, 0.03)) })?;
    let blue = ball_of(Material { roughness: 0.05, ..Material::diffuse(Vec3::new(0.02, 0.06, 0.38)) })?;

    for (x, z, radius, core) in [
        (-1.95, 0.75, 0.62, chrome),
        (1.45, 1.35, 0.44, glass),
        (2.30, 0.25, 0.36, red),
        (-0.95, 1.75, 0.24, green),
        (0.48, 1.92, 0.15, blue),
        (-2.15, 1.60, 0.19, red),
    ] {
        add_at(scene, balls, at(dvec3(x, radius, z), radius), core)?;
    }

    const SMALL: u32 = 48;
    for i in 0..SMALL {
        let angle = TAU * f64::from(i) / f64::from(SMALL);
        let (radius, core) = if i.is_multiple_of(2) { (0.055, chrome) } else { (0.035, blue) };
        let position = dvec3(angle.cos() * 1.30, 0.14 + radius, angle.sin() * 1.30);
        add_at(scene, balls, at(position, radius), core)?;
    }
    Ok(())
}

fn column_axis(i: u32) -> DVec3 {
    // Half a step off, so that the camera looks between two columns.
    let angle = TAU * (f64::from(i) + 0.5) / f64::from(COLUMNS) + 0.25 * TAU;
    dvec3(angle.cos(), 0.0, angle.sin()) * RING_RADIUS
}

/// A translation with a uniform scale.
fn at(translation: DVec3, scale: f64) -> Transform {
    Transform::Trs { translation, rotation: DQuat::IDENTITY, scale: DVec3::splat(scale) }
}

fn points(profile: &[(f32, f32)]) -> Vec<Vec2> {
    profile.iter().map(|&(radius, height)| vec2(radius, height)).collect()
}

fn core(scene: &mut Scene, geometry: Geometry, material: Material) -> Result<CoreKey> {
    let (geometry, material) = (scene.add_geometry(geometry)?, scene.add_material(material)?);
    scene.add_core(Core::Geometry { geometry, material })
}

fn group(scene: &mut Scene, parent: NodeKey, name: &str) -> Result<NodeKey> {
    let node = scene.add(parent, Core::Group)?;
    scene.set_name(node, name)?;
    Ok(node)
}

/// Adds a transform with a shared core below it.
fn add_at(scene: &mut Scene, parent: NodeKey, transform: Transform, core: CoreKey) -> Result<NodeKey> {
    let node = scene.add(parent, transform)?;
    scene.add(node, core)
}
