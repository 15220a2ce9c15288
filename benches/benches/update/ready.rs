//! From an edit to arrays that can be traced: the time of each step, and the bytes that an executor would copy.

use std::time::{Duration, Instant};

use glam::{DVec3, Vec3};
use ropewalk::accel::TlasUpdate;
use ropewalk::compile::Compiler;
use ropewalk::device::{DeviceArrays, DeviceBuffer};
use ropewalk::graph::KeepTransform;
use ropewalk::graph::Switch;
use ropewalk::{Core, Geometry, GeometryKey, Material, MaterialKey, NodeKey, Scene};

use crate::propagation::transform;
use crate::shape::{HUMANOID, Pose, Shape, choose};

/// The viewpoint.
pub const EYE: DVec3 = DVec3::new(0.0, 0.0, 100.0);

/// A kind of edit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edit {
    Nothing,
    Move,
    Insert,
    /// The inserted nodes are removed.
    Remove,
    Reparent,
    Swap,
    Toggle,
}

impl Edit {
    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::Move => "move",
            Self::Insert => "insert",
            Self::Remove => "remove",
            Self::Reparent => "reparent",
            Self::Swap => "swap geometry",
            Self::Toggle => "toggle switch",
        }
    }
}

/// What one edit cost.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    pub edit: Duration,
    pub propagate: Duration,
    pub compile: Duration,
    pub tlas: Duration,
    /// From the end of the edit to ready to trace.
    pub total: Duration,
    pub bytes: usize,
    pub update: TlasUpdate,
}

/// A scene in which every joint shows a box, compiled.
pub struct Compiled {
    scene: Scene,
    compiler: Compiler,
    joints: Vec<NodeKey>,
    boxes: Vec<NodeKey>,
    geometries: [GeometryKey; 2],
    material: MaterialKey,
    /// The node above the first tree.
    switch: NodeKey,
    inserted: Vec<NodeKey>,
    round: usize,
}

impl Compiled {
    /// A joint and a box for each of `count` places.
    pub fn new(shape: Shape, count: usize, random: &mut fastrand::Rng) -> ropewalk::Result<Self> {
        let mut scene = Scene::new();
        let geometries = [scene.add_geometry(tetrahedron(0.3))?, scene.add_geometry(tetrahedron(0.2))?];
        let material = scene.add_material(Material::diffuse(Vec3::ONE))?;
        let switch = scene.add(scene.root(), Switch::All)?;
        let (mut joints, mut boxes) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let extent = 2.0 * (count as f64).cbrt();
        for (node, parent) in shape.parents(count).into_iter().enumerate() {
            let mut pose = Pose::random(random);
            let above = match parent {
                Some(parent) => joints[parent],
                None => {
                    pose.translation *= extent;
                    if node == 0 { switch } else { scene.root() }
                }
            };
            let joint = scene.add(above, transform(&pose))?;
            let geometry = geometries[usize::from(node == 1)];
            boxes.push(scene.add(joint, Core::Geometry { geometry, material })?);
            joints.push(joint);
        }
        let mut compiler = Compiler::new();
        compiler.compile(&mut scene, EYE)?;
        uploaded_bytes(compiler.arrays_mut());
        Ok(Self { scene, compiler, joints, boxes, geometries, material, switch, inserted: Vec::new(), round: 0 })
    }

    /// Edits `count` places and catches up.
    pub fn measure(&mut self, edit: Edit, count: usize, random: &mut fastrand::Rng) -> ropewalk::Result<Cost> {
        self.round += 1;
        let chosen = choose(random, count, self.joints.len());
        let poses: Vec<Pose> = chosen.iter().map(|_| Pose::random(random)).collect();
        let start = Instant::now();
        self.edit(edit, &chosen, &poses)?;
        let edited = Instant::now();
        if edit != Edit::Nothing {
            self.scene.hierarchy()?;
        }
        let propagated = Instant::now();
        let report = self.compiler.compile(&mut self.scene, EYE)?;
        let compiled = Instant::now();
        Ok(Cost {
            edit: edited - start,
            propagate: propagated - edited,
            compile: (compiled - propagated).saturating_sub(report.tlas_time),
            tlas: report.tlas_time,
            total: compiled - edited,
            bytes: uploaded_bytes(self.compiler.arrays_mut()),
            update: report.tlas,
        })
    }

    pub fn scene(&mut self) -> &mut Scene {
        &mut self.scene
    }

    fn edit(&mut self, edit: Edit, chosen: &[usize], poses: &[Pose]) -> ropewalk::Result<()> {
        let Self { scene, material, .. } = self;
        let material = *material;
        match edit {
            Edit::Nothing => {}
            Edit::Move => {
                for (&joint, pose) in chosen.iter().zip(poses) {
                    let moved = scene.local(self.joints[joint])?.with_rotation(pose.rotation);
                    scene.set_local(self.joints[joint], moved)?;
                }
            }
            Edit::Insert => {
                for (&joint, pose) in chosen.iter().zip(poses) {
                    let node = scene.add(self.joints[joint], transform(pose))?;
                    scene.add(node, Core::Geometry { geometry: self.geometries[0], material })?;
                    self.inserted.push(node);
                }
            }
            Edit::Remove => {
                for node in self.inserted.drain(..) {
                    scene.remove(node)?;
                }
            }
            Edit::Reparent => {
                for &joint in chosen {
                    // From one humanoid to the next.
                    let below = (joint - joint % HUMANOID + HUMANOID) % self.joints.len();
                    scene.reparent(self.boxes[joint], self.joints[below], KeepTransform::Local)?;
                }
            }
            Edit::Swap => {
                for &joint in chosen {
                    let [one, other] = self.geometries;
                    let shown = scene.node_core(self.boxes[joint])?.geometry();
                    let geometry = if shown == Some(one) { other } else { one };
                    scene.assign_core(self.boxes[joint], Core::Geometry { geometry, material })?;
                }
            }
            Edit::Toggle => {
                let shown = if self.round.is_multiple_of(2) { Switch::All } else { Switch::None };
                scene.assign_core(self.switch, shown)?;
            }
        }
        Ok(())
    }
}

fn tetrahedron(size: f32) -> Geometry {
    let corners = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z].map(|corner| corner * size);
    Geometry::new(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
}

/// What changed in the arrays since the last call, which an executor would copy to its device.
fn uploaded_bytes(arrays: &mut DeviceArrays) -> usize {
    fn bytes<T: bytemuck::Pod>(buffer: &mut DeviceBuffer<T>) -> usize {
        buffer.take_dirty().iter().map(ExactSizeIterator::len).sum::<usize>() * size_of::<T>()
    }
    bytes(&mut arrays.tlas_nodes)
        + bytes(&mut arrays.instances)
        + bytes(&mut arrays.blas_nodes)
        + bytes(&mut arrays.triangles)
        + bytes(&mut arrays.geometries)
        + bytes(&mut arrays.indices)
        + bytes(&mut arrays.normals)
        + bytes(&mut arrays.tex_coords)
        + bytes(&mut arrays.colors)
        + bytes(&mut arrays.materials)
        + bytes(&mut arrays.texture_infos)
        + bytes(&mut arrays.texels)
        + bytes(&mut arrays.lights)
}
