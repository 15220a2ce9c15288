//! Compiled scenes in canonical order: the same scene gives the same value however its arrays came about.

use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{Instance, Light, Material, NONE, Node, Streams, TextureInfo, Triangle};

/// Everything that a kernel can reach in some arrays, with places replaced by contents. Compares bit by bit.
#[derive(Debug, PartialEq)]
pub(crate) struct Canonical {
    /// What the leaves of the top level hold, sorted; the hierarchy above them is not compared.
    instances: Vec<CanonicalInstance>,
    /// Sorted.
    lights: Vec<Vec<u8>>,
}

#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct CanonicalInstance {
    /// The record without its indices.
    record: Vec<u8>,
    /// The box of its leaf.
    bounds: Vec<u8>,
    blas_nodes: Vec<u8>,
    triangles: Vec<u8>,
    /// Indices and streams of the geometry, one after the other.
    streams: Vec<Vec<u8>>,
    material: Vec<u8>,
    textures: Vec<(Vec<u8>, Vec<u32>)>,
}

impl Canonical {
    /// The canonical form of compiled arrays.
    pub(crate) fn of(arrays: &DeviceArrays) -> Self {
        let leaves = arrays.tlas_nodes.iter().filter(|node| node.primitives.count() > 0);
        let mut instances: Vec<CanonicalInstance> = leaves
            .filter_map(|leaf| {
                let record = arrays.instances.get(leaf.primitives.first() as usize)?;
                Some(canonical_instance(arrays, record, leaf))
            })
            .collect();
        instances.sort();
        let lights: &[Light] = &arrays.lights;
        let mut lights: Vec<Vec<u8>> = lights.iter().map(|light| bytes(&[*light])).collect();
        lights.sort();
        Self { instances, lights }
    }

    /// The first part that differs, by name; `None` if nothing does.
    pub(crate) fn difference(&self, other: &Self) -> Option<String> {
        if self.lights != other.lights {
            return Some("lights".to_owned());
        }
        if self.instances.len() != other.instances.len() {
            return Some(format!("{} or {} instances", self.instances.len(), other.instances.len()));
        }
        let (i, (a, b)) = self.instances.iter().zip(&other.instances).enumerate().find(|(_, (a, b))| a != b)?;
        let part = match () {
            () if a.record != b.record => "record",
            () if a.bounds != b.bounds => "box",
            () if a.blas_nodes != b.blas_nodes => "blas_nodes",
            () if a.triangles != b.triangles => "triangles",
            () if a.streams != b.streams => "streams",
            () if a.material != b.material => "material",
            () => "textures",
        };
        Some(format!("instance {i}: {part}"))
    }

    /// How many instances can be reached.
    pub(crate) fn instance_count(&self) -> usize {
        self.instances.len()
    }
}

fn canonical_instance(arrays: &DeviceArrays, instance: &Instance, leaf: &Node) -> CanonicalInstance {
    let nodes = reachable(&arrays.blas_nodes[instance.first_node as usize..]);
    let triangle_count =
        nodes.iter().map(|n| (n.primitives.first() + n.primitives.count()) as usize).max().unwrap_or(0);
    let triangles = &arrays.triangles[instance.first_triangle as usize..][..triangle_count];
    let material = arrays.materials[instance.material as usize];
    let texture_indices = [
        material.base_color_texture,
        material.metallic_roughness_texture,
        material.emissive_texture,
        material.transmission_texture,
        material.normal_texture,
    ];
    let record = Instance { first_node: 0, first_triangle: 0, geometry: 0, material: 0, ..*instance };
    let material = Material {
        base_color_texture: 0,
        metallic_roughness_texture: 0,
        emissive_texture: 0,
        transmission_texture: 0,
        normal_texture: 0,
        ..material
    };
    CanonicalInstance {
        record: bytes(&[record]),
        bounds: bytes(&[leaf.min, leaf.max]),
        blas_nodes: bytes(nodes),
        triangles: bytes(triangles),
        streams: canonical_streams(arrays, &arrays.geometries[instance.geometry as usize], triangles),
        material: bytes(&[material]),
        textures: texture_indices.iter().map(|&i| canonical_texture(arrays, i)).collect(),
    }
}

/// The nodes of the hierarchy that starts at `nodes[0]`: up to the last one whose escape index is the end.
fn reachable(nodes: &[Node]) -> &[Node] {
    let mut i = 0;
    loop {
        let node = &nodes[i];
        match (node.primitives.count(), node.escape_index) {
            (0, _) => i += 1,
            (_, NONE) => return &nodes[..=i],
            (_, escape) => i = escape as usize,
        }
    }
}

fn canonical_streams(arrays: &DeviceArrays, streams: &Streams, triangles: &[Triangle]) -> Vec<Vec<u8>> {
    if streams.first_index == NONE {
        return Vec::new();
    }
    let vertex = |triangle: &Triangle, corner: u32| {
        arrays.indices[(streams.first_index + 3 * triangle.primitive + corner) as usize]
    };
    let vertices: Vec<u32> =
        triangles.iter().flat_map(|t| (0..3).map(move |c| (t, c))).map(|(t, c)| vertex(t, c)).collect();
    let gather = |first: u32, stride: u32, array: &[u32]| -> Vec<u8> {
        if first == NONE {
            return Vec::new();
        }
        let words = vertices.iter().flat_map(|v| (0..stride).map(move |k| first + v * stride + k));
        bytes(&words.map(|w| array[w as usize]).collect::<Vec<u32>>())
    };
    let normals: &[f32] = &arrays.normals;
    let pair = |first: u32| if first == NONE { NONE } else { first * 2 };
    let (tex_coords, colors): (&[[f32; 2]], &[[u32; 2]]) = (&arrays.tex_coords, &arrays.colors);
    vec![
        bytes(&vertices),
        gather(streams.first_normal, 3, bytemuck::cast_slice(normals)),
        gather(pair(streams.first_tex_coord_0), 2, bytemuck::cast_slice(tex_coords)),
        gather(pair(streams.first_tex_coord_1), 2, bytemuck::cast_slice(tex_coords)),
        gather(pair(streams.first_color), 2, bytemuck::cast_slice(colors)),
    ]
}

fn canonical_texture(arrays: &DeviceArrays, index: u32) -> (Vec<u8>, Vec<u32>) {
    if index == NONE {
        return (Vec::new(), Vec::new());
    }
    let info = arrays.texture_infos[index as usize];
    let texels = &arrays.texels[info.first_texel as usize..][..(info.width * info.height) as usize];
    (bytes(&[TextureInfo { first_texel: 0, ..info }]), texels.to_vec())
}

fn bytes<T: bytemuck::Pod>(values: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(values).to_vec()
}
