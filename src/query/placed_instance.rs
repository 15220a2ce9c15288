//! An instance with its matrices in f64.

use glam::{DAffine3, DMat3, DVec3};

use crate::device::layout::InstanceRecord;

/// An instance with its matrices in f64, relative to the render origin. `world_from_local` is the inverse of the
/// device's f32 `local_from_world`, because that is what the kernel uses.
pub(super) struct PlacedInstance<'a> {
    /// Index into the `instances` array.
    pub(super) instance_index: u32,
    pub(super) instance: &'a InstanceRecord,
    pub(super) local_from_world: DAffine3,
    pub(super) world_from_local: DAffine3,
}

impl<'a> PlacedInstance<'a> {
    pub(super) fn new(instance_index: u32, instance: &'a InstanceRecord) -> Self {
        let [x, y, z] = instance.local_from_world.map(|row| row.map(f64::from));
        let linear = DMat3::from_cols_array_2d(&[x, y, z].map(|[x, y, z, _]| [x, y, z])).transpose();
        let local_from_world = DAffine3::from_mat3_translation(linear, DVec3::new(x[3], y[3], z[3]));
        Self { instance_index, instance, local_from_world, world_from_local: local_from_world.inverse() }
    }
}
