//! From random numbers to edits of objects that exist, or existed.

use std::f64::consts::FRAC_PI_2;

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3, Vec4};
use proptest::prelude::*;
use ropewalk::graph::{Billboard, BlasKind, KeepTransform, LightKind, Lod, ObjectKey, Switch, TextureRef};
use ropewalk::{
    Camera, Core, CoreKey, Geometry, GeometryKey, Light, Material, MaterialKey, NodeKey, Scene, Texture, TextureKey,
    Transform,
};

use super::edit::Edit;
use super::model::Model;

/// Random numbers that become an edit when there are objects to choose from.
#[derive(Clone, Debug)]
pub(crate) struct RawEdit {
    pub(crate) kind: u8,
    pub(crate) a: u16,
    pub(crate) b: u16,
    pub(crate) value: u8,
}

pub(crate) fn raw_edit() -> impl Strategy<Value = RawEdit> {
    let numbers = (any::<u8>(), any::<u16>(), any::<u16>(), any::<u8>());
    numbers.prop_map(|(kind, a, b, value)| RawEdit { kind, a, b, value })
}

/// All keys that the scene has issued, in that order.
pub(crate) struct Issued {
    pub(crate) nodes: Vec<NodeKey>,
    pub(crate) cores: Vec<CoreKey>,
    pub(crate) geometries: Vec<GeometryKey>,
    pub(crate) materials: Vec<MaterialKey>,
    pub(crate) textures: Vec<TextureKey>,
}

impl Issued {
    pub(crate) fn new(scene: &Scene) -> Self {
        let (nodes, cores) = (vec![scene.root()], vec![scene.core_key(scene.root()).unwrap()]);
        Self { nodes, cores, geometries: vec![], materials: vec![], textures: vec![] }
    }

    pub(crate) fn resolve(&self, raw: &RawEdit, model: &Model) -> Edit {
        let node = |number| pick(&self.nodes, number, |key| model.nodes.contains_key(key));
        let core_key = |number| pick(&self.cores, number, |key| model.cores.contains_key(key));
        let geometry_key = |number| pick(&self.geometries, number, |key| model.geometries.contains_key(key));
        let material_key = |number| pick(&self.materials, number, |key| model.materials.contains_key(key));
        let texture_key = |number| pick(&self.textures, number, |key| model.textures.contains_key(key));

        let &RawEdit { kind, a, b, value } = raw;
        let core = || match value % 16 {
            0 => Core::Group,
            1..=4 => Core::Transform(transform((value / 16).wrapping_add(b as u8))),
            5 => Core::Light(light(value / 16)),
            6 => Core::Camera(camera(value / 16)),
            7 => Core::Switch(switch(value / 16)),
            8 => Core::MaterialGroup(material_key(b)),
            9 | 10 => Core::Instance(node(b)),
            11 => Core::Lod(Lod::by_distance([[1.0, 2.0], [3.0, 1.0]][usize::from(value / 128)])),
            12 => Core::Billboard(Billboard::Cylindrical([DVec3::X, DVec3::ZERO][usize::from(value / 128)])),
            _ => Core::Geometry { geometry: geometry_key(b), material: material_key(b / 3) },
        };
        let texture_ref = (value % 3 != 0).then(|| TextureRef::new(texture_key(b)));
        match kind % 32 {
            0..=3 => Edit::Add(node(a), core().into()),
            4 | 5 => Edit::Add(node(a), core_key(b).into()),
            6 => Edit::Remove(node(a)),
            7 | 8 => Edit::Reparent(node(a), node(b), KeepTransform::Local),
            9 | 10 | 31 => Edit::Reparent(node(a), node(b), KeepTransform::World),
            11 => Edit::AssignCore(node(a), core().into()),
            12 => Edit::AssignCore(node(a), core_key(b).into()),
            13 | 14 | 30 => Edit::SetLocal(node(a), transform(value)),
            15 => Edit::SetName(node(a), ["", "left", "right"][usize::from(value % 3)].into()),
            16 => Edit::SetMask(node(a), u32::MAX << (value % 3)),
            17 => Edit::SetVisible(node(a), value % 2 == 0),
            18 => Edit::SetCore(core_key(a), core()),
            19 | 24 if value % 2 == 1 => Edit::AddGeometry(geometry(value / 2)),
            19 | 24 if value % 4 == 0 => Edit::SetGeometry(geometry_key(a), geometry(value / 4)),
            19 | 24 => set_positions(geometry_key(a), value / 4),
            20 | 25 | 26 if value % 2 == 1 => Edit::AddMaterial(material(value / 2, texture_ref)),
            20 | 25 | 26 => Edit::SetMaterial(material_key(a), material(value / 2, texture_ref)),
            21 | 27 | 28 if value % 2 == 1 => Edit::AddTexture(texture(value / 2)),
            21 | 27 | 28 => Edit::SetTexture(texture_key(a), texture(value / 2)),
            22 => Edit::AddCore(core()),
            _ if value % 16 == 0 => Edit::RemoveUnused,
            _ => Edit::Add(node(a), Core::Transform(transform(value)).into()),
        }
    }
}

impl Issued {
    pub(crate) fn note(&mut self, created: Option<ObjectKey>) {
        match created {
            Some(ObjectKey::Node(key)) => self.nodes.push(key),
            Some(ObjectKey::Geometry(key)) => self.geometries.push(key),
            Some(ObjectKey::Material(key)) => self.materials.push(key),
            Some(ObjectKey::Texture(key)) => self.textures.push(key),
            _ => {}
        }
    }

