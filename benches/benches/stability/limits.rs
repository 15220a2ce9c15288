//! Limits, each met on purpose: the input, and the typed error that refuses it.

use std::fmt;
use std::sync::Arc;

use glam::{DVec3, Vec3};
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{NONE, RayRecord};
use ropewalk::trace::{Cpu, Tracer as _};
use ropewalk::{
    Camera, Core, DeviceChoice, Error, Geometry, Light, Material, NodeKey, Ray, Renderer, RendererOptions, Scene,
    Transform, View,
};
use ropewalk_bench::Result;

/// A limit.
pub struct Limit {
    input: &'static str,
    /// The error's variant and text; or where a limit is checked that is not met here.
    answer: String,
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "LIMIT {}: {}", self.input, self.answer)
    }
}

impl Limit {
    /// A line of the table in docs/STABILITY.md.
    pub fn line(&self) -> String {
        format!("| {} | {} |\n", self.input, self.answer)
    }
}

/// An input that must be refused.
type Trial = fn(&mut Scene) -> ropewalk::Result<()>;

const TRIALS: [(&str, Trial); 21] = [
    ("a position that is NaN", |scene| add(scene, Geometry::new([Vec3::NAN, Vec3::X, Vec3::Y], [[0, 1, 2]]))),
    ("a position that is infinite", |scene| add(scene, Geometry::new([Vec3::INFINITY, Vec3::X, Vec3::Y], [[0, 1, 2]]))),
    ("an index beyond the positions", |scene| add(scene, Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 3]]))),
    ("normals of another number than positions", |scene| {
        add(scene, Geometry { normals: Some(Arc::from([Vec3::Z])), ..triangle() })
    }),
    ("new positions of another number", |scene| {
        let geometry = scene.add_geometry(triangle())?;
        scene.set_positions(geometry, [Vec3::ZERO], None)
    }),
    ("new positions that are NaN", |scene| {
        let geometry = scene.add_geometry(triangle())?;
        scene.set_positions(geometry, [Vec3::NAN; 3], None)
    }),
    ("a transform with an infinite scale", |scene| {
        scene.add(scene.root(), Transform::from_scale(DVec3::INFINITY)).map(drop)
    }),
    ("a material of roughness 2", |scene| {
        scene.add_material(Material { roughness: 2.0, ..Material::default() }).map(drop)
    }),
    ("a light of infinite intensity", |scene| {
        scene.add(scene.root(), Light::directional(Vec3::ONE, f32::INFINITY)).map(drop)
    }),
    ("a node that would be its own ancestor", |scene| {
        let node = scene.add(scene.root(), Transform::default())?;
        let below = scene.add(node, Core::Instance(node));
        below.map(drop)
    }),
    ("an edit of a node that was removed", |scene| {
        let node = scene.add(scene.root(), Transform::default())?;
        scene.remove(node)?;
        scene.set_visible(node, false)
    }),
    ("the removal of the root", |scene| scene.remove(scene.root())),
    ("instances of instances, 2^40 nodes", |scene| {
        let mut shown = scene.add(scene.root(), Transform::default())?;
        for _ in 0..40 {
            shown = twice(scene, shown)?;
        }
        scene.hierarchy().map(drop)
    }),
    ("a ray whose direction is 0", |scene| {
        renderer()?.queries(scene)?.closest_hit(&Ray::new(DVec3::ZERO, DVec3::ZERO)).map(drop)
    }),
    ("a ray whose origin is NaN", |scene| {
        renderer()?.queries(scene)?.closest_hit(&Ray::new(DVec3::NAN, DVec3::X)).map(drop)
    }),
    ("a ray whose range is NaN", |scene| {
        let ray = Ray { t_max: f64::NAN, ..Ray::new(DVec3::ZERO, DVec3::X) };
        renderer()?.queries(scene)?.closest_hit(&ray).map(drop)
    }),
    ("a ray of an executor whose direction is below 2^-100", |_| {
        let ray = RayRecord { origin: [0.0; 3], t_min: 0.0, direction: [1e-36, 0.0, 0.0], t_max: 1.0 };
        Cpu::default().closest_hits(&DeviceArrays::default(), &[ray], NONE).map(drop)
    }),
    ("a view that ends paths at a negative throughput", |scene| {
        let view = View { min_throughput: -0.1, ..view(8, 8) };
        renderer()?.render(scene, &view).map(drop)
    }),
    ("a field of view of 180 degrees", |scene| {
        let mut view = view(8, 8);
        view.camera = Camera::perspective(std::f32::consts::PI);
        renderer()?.render(scene, &view).map(drop)
    }),
    ("a camera at infinity", |scene| {
        let mut view = view(8, 8);
        view.world_from_view.translation = DVec3::INFINITY;
        renderer()?.render(scene, &view).map(drop)
    }),
    ("an image of 2^32 pixels", |scene| renderer()?.render(scene, &view(1 << 16, 1 << 16)).map(drop)),
];

