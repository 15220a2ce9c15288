//! A scene of ours in the making, and the triangles that it shows, in f64.

use glam::{DAffine3, DVec3, Vec3};
use ropewalk::device::layout::RayRecord;
use ropewalk::{Core, CoreKey, Material, NodeKey, Scene, Transform};
use ropewalk_bench::Result;
use ropewalk_bench::columns::{Placed, soup};

use crate::row::Row;

/// The scene.
#[derive(Default)]
pub struct World {
    pub scene: Scene,
    first_triangles: Vec<(NodeKey, u32)>,
    triangles: Vec<[DVec3; 3]>,
}

impl World {
    /// A core that shows these triangles, for [`place`](Self::place).
    pub fn core(&mut self, triangles: &[[Vec3; 3]], material: Material) -> Result<CoreKey> {
        let geometry = self.scene.add_geometry(soup(triangles))?;
        let material = self.scene.add_material(material)?;
        Ok(self.scene.add_core(Core::Geometry { geometry, material })?)
    }

    /// Shows a core below a node. `world` is where it is then.
    pub fn place(&mut self, parent: NodeKey, core: CoreKey, world: &DAffine3) -> Result<NodeKey> {
        let node = self.scene.add(parent, core)?;
        self.first_triangles.push((node, self.triangles.len() as u32));
        if let Core::Geometry { geometry, .. } = *self.scene.core(core)? {
            let geometry = self.scene.geometry(geometry)?;
            let corner = |vertex: u32| world.transform_point3(geometry.positions[vertex as usize].as_dvec3());
            self.triangles.extend(geometry.indices.iter().map(|triangle| triangle.map(corner)));
        }
        Ok(node)
    }

    /// Shows triangles, opaque and two-sided, under a matrix.
    pub fn add(&mut self, triangles: &[[Vec3; 3]], world: DAffine3) -> Result<NodeKey> {
        let core = self.core(triangles, Material::default())?;
        let root = self.scene.root();
        let parent = self.scene.add(root, Transform::Matrix(world))?;
        self.place(parent, core, &world)
    }

    /// Declares that no ray is to hit what was added so far.
    pub fn hide_all(&mut self) {
        self.triangles.fill([DVec3::ZERO; 3]);
    }

    /// The scene compiled for an eye, and its triangles relative to the point that rays are relative to.
    pub fn compile(self, eye: DVec3) -> Result<(Placed, Vec<[DVec3; 3]>)> {
        let placed = Placed::new(self.scene, &self.first_triangles, eye)?;
        let relative = |corners: &[DVec3; 3]| corners.map(|corner| corner - placed.origin());
        let triangles = self.triangles.iter().map(relative).collect();
        Ok((placed, triangles))
    }

    /// As [`compile`](Self::compile), as if nobody had ever looked at the scene.
    pub fn compile_without_view(self, origin: DVec3) -> Result<(Placed, Vec<[DVec3; 3]>)> {
        let relative = |corners: &[DVec3; 3]| corners.map(|corner| corner - origin);
        let triangles = self.triangles.iter().map(relative).collect();
        Ok((Placed::without_view(self.scene, &self.first_triangles, origin)?, triangles))
    }

    /// A row of rays through the scene.
    pub fn row(self, rays: Vec<RayRecord>) -> Result<Row> {
        let (placed, triangles) = self.compile(DVec3::ZERO)?;
        Ok(Row::of_scene(placed, triangles, rays))
    }
}