    /// Some edits create a core besides the object that they return.
    pub(crate) fn note_cores(&mut self, model: &Model) {
        let mut new: Vec<_> = model.cores.keys().copied().filter(|key| !self.cores.contains(key)).collect();
        new.sort();
        self.cores.extend(new);
    }
}

/// Mostly a live key, sometimes a stale one; the null key if there is no such key.
fn pick<K: Copy + Default>(issued: &[K], number: u16, is_live: impl Fn(&K) -> bool) -> K {
    let (live, stale): (Vec<K>, Vec<K>) = issued.iter().copied().partition(is_live);
    let pool = if number % 32 == 31 { stale } else { live };
    let index = usize::from(number / 32) % pool.len().max(1);
    pool.get(index).copied().unwrap_or_default()
}

fn transform(value: u8) -> Transform {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.3);
    match value % 16 {
        0 => Transform::IDENTITY,
        1 => Transform::from_translation(DVec3::new(1.0, 0.0, 0.0)),
        2 => Transform::from_translation(DVec3::new(0.0, 3.0, -2.0)),
        3 => Transform::from_rotation(DQuat::from_rotation_z(FRAC_PI_2)),
        4 => Transform::from_rotation(turn),
        5 => Transform::from_scale(DVec3::splat(2.0)),
        6 => Transform::from_scale(DVec3::new(1.0, 2.0, 1.0)),
        7 => Transform::from_scale(DVec3::new(-1.0, 1.0, 1.0)),
        8 => Transform::from_scale(DVec3::ZERO),
        9 => Transform::Matrix(DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::Z))),
        10 => Transform::from_translation(DVec3::new(1e7, -1e7, 1e7)),
        11 => Transform::from_translation(DVec3::new(f64::NAN, 0.0, 0.0)),
        12 => Transform::Matrix(DAffine3::from_scale(DVec3::splat(f64::INFINITY))),
        13 => Transform::Trs { translation: DVec3::ONE, rotation: turn, scale: DVec3::splat(0.5) },
        14 => Transform::Pivoted {
            translation: DVec3::X,
            rotation: turn,
            scale: DVec3::new(1.0, 0.5, 1.0),
            scale_rotation: DQuat::from_rotation_x(0.4),
            pivot: DVec3::new(1.0, 2.0, 3.0),
        },
        _ => Transform::from_translation(DVec3::new(0.1, 0.2, 0.3)),
    }
}

fn switch(value: u8) -> Switch {
    match value % 4 {
        0 => Switch::None,
        1 => Switch::One(u32::from(value / 4)),
        2 => Switch::All,
        _ => Switch::Set([0, 2].into()),
    }
}

fn light(value: u8) -> Light {
    let intensity = [1.0, 2.0, f32::NAN, -1.0][usize::from(value % 4)];
    Light { kind: LightKind::Point, color: Vec3::ONE, intensity, range: None }
}

fn camera(value: u8) -> Camera {
    Camera::perspective([1.0, 0.5, 0.0, f32::INFINITY][usize::from(value % 4)])
}

fn geometry(value: u8) -> Geometry {
    let size = f32::from(value % 4 + 1);
    let positions = [Vec3::ZERO, Vec3::X * size, Vec3::Y, Vec3::Z - Vec3::X, Vec3::splat(1e6)];
    match value % 8 {
        0 => Geometry::default(),
        1 => Geometry::new(positions, [[0, 1, 5]]),
        2 => Geometry::new([Vec3::NAN, Vec3::X, Vec3::Y], [[0, 1, 2]]),
        3 => Geometry::new(positions, [[0, 1, 2]]).with_blas_kind(BlasKind::KdTree),
        _ => Geometry::new(positions, [[0, 1, 2], [0, 3, 2]]),
    }
}

/// An edit of positions, for the five vertices that most geometries have.
fn set_positions(key: GeometryKey, value: u8) -> Edit {
    let x = f32::from(value % 4);
    let positions = [Vec3::ZERO, Vec3::X * x, Vec3::Y, Vec3::Z, Vec3::ONE];
    match value / 4 % 8 {
        0 => Edit::SetPositions(key, vec![Vec3::NAN; 5], None),
        1 => Edit::SetPositions(key, positions[..4].to_vec(), None),
        2 => Edit::SetPositions(key, positions.to_vec(), Some(vec![Vec3::X; value as usize % 8])),
        3 => Edit::SetPositions(key, positions.to_vec(), Some(vec![Vec3::Y; 5])),
        _ => Edit::SetPositions(key, positions.to_vec(), None),
    }
}

fn material(value: u8, base_color_texture: Option<TextureRef>) -> Material {
    let base_color = Vec4::splat([0.0, 0.5, 1.0, 1.5][usize::from(value % 4)]);
    // Some materials use one texture twice.
    let normal_texture = base_color_texture.filter(|_| value.is_multiple_of(3));
    Material { base_color, base_color_texture, normal_texture, ..Material::default() }
}

fn texture(value: u8) -> Texture {
    let width = u32::from(value % 4);
    let texel_count = if value.is_multiple_of(5) { 3 } else { width as usize * 2 };
    Texture { width, height: 2, texels: vec![[value % 16; 4]; texel_count].into() }
}
