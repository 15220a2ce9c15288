//! A scene under random edits of every kind.

use std::f32::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DQuat, DVec3, Vec2, Vec3, Vec4};
use proptest::prelude::*;
use ropewalk::graph::{AlphaMode, Billboard, BlasKind, KeepTransform, LightKind, Lod, Quality, Switch, TextureRef};
use ropewalk::{
    Camera, Core, Geometry, GeometryKey, Light, Material, MaterialKey, NodeKey, Scene, Texture, TextureKey, Transform,
};

/// One random edit. Its numbers select from the objects that exist when it is applied.
#[derive(Clone, Debug)]
pub enum Edit {
    Insert(usize, usize, usize),
    Shine(usize, usize),
    Share(usize, usize),
    Move(usize, i8, i8),
    Scale(usize, i8),
    Remove(usize),
    Reparent(usize, usize),
    SetMask(usize, u32),
    SetVisible(usize, bool),
    SetMaterial(usize, usize),
    SetGeometry(usize, usize),
    Deform(usize, u8),
    Choose(usize, usize),
    SetTexture(usize, u8),
    SwapCore(usize, usize, usize),
    ChangeCore(usize, usize, usize),
}

pub fn edit() -> impl Strategy<Value = Edit> {
    let n = 0usize..64;
    prop_oneof![
        6 => (n.clone(), n.clone(), n.clone()).prop_map(|(a, b, c)| Edit::Insert(a, b, c)),
        1 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::Shine(a, b)),
        2 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::Share(a, b)),
        4 => (n.clone(), any::<i8>(), any::<i8>()).prop_map(|(a, x, y)| Edit::Move(a, x, y)),
        2 => (n.clone(), any::<i8>()).prop_map(|(a, s)| Edit::Scale(a, s)),
        2 => n.clone().prop_map(Edit::Remove),
        2 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::Reparent(a, b)),
        1 => (n.clone(), any::<u32>()).prop_map(|(a, m)| Edit::SetMask(a, m)),
        2 => (n.clone(), any::<bool>()).prop_map(|(a, v)| Edit::SetVisible(a, v)),
        2 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::SetMaterial(a, b)),
        1 => (n.clone(), any::<u8>()).prop_map(|(a, t)| Edit::SetTexture(a, t)),
        2 => (n.clone(), n.clone(), n.clone()).prop_map(|(a, b, c)| Edit::SwapCore(a, b, c)),
        3 => (n.clone(), n.clone(), n).prop_map(|(a, b, c)| Edit::ChangeCore(a, b, c)),
    ]
}

/// The same edits, and changes of geometries, most of which are deformations.
pub fn edit_with_geometries() -> impl Strategy<Value = Edit> {
    let n = 0usize..64;
    prop_oneof![
        12 => edit(),
        1 => (n.clone(), n.clone()).prop_map(|(a, b)| Edit::SetGeometry(a, b)),
        6 => (n.clone(), any::<u8>()).prop_map(|(a, b)| Edit::Deform(a, b)),
        1 => (n.clone(), n).prop_map(|(a, b)| Edit::Choose(a, b)),
    ]
}

/// A scene, and keys of objects to edit. Stale keys are replaced by those of new objects.
pub struct World {
    pub scene: Scene,
    pub nodes: Vec<NodeKey>,
    geometries: Vec<GeometryKey>,
    pub materials: Vec<MaterialKey>,
    textures: Vec<TextureKey>,
}

impl World {
    pub fn new() -> Self {
        let scene = Scene::new();
        let nodes = vec![scene.root()];
        Self { scene, nodes, geometries: Vec::new(), materials: Vec::new(), textures: Vec::new() }
    }

    /// Adds a few objects of each kind.
    pub fn populate(&mut self) {
        for i in 0..12 {
            self.apply(&Edit::Insert(i / 2, i, i));
        }
        self.apply(&Edit::Shine(0, 1));
    }

