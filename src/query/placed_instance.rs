//! An instance with its matrices in f64.

use glam::DAffine3;

use crate::device::layout::InstanceRecord;

/// An instance with its matrices in f64, relative to the render origin: as the scene has them, not rounded to f32 as
/// those of the device are. The boxes of the TLAS hold both.
pub(super) struct PlacedInstance<'a> {
    /// Index into the `instances` array.
    pub(super) instance_index: u32,
    pub(super) instance: &'a InstanceRecord,
    pub(super) local_from_world: DAffine3,
    pub(super) world_from_local: DAffine3,
}

impl<'a> PlacedInstance<'a> {
    pub(super) fn new(instance_index: u32, instance: &'a InstanceRecord, world_from_local: DAffine3) -> Self {
        Self { instance_index, instance, local_from_world: world_from_local.inverse(), world_from_local }
    }
}
