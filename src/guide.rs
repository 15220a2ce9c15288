//! The guide: how to use Ropewalk, page by page. Every program in it is compiled and run by the tests.
//!
//! | page | what it answers |
//! |---|---|
//! | [`scene_graph`] | how a scene is built, edited, read, undone, saved and mirrored, and what each edit costs; beside OpenSG, three.js and Bevy |
//! | [`queries`] | how to trace rays of your own: a few exactly, millions at once, on the GPU, or from your own shader |
//! | [`choosing`] | which device, acceleration structure, traversal and scene layout to choose, with figures, and when not to use which |
//!
//! The pages are the files of the same names in the folder `docs/` of the repository and of the package. There are also
//! all measurements, with the commands that produce them (`docs/BENCHMARKS.md`), a map of the code
//! (`docs/ARCHITECTURE.md`) and the records of decisions (`docs/decisions/`).

// A link of these pages leads to a file of the repository; the definitions that stand before a page here come first, so
// that they lead to the item or page of this documentation instead.

/// [BENCHMARKS.md]: crate::guide
/// [QUERIES.md]: crate::guide::queries
/// [`Scene`]: crate::Scene
/// [`Delta`]: crate::graph::Delta
/// [`FrameReport::compile`]: crate::FrameReport::compile
/// [`Geometry::blas_kind`]: crate::Geometry::blas_kind
#[doc = ""]
#[doc = include_str!("../docs/SCENE_GRAPH.md")]
pub mod scene_graph {}

/// [`Renderer::queries`]: crate::Renderer::queries
/// [`Renderer::closest_hits`]: crate::Renderer::closest_hits
/// [any]: crate::Renderer::any_hits
#[cfg_attr(feature = "gpu", doc = "[record]: crate::trace::gpu::GpuTracer::record_closest_hits")]
#[cfg_attr(feature = "gpu", doc = "[include]: crate::trace::gpu::GpuTracer::include")]
/// [`CompileReport::needs`]: crate::compile::CompileReport::needs
#[doc = ""]
#[doc = include_str!("../docs/QUERIES.md")]
// Its programs use the GPU executor.
#[cfg(any(feature = "gpu", not(doctest)))]
pub mod queries {}

/// [BENCHMARKS.md]: crate::guide
/// [QUERIES.md]: crate::guide::queries
/// [SCENE_GRAPH.md]: crate::guide::scene_graph
/// [tie band]: crate::trace::Tracer
/// [`Geometry::blas_kind`]: crate::Geometry::blas_kind
#[doc = ""]
#[doc = include_str!("../docs/CHOOSING.md")]
pub mod choosing {}
