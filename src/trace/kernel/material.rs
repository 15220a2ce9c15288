//! Stub.

use glam::Vec3;

use super::KernelScene;
use crate::device::layout::{Instance, Triangle};

pub(crate) fn is_hole(_: &KernelScene<'_>, _: &Instance, _: &Triangle, _: f32, _: f32) -> bool {
    false
}

pub(crate) fn passes(_: &KernelScene<'_>, _: &Instance, _: &Triangle, _: f32, _: f32) -> Vec3 {
    Vec3::ZERO
}
