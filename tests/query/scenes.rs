//! Random scenes: soups, closed and flat geometry under transforms of all kinds, some hidden, some masked, some
//! singular.

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3, Vec4};
use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use ropewalk::compile::Compiler;
use ropewalk::graph::AlphaMode;
use ropewalk::graph::{BlasKind, Hierarchy, NodePath, Quality};
use ropewalk::{Core, Geometry, GeometryKey, Material, MaterialKey, Scene, Transform};

use ropewalk_testkit::oracle::has_area;
use ropewalk_testkit::{Mesh, Random};

/// The parameters of a random scene.
#[derive(Clone, Copy, Debug)]
pub struct Seed {
    pub seed: u64,
    pub instances: usize,
    /// The unit of length.
    pub unit: f64,
    /// The position of the scene, in those units.
    pub offset: f64,
}

/// Runs a property on random scenes.
pub fn check(cases: u32, property: impl Fn(Seed) -> Result<(), TestCaseError>) {
    let config = ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(cases) };
    TestRunner::new(config).run(&seed(), property).unwrap_or_else(|error| panic!("{error}"));
}

fn seed() -> impl Strategy<Value = Seed> {
    let units = prop::sample::select(vec![1.0, 1e-6, 1e6, 1e-15, 1e12]);
    let offsets = prop::sample::select(vec![0.0, 0.0, 100.0]);
    (any::<u64>(), 0..16usize, units, offsets).prop_map(|(seed, instances, unit, offset)| Seed {
        seed,
        instances,
        unit,
        offset,
    })
}

/// All kinds of structures; some have a triangle in several leaves.
const STRUCTURES: [BlasKind; 4] =
    [BlasKind::Bvh(Quality::Low), BlasKind::Bvh(Quality::Medium), BlasKind::Bvh(Quality::High), BlasKind::KdTree];

/// A scene, and the random numbers for queries of it.
pub struct World {
    pub scene: Scene,
    pub dice: Dice,
}

/// Random numbers for queries of a scene.
pub struct Dice {
    pub random: Random,
    pub center: DVec3,
    pub unit: f64,
}

impl World {
    pub fn new(seed: Seed) -> Self {
        let mut random = Random::new(seed.seed);
        let mut scene = Scene::new();
        let center = DVec3::new(1.0, -0.5, 0.25) * seed.offset * seed.unit;
        let geometries = [
            Mesh::soup(seed.seed, 60),
            Mesh::icosphere(1),
            Mesh::cube(),
            Mesh { positions: Vec::new(), indices: Vec::new() },
        ];
        let mut add = |mesh: Mesh| {
            let geometry = Geometry::new(mesh.positions, mesh.indices).with_blas_kind(STRUCTURES[random.index(4)]);
            scene.add_geometry(geometry).unwrap()
        };
        let geometries = geometries.map(&mut add);
        let hole = AlphaMode::Mask { cutoff: 0.5 };
        let glass = Vec4::new(1.0, 1.0, 1.0, 0.2);
        let materials = [
            Material::default(),
            Material { double_sided: false, ..Material::default() },
            Material { alpha_mode: hole, base_color: glass, ..Material::default() },
            Material { alpha_mode: AlphaMode::Blend, base_color: glass, ..Material::default() },
        ];
        let materials = materials.map(|material| scene.add_material(material).unwrap());
        let mut places = vec![scene.add(scene.root(), Transform::IDENTITY).unwrap()];
        for _ in 0..seed.instances {
            let place = scene.add(scene.root(), transform(&mut random, center, seed.unit, seed.unit)).unwrap();
            let inner = scene.add(place, transform(&mut random, DVec3::ZERO, 1.0, 1.0)).unwrap();
            scene.set_mask(place, 1 << random.index(3) | 1 << random.index(3)).unwrap();
            scene.set_visible(place, random.index(10) > 0).unwrap();
            let parent = if random.index(2) == 0 { place } else { inner };
            let (geometry, material) = (geometries[random.index(4)], materials[random.index(4)]);
            scene.add(parent, Core::Geometry { geometry, material }).unwrap();
            // Some subtrees are also shown elsewhere, by an instance.
            if random.index(3) == 0 {
                let again = scene.add(scene.root(), transform(&mut random, DVec3::ZERO, 1.0, seed.unit)).unwrap();
                scene.add(again, Core::Instance(place)).unwrap();
                places.push(again);
            }
            if random.index(6) == 0 {
                let again = scene.add(scene.root(), Core::MaterialGroup(materials[random.index(4)])).unwrap();
                scene.add(again, Core::Instance(places[random.index(places.len())])).unwrap();
            }
            places.push(place);
        }
        Self { scene, dice: Dice { random, center, unit: seed.unit } }
    }

    /// One mesh under a random transform.
    pub fn of_one(seed: Seed, mesh: Mesh) -> Self {
        let mut world = Self::new(Seed { instances: 0, ..seed });
        let geometry = world.scene.add_geometry(Geometry::new(mesh.positions, mesh.indices)).unwrap();
        let material = world.scene.add_material(Material::default()).unwrap();
        let place = transform(&mut world.dice.random, world.dice.center, seed.unit, seed.unit);
        let place = world.scene.add(world.scene.root(), place).unwrap();
        world.scene.add(place, Core::Geometry { geometry, material }).unwrap();
        world
    }
}

impl Dice {
    /// A point in or around the scene.
    pub fn point(&mut self) -> DVec3 {
        let reach = [1.0, 3.0, 10.0][self.random.index(3)];
        self.center + self.random.in_cube().as_dvec3() * reach * self.unit
    }

    /// The mask of a query: one or two of the three masks in use.
    pub fn mask(&mut self) -> u32 {
        1 << self.random.index(3) | 1
    }
}

