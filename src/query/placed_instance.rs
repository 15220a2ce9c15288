//! An instance in f64, as it is drawn.

use glam::{DAffine3, DMat3, DVec3};

use crate::device::layout::InstanceRecord;

/// An instance and its matrices; world is relative to the render origin. What is drawn is the geometry under the inverse of
/// the device's `local_from_world`.
pub(super) struct PlacedInstance<'a> {
    /// Index into the `instances` array.
    pub(super) slot: u32,
    pub(super) instance: &'a InstanceRecord,
    pub(super) local_from_world: DAffine3,
    pub(super) world_from_local: DAffine3,
}

impl<'a> PlacedInstance<'a> {
    pub(super) fn new(slot: u32, instance: &'a InstanceRecord) -> Self {
        let [x, y, z] = instance.local_from_world.map(|row| row.map(f64::from));
        let linear = DMat3::from_cols_array_2d(&[x, y, z].map(|[x, y, z, _]| [x, y, z])).transpose();
        let local_from_world = DAffine3::from_mat3_translation(linear, DVec3::new(x[3], y[3], z[3]));
        Self { slot, instance, local_from_world, world_from_local: local_from_world.inverse() }
    }
}
