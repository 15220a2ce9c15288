//! Device arrays made without the library's builders: instances of a few triangles each, in one leaf.

use bytemuck::Zeroable;
use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::{
    FrameParams, GeometryRecord, InstanceRecord, MaterialRecord, NONE, Node, PrimitiveRange, RayRecord, Triangle,
};
use ropewalk_testkit::{Random, gray};

/// Triangles of an instance, all in one leaf.
pub(crate) const TRIANGLES_A_LEAF: usize = 4;

/// Half the side of the cube that an instance's triangles lie in, in the world.
const SCALE: f32 = 0.2;

/// Half the side of a leaf's box in local space, in which the triangles lie between -1 and 1.
const PADDED: f32 = 1.01;

/// The material of all instances.
fn glowing_gray() -> MaterialRecord {
    let mut material = gray();
    material.emissive = [0.1, 0.0, 0.0];
    material
}

/// The arrays of `instances` instances, each at a random place and with four random triangles of its own.
pub(crate) fn soup(instances: usize, random: &mut Random) -> DeviceArrays {
    let mut arrays = DeviceArrays::default();
    for i in 0..instances {
        set_instance(&mut arrays, i, random);
    }
    link(&mut arrays);
    arrays
}

/// Gives instance `i` new triangles and a new place.
pub(crate) fn set_instance(arrays: &mut DeviceArrays, i: usize, random: &mut Random) {
    let (center, scale) = (random.in_cube().to_array(), SCALE);
    let local_from_world = [0, 1, 2].map(|row| {
        let mut values = [0.0, 0.0, 0.0, -center[row] / scale];
        values[row] = 1.0 / scale;
        values
    });
    let world_from_local = [0, 1, 2].map(|row| {
        let mut values = [0.0, 0.0, 0.0, center[row]];
        values[row] = scale;
        values
    });
    let instance = InstanceRecord {
        local_from_world,
        world_from_local,
        first_node: i as u32,
        first_triangle: (i * TRIANGLES_A_LEAF) as u32,
        geometry: 0,
        material: 0,
        mask: 1 + (i as u32 % 2),
        flags: 0,
        node_key: [i as u32, 1],
    };
    let triangles: Vec<Triangle> =
        (0..TRIANGLES_A_LEAF as u32).map(|primitive| random_triangle(primitive, random)).collect();
    let leaf = Node {
        min: [-PADDED; 3],
        escape_index: NONE,
        max: [PADDED; 3],
        primitives: PrimitiveRange::leaf(0, TRIANGLES_A_LEAF as u32),
    };
    arrays.instances.write(i, &[instance]);
    arrays.triangles.write(i * TRIANGLES_A_LEAF, &triangles);
    arrays.blas_nodes.write(i, &[leaf]);
    arrays.geometries.write(0, &[GeometryRecord::EMPTY]);
    arrays.materials.write(0, &[glowing_gray()]);
}

/// Makes the TLAS: a chain of leaves, one for each instance.
pub(crate) fn link(arrays: &mut DeviceArrays) {
    let count = arrays.instances.len();
    let leaves: Vec<Node> = (0..count)
        .map(|i| {
            let center = arrays.instances[i].world_from_local.map(|row| row[3]);
            Node {
                min: center.map(|x| x - SCALE * PADDED),
                escape_index: if i + 1 == count { NONE } else { i as u32 + 1 },
                max: center.map(|x| x + SCALE * PADDED),
                primitives: PrimitiveRange::leaf(i as u32, 1),
            }
        })
        .collect();
    arrays.tlas_nodes.replace(&leaves);
}

/// Rays from a sphere around the soup to points in it.
pub(crate) fn rays(count: usize, random: &mut Random) -> Vec<RayRecord> {
    let mut ray = || {
        let (from, to) = (random.in_cube().to_array().map(|x| x * 3.0), random.in_cube().to_array());
        let direction = [0, 1, 2].map(|i| to[i] - from[i]);
        RayRecord { origin: from, t_min: 0.0, direction, t_max: f32::MAX }
    };
    (0..count).map(|_| ray()).collect()
}

/// A camera that sees all of the soup, before a blue sky.
pub(crate) fn params(width: u32, height: u32) -> FrameParams {
    let mut params = FrameParams::zeroed();
    params.eye = [0.0, 0.0, 4.0];
    params.width = width;
    params.right = [0.45 * width as f32 / height.max(1) as f32, 0.0, 0.0];
    params.height = height;
    params.up = [0.0, 0.45, 0.0];
    params.max_depth = 3;
    params.max_rays = 1024;
    params.forward = [0.0, 0.0, -1.0];
    params.ray_mask = u32::MAX;
    params.sky_up = [0.0, 1.0, 0.0];
    params.sky_zenith = [0.2, 0.4, 1.0];
    params.sky_horizon = [0.8, 0.9, 1.0];
    params.sky_ground = [0.3, 0.2, 0.1];
    params
}

fn random_triangle(primitive: u32, random: &mut Random) -> Triangle {
    let corners = [random.in_cube().to_array(), random.in_cube().to_array(), random.in_cube().to_array()];
    Triangle::new(corners, primitive)
}
