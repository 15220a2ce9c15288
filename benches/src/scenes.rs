//! The scenes that rays are measured in, each with a camera and a light.

use std::collections::HashSet;
use std::path::PathBuf;

use clap::ValueEnum;
use glam::{DVec3, Vec3, Vec4};
use ropewalk::compile::Compiler;
use ropewalk::device::DeviceArrays;
use ropewalk::device::Needs;
use ropewalk::device::layout::{HitRecord, InstanceRecord, NONE, Node, Triangle};
use ropewalk::{Camera, Material, Scene, View, gltf};

use crate::Result;
use crate::shapes::{add_copies, geometry_core, sphere};

/// The recipe of a scene.
#[derive(Clone, Copy, Debug)]
pub struct Recipe {
    /// The value of `--scene`.
    pub name: &'static str,
    source: Source,
    eye: [f64; 3],
    target: [f64; 3],
    light: [f64; 3],
}

#[derive(Clone, Copy, Debug)]
enum Source {
    /// Below the folder of scenes.
    File(&'static str),
    /// A sphere of 10,000 triangles.
    Sphere,
    /// A thousand bunnies, turned at random, in a cube. The number: the boxes of all together, in volumes of the cube.
    Bunnies(f64),
}

const BUNNY: &str = "meshes/stanford-bunny.glb";
const BUNNIES: u32 = 1000;

/// Every scene: single objects that fill some 40 % of the image, interiors that fill all of it, and instances.
pub const SCENES: [Recipe; 9] = [
    Recipe {
        name: "sphere",
        source: Source::Sphere,
        eye: [1.2, 0.9, 2.6],
        target: [0.0, 0.0, 0.0],
        light: [-2.0, 3.0, 2.0],
    },
    Recipe {
        name: "bunny",
        source: Source::File(BUNNY),
        eye: [0.053, 0.165, 0.177],
        target: [-0.017, 0.110, -0.002],
        light: [-0.2, 0.4, 0.3],
    },
    Recipe {
        name: "dragon-res2",
        source: Source::File("meshes/stanford-dragon-res2.glb"),
        eye: [0.062, 0.178, 0.208],
        target: [-0.006, 0.125, -0.005],
        light: [-0.2, 0.4, 0.3],
    },
    Recipe {
        name: "dragon",
        source: Source::File("meshes/stanford-dragon.glb"),
        eye: [0.062, 0.178, 0.208],
        target: [-0.006, 0.125, -0.005],
        light: [-0.2, 0.4, 0.3],
    },
    Recipe {
        name: "sponza",
        source: Source::File("scenes/sponza-dabrovic-flat.glb"),
        eye: [-11.5, 2.2, 0.6],
        target: [6.0, 4.2, -1.0],
        light: [0.0, 11.0, 0.0],
    },
    Recipe {
        name: "kitchen",
        source: Source::File("scenes/bart-kitchen.glb"),
        eye: [0.5, 1.7, 3.6],
        target: [3.4, 0.8, 0.6],
        light: [2.25, 2.0, 1.0],
    },
    bunnies("bunnies-0.3", 0.3),
    bunnies("bunnies-1", 1.0),
    bunnies("bunnies-3", 3.0),
];

const fn bunnies(name: &'static str, overlap: f64) -> Recipe {
    let (eye, target, light) = ([0.66, 0.5, 1.46], [0.0, 0.0, 0.0], [-2.0, 3.0, 2.0]);
    Recipe { name, source: Source::Bunnies(overlap), eye, target, light }
}

/// How many pixels primary rays go through. Both numbers are multiples of the side of a block of rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ImageSize {
    /// The size of the paper's images.
    #[default]
    #[value(name = "800x600")]
    Paper,
    /// The size of most screens.
    #[value(name = "1920x1080")]
    FullHd,
}

impl ImageSize {
    /// Columns and rows.
    pub fn pixels(self) -> [u32; 2] {
        match self {
            Self::Paper => [800, 600],
            Self::FullHd => [1920, 1080],
        }
    }

    /// Parses the value of `--size`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "800x600",
            Self::FullHd => "1920x1080",
        }
    }
}

/// A scene compiled for tracing. Positions are in the world space of its device arrays.
#[derive(Debug)]
pub struct BenchScene {
    /// The value of `--scene`.
    pub name: &'static str,
    /// Holds the device arrays.
    pub compiler: Compiler,
    /// The parts of the kernel that its frames need.
    pub needs: Needs,
    triangle_count: u64,
    /// The view of it.
    pub view: View,
    /// The position of its light.
    pub light: Vec3,
}

impl BenchScene {
    /// Compiles the scene for that view. The light is a point of the world.
    ///
    /// # Errors
    /// As [`Compiler::compile`].
    pub fn compile(name: &'static str, scene: &mut Scene, mut view: View, light: DVec3) -> Result<Self> {
        let mut compiler = Compiler::new();
        let needs = compiler.compile(scene, view.viewpoint())?.needs;
        view.world_from_view.translation -= compiler.origin();
        let light = (light - compiler.origin()).as_vec3();
        Ok(Self { name, compiler, needs, triangle_count: scene.instanced_triangle_count(), view, light })
    }