/// A compiler that has caught up with the scene, and the render origin.
pub fn compiled(scene: &mut Scene) -> (Compiler, DVec3) {
    let mut compiler = Compiler::new();
    compiler.compile_from_last_viewpoint(scene).unwrap();
    let origin = compiler.origin();
    (compiler, origin)
}

/// A random transform: rotated, mirrored, sheared, or flattened to almost or exactly nothing, scaled by about `unit`,
/// at about `reach` from the center.
fn transform(random: &mut Random, center: DVec3, unit: f64, reach: f64) -> Transform {
    let rotation = DQuat::from_axis_angle(random.direction().as_dvec3(), f64::from(random.signed()) * 3.0);
    let mut scale = DVec3::ONE + random.in_cube().as_dvec3() * 0.7;
    let mut linear = DMat3::from_quat(rotation);
    match random.index(10) {
        0 => scale.x = -scale.x,
        1 => linear *= DMat3::from_cols(DVec3::X, DVec3::new(0.8, 1.0, 0.0), DVec3::new(-0.3, 0.5, 1.0)),
        2 => scale *= 0.02,
        3 => scale.y *= 1e-3,
        4 => scale *= 4.0,
        // Exactly singular: with a rotation, rounding would make its determinant nonzero.
        5 if random.index(3) == 0 => {
            scale.z = 0.0;
            linear = DMat3::IDENTITY;
        }
        _ => {}
    }
    let turn = if scale.z == 0.0 { DMat3::IDENTITY } else { DMat3::from_quat(rotation) };
    let linear = linear * DMat3::from_diagonal(scale * unit) * turn;
    Transform::Matrix(DAffine3::from_mat3_translation(linear, center + random.in_cube().as_dvec3() * 3.0 * reach))
}

/// A node with geometry that is drawn. World is relative to the render origin.
pub struct Drawn {
    pub path: NodePath,
    pub geometry: GeometryKey,
    pub material: MaterialKey,
    /// Properties of the material.
    pub surface: Material,
    pub local_from_world: DAffine3,
    pub world_from_local: DAffine3,
    /// With their indices in the geometry; those without area are no triangles.
    pub triangles: Vec<(u32, [DVec3; 3])>,
}

impl Drawn {
    /// The factor by which the matrix and its inverse may enlarge rounding errors; 3 for a rotation.
    pub fn condition(&self) -> f64 {
        let norm = |matrix: DMat3| matrix.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
        norm(self.world_from_local.matrix3) * norm(self.local_from_world.matrix3)
    }

    pub fn world_triangle(&self, i: usize) -> [DVec3; 3] {
        self.triangles[i].1.map(|corner| self.world_from_local.transform_point3(corner))
    }
}

/// All triangles that queries with this mask may find.
pub fn drawn(scene: &mut Scene, origin: DVec3, mask: u32) -> Vec<Drawn> {
    let (scene, hierarchy) = scene.with_hierarchy().unwrap();
    (0..hierarchy.nodes().len()).filter_map(|entry| draw(scene, hierarchy, entry, origin, mask)).collect()
}

/// A matrix that flattens space to a plane has a thickness, as the compiler gives it one; `None` for one that leaves
/// only a line. No scale in these scenes is below 1e-6 of the others without being zero.
fn with_least_thickness(matrix: &DMat3) -> Option<DMat3> {
    let DMat3 { x_axis, y_axis, z_axis } = *matrix;
    let size = x_axis.length().max(y_axis.length()).max(z_axis.length());
    let cofactors = [y_axis.cross(z_axis), z_axis.cross(x_axis), x_axis.cross(y_axis)];
    let normal = cofactors.into_iter().max_by(|a, b| a.length().total_cmp(&b.length())).unwrap();
    if normal.length() < 1e-12 * size * size {
        return None;
    }
    if matrix.determinant().abs() > 1e-12 * normal.length() * size {
        return Some(*matrix);
    }
    let normal = normal.normalize();
    let axis = DVec3::from_array(cofactors.map(|column| column.dot(normal))).normalize();
    Some(*matrix + DMat3::from_cols(normal * axis.x, normal * axis.y, normal * axis.z) * (size / 2048.0))
}

fn draw(scene: &Scene, hierarchy: &Hierarchy, entry: usize, origin: DVec3, mask: u32) -> Option<Drawn> {
    let path = hierarchy.path(entry);
    let Ok(&Core::Geometry { geometry, material }) = scene.node_core(path.node) else { return None };
    let placed = hierarchy.resolved()[entry];
    let material = placed.material.unwrap_or(material);
    let mut relative = placed.world_from_local;
    relative.translation -= origin;
    if !placed.visible || placed.mask & mask == 0 {
        return None;
    }
    relative.matrix3 = with_least_thickness(&relative.matrix3)?;
    // What f32 cannot hold is not drawn, and not found; what is found has the matrices of the scene.
    let (local_from_world, world_from_local) = (relative.inverse(), relative);
    let rounded = local_from_world.as_affine3();
    if !(rounded.is_finite() && rounded.as_daffine3().inverse().as_affine3().is_finite()) {
        return None;
    }
    let stored = scene.geometry(geometry).unwrap();
    let corners = stored.indices.iter().map(|t| t.map(|v| stored.positions[v as usize]));
    let with_area = (0..).zip(corners).filter(|&(_, corners)| has_area(corners));
    let triangles = with_area.map(|(index, corners)| (index, corners.map(Vec3::as_dvec3))).collect();
    let surface = scene.material(material).unwrap().clone();
    Some(Drawn { path, geometry, material, surface, local_from_world, world_from_local, triangles })
}
