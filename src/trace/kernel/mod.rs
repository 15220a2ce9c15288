//! The kernel in Rust, function for function as in `shaders/shared`: what the CPU executors run.

mod brdf;
mod camera;
mod intersect;
mod light;
mod material;
pub(crate) mod math;
mod offset;
mod sky;
mod surface;
mod texture;
mod traverse;
mod whitted;

pub(crate) use traverse::{any_hit, closest_hit, transmittance};
#[cfg(feature = "gpu")]
pub(crate) use whitted::most_rays;
pub(crate) use whitted::{Pixel, render_pixel};

use crate::device::DeviceArrays;
use crate::device::layout::{Instance, Light, Material, Node, Streams, TextureInfo, Triangle};

/// The device arrays as the kernel reads them: the bindings of `types.wgsl`.
#[derive(Clone, Copy)]
pub(crate) struct KernelScene<'a> {
    pub tlas_nodes: &'a [Node],
    pub instances: &'a [Instance],
    pub blas_nodes: &'a [Node],
    pub triangles: &'a [Triangle],
    pub geometries: &'a [Streams],
    pub indices: &'a [u32],
    pub normals: &'a [f32],
    pub tex_coords: &'a [[f32; 2]],
    pub colors: &'a [[u32; 2]],
    pub materials: &'a [Material],
    pub texture_infos: &'a [TextureInfo],
    pub texels: &'a [u32],
    pub lights: &'a [Light],
}

impl<'a> KernelScene<'a> {
    pub(crate) fn new(arrays: &'a DeviceArrays) -> Self {
        Self {
            tlas_nodes: &arrays.tlas_nodes,
            instances: &arrays.instances,
            blas_nodes: &arrays.blas_nodes,
            triangles: &arrays.triangles,
            geometries: &arrays.geometries,
            indices: &arrays.indices,
            normals: &arrays.normals,
            tex_coords: &arrays.tex_coords,
            colors: &arrays.colors,
            materials: &arrays.materials,
            texture_infos: &arrays.texture_infos,
            texels: &arrays.texels,
            lights: &arrays.lights,
        }
    }
}
