//! One bottom-level structure a geometry, kept while some visible node uses that version of the geometry.

use std::ops::Range;
use std::sync::OnceLock;

use rayon::prelude::*;
use slotmap::SecondaryMap;

use super::arena::Arena;
use super::enclosure::encloses;
use super::instance_table::Users;
use crate::Result;
use crate::accel::{Blas, BuildParams, Support};
use crate::device::DeviceArrays;
use crate::device::layout::{NONE, Streams};
use crate::graph::{Geometry, GeometryKey, Scene};

/// The bottom-level structures and vertex streams on the device, by (geometry key, geometry version).
#[derive(Debug)]
pub(super) struct GeometryCache {
    entries: SecondaryMap<GeometryKey, Entry>,
    /// Of all entries.
    triangle_count: usize,
    nodes: Arena,
    wide_nodes: Arena,
    triangles: Arena,
    streams: Arena,
    indices: Arena,
    normals: Arena,
    tex_coords: Arena,
    colors: Arena,
}

/// Where one geometry lies in the device arrays.
#[derive(Debug)]
pub(super) struct Entry {
    version: u64,
    /// In `blas_nodes`; empty for a geometry that nothing can hit.
    pub(super) nodes: Range<u32>,
    wide_nodes: Range<u32>,
    /// In `triangles`.
    pub(super) triangles: Range<u32>,
    /// In `geometries`.
    pub(super) streams: Range<u32>,
    indices: Range<u32>,
    normals: Range<u32>,
    tex_coords: [Range<u32>; 2],
    colors: Range<u32>,
    /// Triangles of the geometry; more than `triangles` where some cannot be hit.
    pub(super) triangle_count: usize,
    /// How far its triangles reach, local space.
    pub(super) support: Support,
    /// Whether some triangle is in several leaves.
    pub(super) repeats: bool,
    /// The geometry itself: its streams are shared with the scene.
    source: Geometry,
    encloses: OnceLock<bool>,
}

impl Entry {
    /// Whether the geometry encloses a solid. Found out when first asked for: only transmissive materials do.
    pub(super) fn encloses(&self) -> bool {
        *self.encloses.get_or_init(|| encloses(&self.source))
    }
}

/// What is made of a geometry.
struct Built {
    blas: Blas,
    support: Support,
}

/// What [`GeometryCache::update`] did.
#[derive(Clone, Debug, Default)]
pub(super) struct GeometryUpdate {
    pub(super) built: Vec<GeometryKey>,
    pub(super) built_triangles: usize,
    pub(super) freed: usize,
}

impl GeometryCache {
    pub(super) fn new() -> Self {
        Self {
            entries: SecondaryMap::new(),
            triangle_count: 0,
            nodes: Arena::new("the bottom-level nodes array"),
            wide_nodes: Arena::new("the wide nodes array"),
            triangles: Arena::new("the triangles array"),
            streams: Arena::new("the geometries array"),
            indices: Arena::new("the vertex indices array"),
            normals: Arena::new("the normals array"),
            tex_coords: Arena::new("the texture coordinates array"),
            colors: Arena::new("the vertex colours array"),
        }
    }

    /// Makes the cache hold exactly the geometries in `used`: frees the others, then builds what is missing or has
    /// changed, all at once on all cores.
    pub(super) fn update(
        &mut self,
        scene: &Scene,
        used: &Users<GeometryKey>,
        arrays: &mut DeviceArrays,
    ) -> Result<GeometryUpdate> {
        let is_current =
            |key, entry: &Entry| used.has(key) && scene.geometry_version(key).is_ok_and(|v| v == entry.version);
        let stale: Vec<GeometryKey> = self.entries.iter().filter(|&(k, e)| !is_current(k, e)).map(|(k, _)| k).collect();
        for &key in &stale {
            self.free(key, arrays);
        }

        let missing = used.keys().filter(|&key| !self.entries.contains_key(key));
        let missing: Vec<(GeometryKey, u64, &Geometry)> =
            missing.map(|key| Ok((key, scene.geometry_version(key)?, scene.geometry(key)?))).collect::<Result<_>>()?;
        let build = |geometry| {
            let blas = Blas::build(geometry, &BuildParams::default())?;
            Ok(Built { support: Support::new(&blas), blas })
        };
        let built: Vec<Built> = missing.par_iter().map(|(_, _, geometry)| build(geometry)).collect::<Result<_>>()?;

        let mut update = GeometryUpdate { freed: stale.len(), ..GeometryUpdate::default() };
        for ((key, version, geometry), built) in missing.into_iter().zip(built) {
            update.built.push(key);
            update.built_triangles += geometry.indices.len();
            let entry = self.store(version, geometry, built, arrays)?;
            self.triangle_count += entry.triangle_count;
            self.entries.insert(key, entry);
        }
        Ok(update)
    }