    pub fn apply(&mut self, edit: &Edit) {
        match *edit {
            Edit::Insert(parent, geometry, material) => {
                let parent = self.node(parent);
                let core = self.core(geometry, material);
                let place = Transform::from_translation(DVec3::new(geometry as f64, material as f64, 0.5));
                let node = self.scene.add(parent, place).unwrap();
                self.scene.add(node, core).unwrap();
                self.nodes.push(node);
            }
            Edit::Shine(parent, kind) => {
                let cone = LightKind::Spot { inner_cone_angle: 0.1, outer_cone_angle: 0.5 };
                let kind = [LightKind::Point, cone, LightKind::Directional][kind % 3];
                let light = Light { kind, color: Vec3::ONE, intensity: 10.0, range: None };
                let parent = self.node(parent);
                self.scene.add(parent, light).unwrap();
            }
            Edit::Share(parent, source) => {
                let (parent, source) = (self.node(parent), self.node(source));
                let core = self.scene.core_key(source).unwrap();
                // Instances must not form cycles.
                self.nodes.extend(self.scene.add(parent, core).ok());
            }
            Edit::Move(node, x, y) => {
                let node = self.node(node);
                let place = Transform::from_translation(DVec3::new(f64::from(x), f64::from(y), 1.0) / 8.0);
                // The root and geometry nodes have no transform: the call fails and leaves the scene as it was.
                let _ = self.scene.set_local(node, place);
            }
            Edit::Scale(node, scale) => {
                let node = self.node(node);
                let (x, rotation) = (f64::from(scale) / 16.0, DQuat::from_rotation_z(f64::from(scale)));
                let place = Transform::Trs { translation: DVec3::X, rotation, scale: DVec3::new(x, 1.0, -1.0) };
                let _ = self.scene.set_local(node, place);
            }
            Edit::Remove(node) => {
                let node = self.node(node);
                let _ = self.scene.remove(node);
                self.forget_stale_keys();
            }
            Edit::Reparent(node, parent) => {
                let (node, parent) = (self.node(node), self.node(parent));
                let _ = self.scene.reparent(node, parent, KeepTransform::Local);
            }
            Edit::SetMask(node, mask) => {
                let node = self.node(node);
                self.scene.set_mask(node, mask).unwrap();
            }
            Edit::SetVisible(node, visible) => {
                let node = self.node(node);
                self.scene.set_visible(node, visible).unwrap();
            }
            Edit::SetMaterial(which, value) => {
                let (key, texture) = (self.material(which), self.texture(value));
                self.scene.set_material(key, material(value, texture)).unwrap();
            }
            Edit::SetGeometry(which, value) => {
                let key = self.geometry(which);
                self.scene.set_geometry(key, mesh(value)).unwrap();
            }
            Edit::Deform(which, value) => {
                let key = self.geometry(which);
                let geometry = self.scene.geometry(key).unwrap();
                let (positions, mut normals) = (deformed(&geometry.positions, value), None);
                if value & 2 == 0 && geometry.normals.is_some() {
                    normals = Some(positions.iter().map(|p| p.normalize_or(Vec3::Z)).collect());
                }
                self.scene.set_positions(key, positions, normals).unwrap();
            }
            Edit::Choose(which, structure) => {
                let key = self.geometry(which);
                let bvh = |quality| Some(BlasKind::Bvh(quality));
                let choices = [None, bvh(Quality::Low), bvh(Quality::High), Some(BlasKind::KdTree)];
                let geometry = self.scene.geometry(key).unwrap().clone().with_blas_kind(choices[structure % 4]);
                self.scene.set_geometry(key, geometry).unwrap();
            }
            Edit::SetTexture(which, value) => {
                let key = self.texture(which);
                self.scene.set_texture(key, texture(value)).unwrap();
            }
            Edit::SwapCore(node, geometry, material) => {
                let node = self.node(node);
                let core = self.core(geometry, material);
                let _ = self.scene.assign_core(node, core);
            }
            Edit::ChangeCore(node, kind, i) => {
                let key = self.scene.core_key(self.node(node)).unwrap();
                let core = self.any_core(kind, i);
                let _ = self.scene.set_core(key, core);
            }
        }
    }

    /// Forgets the keys of removed nodes.
    pub fn forget_stale_keys(&mut self) {
        let scene = &self.scene;
        self.nodes.retain(|&node| scene.contains(node));
    }

    /// A core of any kind.
    fn any_core(&mut self, kind: usize, i: usize) -> Core {
        match kind % 12 {
            0 => Core::Group,
            5 => Core::Switch(Switch::One(i as u32 % 3)),
            6 => Core::Switch(Switch::Set([1, 2].into())),
            7 => Core::MaterialGroup(self.material(i)),
            8 => Core::Instance(self.node(i)),
            9 => Core::Lod(Lod::by_distance([i as f64 / 4.0 + 0.1])),
            10 => Core::Lod(Lod::by_projected_size(1.0, [i as f64 / 64.0 + 0.01])),
            11 => Core::Billboard(if i.is_multiple_of(2) {
                Billboard::Spherical
            } else {
                Billboard::Cylindrical(DVec3::Y)
            }),
            1 => Core::Transform(Transform::from_translation(DVec3::X * i as f64)),
            2 => Core::Camera(Camera::default()),
            3 => Core::Light(Light { kind: LightKind::Point, color: Vec3::ONE, intensity: i as f32, range: None }),
            _ => self.core(i, i),
        }
    }

    fn node(&self, i: usize) -> NodeKey {
        self.nodes[i % self.nodes.len()]
    }

    fn core(&mut self, geometry: usize, material: usize) -> Core {
        Core::Geometry { geometry: self.geometry(geometry), material: self.material(material) }
    }