    /// The device arrays.
    pub fn arrays(&self) -> &DeviceArrays {
        self.compiler.arrays()
    }

    /// The number of triangles, each counted once for each of its instances.
    pub fn triangle_count(&self) -> u64 {
        self.triangle_count
    }

    /// The corners of the triangle that was hit.
    pub fn corners(&self, hit: &HitRecord) -> [Vec3; 3] {
        let arrays = self.arrays();
        placed(&arrays.instances[hit.instance as usize], &arrays.triangles[hit.triangle as usize])
    }

    /// The triangles of all instances in world space, for peers without instances.
    pub fn triangles(&self) -> Vec<[Vec3; 3]> {
        let arrays = self.arrays();
        let mut triangles = Vec::new();
        for instance in leaves(&arrays.tlas_nodes).map(|(first, _)| &arrays.instances[first]) {
            // A structure may hold a triangle in several leaves.
            let mut seen = HashSet::new();
            for (first, count) in leaves(&arrays.blas_nodes[instance.first_node as usize..]) {
                let first = instance.first_triangle as usize + first;
                for triangle in &arrays.triangles[first..first + count] {
                    if seen.insert(triangle.primitive) {
                        triangles.push(placed(instance, triangle));
                    }
                }
            }
        }
        triangles
    }
}

fn placed(instance: &InstanceRecord, triangle: &Triangle) -> [Vec3; 3] {
    let [x, y, z] = instance.world_from_local.map(Vec4::from_array);
    [triangle.v0, triangle.v1, triangle.v2].map(|corner| {
        let corner = Vec3::from_array(corner).extend(1.0);
        Vec3::new(x.dot(corner), y.dot(corner), z.dot(corner))
    })
}

/// The ranges of the leaves of the hierarchy that starts with these nodes.
pub(crate) fn leaves(nodes: &[Node]) -> impl Iterator<Item = (usize, usize)> {
    let mut next = if nodes.is_empty() { NONE } else { 0 };
    std::iter::from_fn(move || {
        while next != NONE {
            let node = &nodes[next as usize];
            if node.primitives.primitive_count() > 0 {
                next = node.escape_index;
                return Some((node.primitives.first_primitive() as usize, node.primitives.primitive_count() as usize));
            }
            // An unused leaf has no children.
            next = if node.is_empty() { node.escape_index } else { next + 1 };
        }
        None
    })
}

impl Recipe {
    /// Loads or makes the scene and compiles it. Every material is opaque and has two sides, so that all peers are
    /// asked the same.
    ///
    /// # Errors
    /// A file is missing or damaged.
    pub fn load(&self, size: ImageSize) -> Result<BenchScene> {
        let opaque = Material { double_sided: true, ..Material::diffuse(Vec3::splat(0.8)) };
        BenchScene::compile(self.name, &mut self.scene(&opaque)?, self.view(size.pixels(), 1.0), self.light())
    }

    /// The scene, all of one material and without a light.
    ///
    /// # Errors
    /// A file is missing or damaged.
    pub fn scene(&self, material: &Material) -> Result<Scene> {
        let mut scene = Scene::new();
        self.fill(&mut scene)?;
        let materials: Vec<_> = scene.materials().map(|(key, _)| key).collect();
        for key in materials {
            scene.set_material(key, material.clone())?;
        }
        Ok(scene)
    }

    /// The view from that many times the usual distance.
    pub fn view(&self, [width, height]: [u32; 2], distance: f64) -> View {
        let [eye, target] = [self.eye, self.target].map(DVec3::from_array);
        View::look_at(target + (eye - target) * distance, target, DVec3::Y, Camera::default(), width, height)
    }

    /// The position of its light.
    pub fn light(&self) -> DVec3 {
        DVec3::from_array(self.light)
    }

    fn fill(&self, scene: &mut Scene) -> Result<()> {
        let root = scene.root();
        match self.source {
            Source::File(file) => import(file, scene),
            Source::Sphere => {
                let core = geometry_core(scene, sphere(51, 100))?;
                scene.add(root, core)?;
                Ok(())
            }
            Source::Bunnies(overlap) => {
                let mut original = Scene::new();
                import(BUNNY, &mut original)?;
                let bunny = original.geometries().next().map(|(_, geometry)| geometry.clone());
                add_copies(scene, bunny.ok_or("the bunny is empty")?, BUNNIES, overlap)
            }
        }
    }
}

/// The folder of scenes: `ROPEWALK_SCENES` or, if that is not set or empty, `shared/scenes` beside the checkout.
pub fn scenes_folder() -> PathBuf {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/scenes");
    let variable = std::env::var_os("ROPEWALK_SCENES").filter(|folder| !folder.is_empty());
    PathBuf::from(variable.unwrap_or_else(|| beside.into()))
}

fn import(file: &str, scene: &mut Scene) -> Result<()> {
    let path = scenes_folder().join(file);
    let root = scene.root();
    let imported = gltf::import(&path, scene, root);
    imported.map_err(|error| format!("{}: {error} (set ROPEWALK_SCENES to the folder of scenes)", path.display()))?;
    Ok(())
}