    /// The entry of a geometry that was in `used` at the last update.
    pub(super) fn get(&self, key: GeometryKey) -> Option<&Entry> {
        self.entries.get(key)
    }

    /// Triangles of all geometries, each counted once.
    pub(super) fn triangle_count(&self) -> usize {
        self.triangle_count
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    fn store(&mut self, version: u64, geometry: &Geometry, built: Built, arrays: &mut DeviceArrays) -> Result<Entry> {
        let has_streams =
            geometry.normals.is_some() || geometry.colors.is_some() || geometry.tex_coords.iter().any(Option::is_some);
        // Without a stream there is nothing to look up by vertex.
        let indices = if has_streams { bytemuck::cast_slice(&geometry.indices) } else { &[] };
        let indices = self.indices.store(&mut arrays.indices, indices)?;
        let normals = geometry.normals.as_deref().unwrap_or_default();
        let normals = self.normals.store(&mut arrays.normals, bytemuck::cast_slice(normals))?;
        let mut tex_coords = [0..0, 0..0];
        for (range, stream) in tex_coords.iter_mut().zip(&geometry.tex_coords) {
            let stream = stream.as_deref().unwrap_or_default();
            *range = self.tex_coords.store(&mut arrays.tex_coords, bytemuck::cast_slice(stream))?;
        }
        let colors: Vec<[u32; 2]> =
            geometry.colors.as_deref().unwrap_or_default().iter().map(|c| super::pack::color(*c)).collect();
        let colors = self.colors.store(&mut arrays.colors, &colors)?;

        let wide_nodes = self.wide_nodes.store(&mut arrays.wide_nodes, &built.blas.wide_nodes)?;
        let streams = Streams {
            first_index: first_or_none(&indices),
            first_normal: first_or_none(&normals),
            first_tex_coord_0: first_or_none(&tex_coords[0]),
            first_tex_coord_1: first_or_none(&tex_coords[1]),
            first_color: first_or_none(&colors),
            first_wide_node: first_or_none(&wide_nodes),
            _pad: [0; 2],
        };
        Ok(Entry {
            version,
            nodes: self.nodes.store(&mut arrays.blas_nodes, &built.blas.nodes)?,
            wide_nodes,
            triangles: self.triangles.store(&mut arrays.triangles, &built.blas.triangles)?,
            streams: self.streams.store(&mut arrays.geometries, &[streams])?,
            indices,
            normals,
            tex_coords,
            colors,
            triangle_count: geometry.indices.len(),
            support: built.support,
            repeats: built.blas.repeats,
            source: geometry.clone(),
            encloses: OnceLock::new(),
        })
    }

    fn free(&mut self, key: GeometryKey, arrays: &mut DeviceArrays) {
        let Some(entry) = self.entries.remove(key) else { return };
        self.triangle_count -= entry.triangle_count;
        self.nodes.release(&mut arrays.blas_nodes, entry.nodes);
        self.wide_nodes.release(&mut arrays.wide_nodes, entry.wide_nodes);
        self.triangles.release(&mut arrays.triangles, entry.triangles);
        self.streams.release(&mut arrays.geometries, entry.streams);
        self.indices.release(&mut arrays.indices, entry.indices);
        self.normals.release(&mut arrays.normals, entry.normals);
        for range in entry.tex_coords {
            self.tex_coords.release(&mut arrays.tex_coords, range);
        }
        self.colors.release(&mut arrays.colors, entry.colors);
    }
}

fn first_or_none(range: &Range<u32>) -> u32 {
    if range.is_empty() { NONE } else { range.start }
}