    /// One of four geometries, added again if it was freed.
    fn geometry(&mut self, i: usize) -> GeometryKey {
        let scene = &self.scene;
        self.geometries.retain(|&key| scene.geometry(key).is_ok());
        if self.geometries.len() < 4 {
            self.geometries.push(self.scene.add_geometry(mesh(i)).unwrap());
        }
        self.geometries[i % self.geometries.len()]
    }

    fn material(&mut self, i: usize) -> MaterialKey {
        let scene = &self.scene;
        self.materials.retain(|&key| scene.material(key).is_ok());
        if self.materials.len() < 4 {
            let value = material(i, self.texture(i));
            self.materials.push(self.scene.add_material(value).unwrap());
        }
        self.materials[i % self.materials.len()]
    }

    fn texture(&mut self, i: usize) -> TextureKey {
        let scene = &self.scene;
        self.textures.retain(|&key| scene.texture(key).is_ok());
        if self.textures.len() < 2 {
            self.textures.push(self.scene.add_texture(texture(i as u8)).unwrap());
        }
        self.textures[i % self.textures.len()]
    }
}

/// Materials of every kind the compiler tells apart.
fn material(i: usize, texture: TextureKey) -> Material {
    let textured = Some(TextureRef::new(texture));
    match i % 6 {
        0 => Material { base_color_texture: textured, ..Material::diffuse(Vec3::splat(0.5)) },
        1 => Material::mirror(Vec3::ONE),
        2 => Material::glass(1.5),
        3 => Material {
            alpha_mode: AlphaMode::Mask { cutoff: 0.5 },
            base_color_texture: textured,
            ..Material::default()
        },
        4 => Material { alpha_mode: AlphaMode::Blend, double_sided: false, ..Material::default() },
        _ => Material { normal_texture: textured, emissive_texture: textured, unlit: true, ..Material::default() },
    }
}

fn texture(i: u8) -> Texture {
    Texture { width: 2, height: 1, texels: Arc::new([[i, 1, 2, 255], [3, i, 5, 128]]) }
}

/// A tetrahedron or, for some, a sphere of many triangles, with the streams that `i` says.
pub fn mesh(i: usize) -> Geometry {
    let corner = 1.0 + i as f32 * 0.1;
    let tetrahedron = ([Vec3::ZERO, Vec3::X * corner, Vec3::Y, Vec3::Z], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]);
    let mut geometry = if i % 4 == 3 { sphere(corner) } else { Geometry::new(tetrahedron.0, tetrahedron.1) };
    let vertex_count = geometry.positions.len();
    let colors = [Vec4::ONE, Vec4::X, Vec4::Y, Vec4::splat(0.25)];
    let [tex_coords, reversed] = [[Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE], [Vec2::ONE, Vec2::X, Vec2::Y, Vec2::ZERO]];
    if i & 1 != 0 {
        let normals = [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X];
        geometry.normals = Some((0..vertex_count).map(|v| normals[v % 4]).collect());
        geometry.tex_coords[0] = Some((0..vertex_count).map(|v| tex_coords[v % 4]).collect());
    }
    if i & 2 != 0 {
        geometry.tex_coords[1] = Some((0..vertex_count).map(|v| reversed[v % 4]).collect());
        geometry.colors = Some((0..vertex_count).map(|v| colors[v % 4]).collect());
    }
    geometry
}

/// 12 x 10 quads around, those at the poles without area on one side.
fn sphere(radius: f32) -> Geometry {
    let point = |i: usize| {
        let (u, v) = ((i % 13) as f32 / 12.0 * TAU, (i / 13) as f32 / 10.0 * PI);
        let ring = if (i / 13).is_multiple_of(10) { 0.0 } else { v.sin() };
        Vec3::new(ring * u.cos(), v.cos(), ring * u.sin()) * radius
    };
    let cells = (0..120u32).map(|cell| cell / 12 * 13 + cell % 12);
    let triangles = cells.flat_map(|a| [[a, a + 1, a + 14], [a, a + 14, a + 13]]);
    Geometry::new((0..143).map(point).collect::<Vec<_>>(), triangles.collect::<Vec<_>>())
}

/// Positions displaced by a wave. For some values two corners of a triangle become equal, for others triangles grow
/// very large.
fn deformed(positions: &[Vec3], value: u8) -> Vec<Vec3> {
    let phase = f32::from(value) * 0.1;
    let wave = |p: &Vec3| *p + 0.1 * Vec3::new((p.y * 3.0 + phase).sin(), (p.z * 2.0 + phase).cos(), phase.sin());
    let mut deformed: Vec<Vec3> = positions.iter().map(wave).collect();
    match value % 16 {
        0 => deformed[1] = deformed[0],
        1 => deformed.iter_mut().for_each(|p| p.x += 4.0 * (p.dot(Vec3::new(12.9, 78.2, 37.7)).sin() * 437.5).fract()),
        _ => {}
    }
    deformed
}