/// Limits that take gigabytes, a GPU or a damaged file to meet.
const NOT_MET: [(&str, &str); 9] = [
    ("more than 2^28 triangles in a geometry", "`Error::InvalidGeometry`, by `Geometry::validate`"),
    ("more than 2^32 elements in a device array", "`Error::Limit`, `Resource::DeviceArray`"),
    ("more than 2^28 instances", "`Error::Limit`, `Resource::Instances`"),
    ("a delta with keys far beyond its objects", "`Error::Limit`, `Resource::KeySlots`"),
    ("a glTF file that asks for more memory than allowed", "`Error::Gltf`, `GltfFault::Budget`"),
    ("an image wider or higher than a GPU's textures", "`Error::Limit`, `Resource::ImageWidth`, `ImageHeight`"),
    ("an array larger than a GPU's bindings", "`Error::Limit`, `Resource::GpuArray`"),
    (
        "a batch larger than a GPU's buffers",
        "`Error::Limit`, `Resource::RayBinding`, `ResultBinding`, `RayBuffer`, `ResultBuffer`",
    ),
    (
        "an adapter with fewer bindings or smaller workgroups than the kernel has",
        "`Error::Limit`, `Resource::StorageBuffers` and those after it",
    ),
];

/// Meets all limits that can be met cheaply.
///
/// # Errors
/// One of the inputs was accepted.
pub fn all() -> Result<Vec<Limit>> {
    let met = TRIALS.iter().map(|(input, trial)| match trial(&mut Scene::new()) {
        Ok(()) => Err(format!("{input}: accepted").into()),
        Err(error) => Ok(Limit { input, answer: format!("`{}`: {error}", variant(&error)) }),
    });
    let not_met = NOT_MET.iter().map(|(input, answer)| Ok(Limit { input, answer: format!("{answer} (not met here)") }));
    met.chain(not_met).collect()
}

/// The name of an error's variant.
fn variant(error: &Error) -> String {
    let debug = format!("{error:?}");
    let end = debug.find(|c: char| !c.is_alphanumeric()).unwrap_or(debug.len());
    format!("Error::{}", &debug[..end])
}

fn triangle() -> Geometry {
    Geometry::new([Vec3::ZERO, Vec3::X, Vec3::Y], [[0, 1, 2]])
}

fn add(scene: &mut Scene, geometry: Geometry) -> ropewalk::Result<()> {
    scene.add_geometry(geometry).map(drop)
}

/// A node that shows another twice.
fn twice(scene: &mut Scene, shown: NodeKey) -> ropewalk::Result<NodeKey> {
    let node = scene.add(scene.root(), Transform::default())?;
    for _ in 0..2 {
        scene.add(node, Core::Instance(shown))?;
    }
    Ok(node)
}

fn renderer() -> ropewalk::Result<Renderer> {
    Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))
}

fn view(width: u32, height: u32) -> View {
    View::look_at(DVec3::Z, DVec3::ZERO, DVec3::Y, Camera::default(), width, height)
}
