//! Ropewalk: a retained scene graph that is ray traced.
//!
//! Build a [`Scene`] or [import](gltf::import) a glTF file, change it as you like, and draw it with
//! [`Renderer::render`], the one call a frame: on any GPU that wgpu reaches, or on the CPU. Acceleration structures are
//! built, kept and updated behind that call; the frame's [report](FrameReport) says what was done, and why.
//!
//! ```
//! use ropewalk::glam::{DVec3, Vec3};
//! use ropewalk::{Core, DeviceChoice, Geometry, Light, Material, Renderer, RendererOptions, Scene, Transform, View};
//!
//! // A triangle, twice: two nodes share one core.
//! let mut scene = Scene::new();
//! let root = scene.root();
//! let geometry = scene.add_geometry(Geometry::new([Vec3::NEG_X, Vec3::X, Vec3::Y], [[0, 1, 2]]))?;
//! let material = scene.add_material(Material::diffuse(Vec3::new(0.8, 0.3, 0.1)))?;
//! let triangle = scene.add_core(Core::Geometry { geometry, material })?;
//! let left = scene.add(root, Transform::from_translation(DVec3::new(-1.5, 0.0, 0.0)))?;
//! let right = scene.add(root, Transform::from_translation(DVec3::new(1.5, 0.0, 0.0)))?;
//! scene.add(left, triangle)?;
//! scene.add(right, triangle)?;
//! let sun = scene.add(root, Transform::looking_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Y))?;
//! scene.add(sun, Light::directional(Vec3::ONE, 3.0))?;
//!
//! let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu))?;
//! let view = View::framing(&mut scene, 80, 60)?;
//! let first = renderer.render(&mut scene, &view)?.report().clone();
//! assert_eq!((first.compile.blas_built, first.compile.instances), (1, 2));
//!
//! // Moving a node patches the top-level structure; nothing else is built.
//! scene.set_local(left, Transform::from_translation(DVec3::new(-1.5, 0.5, 0.0)))?;
//! let frame = renderer.render(&mut scene, &view)?;
//! assert_eq!(frame.report().compile.blas_built, 0);
//! let image = frame.image()?;
//! assert_eq!(image.color.len(), 80 * 60);
//! # Ok::<(), ropewalk::Error>(())
//! ```
//!
//! Start with [`Scene`], [`gltf::import`], [`View`] and [`Renderer`]; the [`guide`] explains them page by page. The
//! modules [`accel`], [`compile`], [`device`] and [`trace`] are the internals, public for those who bring an executor
//! of their own.

pub mod accel;
mod atomic_file;
mod cancel;
pub mod compile;
pub mod device;
pub mod error;
pub mod gltf;
pub mod graph;
pub mod guide;
pub mod image;
pub mod math;
pub mod prelude;
pub mod query;
pub mod render;
pub mod trace;

pub use cancel::Cancel;
pub use error::{Error, Result};
/// The vectors, quaternions and matrices of this interface.
pub use glam;
pub use graph::{
    Camera, Core, CoreKey, Geometry, GeometryKey, Light, Material, MaterialKey, NodeKey, Scene, Texture, TextureKey,
    Transform,
};
pub use image::Image;
pub use query::{Hit, Ray};
pub use render::{DeviceChoice, Frame, FrameReport, Renderer, RendererOptions, Sky, View};
/// The GPU interface whose devices, queues and textures [`trace::gpu`] takes and gives.
#[cfg(feature = "gpu")]
pub use wgpu;

/// The README's program compiles.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
