//! Rays as Embree takes them and answers in them: `rtcore_ray.h`, and what Ropewalk calls the same.

use std::ffi::{c_int, c_uint};

use ropewalk::device::layout;

use crate::rays::any_answer;

const INVALID_GEOMETRY_ID: c_uint = c_uint::MAX;

/// `RTCRay`.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    origin: [f32; 3],
    t_near: f32,
    direction: [f32; 3],
    time: f32,
    t_far: f32,
    mask: c_uint,
    id: c_uint,
    flags: c_uint,
}

/// `RTCRayHit`: an `RTCRay` and an `RTCHit`.
#[repr(C, align(16))]
#[derive(Clone, Copy, Debug)]
pub(super) struct RayHit {
    ray: Ray,
    normal: [f32; 3],
    uv: [f32; 2],
    primitive: c_uint,
    geometry: c_uint,
    instance: c_uint,
    instance_primitive: c_uint,
    _pad: [c_uint; 3],
}

/// `RTCRay16`.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray16 {
    origin: [[f32; 16]; 3],
    t_near: [f32; 16],
    direction: [[f32; 16]; 3],
    time: [f32; 16],
    t_far: [f32; 16],
    mask: [c_uint; 16],
    id: [c_uint; 16],
    flags: [c_uint; 16],
}

/// `RTCRayHit16`: an `RTCRay16` and an `RTCHit16`.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug)]
pub(super) struct RayHit16 {
    ray: Ray16,
    normal: [[f32; 16]; 3],
    uv: [[f32; 16]; 2],
    primitive: [c_uint; 16],
    geometry: [c_uint; 16],
    instance: [c_uint; 16],
    instance_primitive: [c_uint; 16],
}

/// Which lanes of 16 have a ray: -1 where there is one.
#[repr(C, align(64))]
#[derive(Clone, Copy, Debug)]
pub(super) struct Valid([c_int; 16]);

impl Valid {
    /// The mask of the first `count` lanes.
    pub(super) fn new(count: usize) -> Self {
        Self(std::array::from_fn(|lane| if lane < count { -1 } else { 0 }))
    }

    pub(super) fn as_ptr(&self) -> *const c_int {
        self.0.as_ptr()
    }

    /// The lanes that have a ray.
    pub(super) fn of(&self, lanes: [f32; 16]) -> impl Iterator<Item = f32> {
        lanes.into_iter().zip(self.0).filter(|&(_, valid)| valid != 0).map(|(lane, _)| lane)
    }
}

impl Ray {
    pub(super) fn answer(&self) -> f32 {
        any(self.t_far)
    }
}

impl Ray16 {
    pub(super) fn answers(&self) -> [f32; 16] {
        self.t_far.map(any)
    }
}

impl RayHit {
    pub(super) fn answer(&self) -> f32 {
        closest(self.ray.t_far, self.geometry)
    }

    /// The triangle and t.
    pub(super) fn hit(&self) -> Option<(u32, f32)> {
        (self.geometry != INVALID_GEOMETRY_ID).then_some((self.primitive, self.ray.t_far))
    }
}

impl RayHit16 {
    pub(super) fn answers(&self) -> [f32; 16] {
        std::array::from_fn(|lane| closest(self.ray.t_far[lane], self.geometry[lane]))
    }
}

fn closest(t_far: f32, geometry: c_uint) -> f32 {
    if geometry == INVALID_GEOMETRY_ID { f32::INFINITY } else { t_far }
}

/// Embree sets `t_far` to minus infinity where a ray met something.
fn any(t_far: f32) -> f32 {
    any_answer(t_far < 0.0)
}

impl From<&layout::RayRecord> for Ray {
    fn from(ray: &layout::RayRecord) -> Self {
        Self {
            origin: ray.origin,
            t_near: ray.t_min,
            direction: ray.direction,
            time: 0.0,
            t_far: ray.t_max,
            mask: c_uint::MAX,
            id: 0,
            flags: 0,
        }
    }
}

impl From<Ray> for RayHit {
    fn from(ray: Ray) -> Self {
        Self {
            ray,
            normal: [0.0; 3],
            uv: [0.0; 2],
            primitive: INVALID_GEOMETRY_ID,
            geometry: INVALID_GEOMETRY_ID,
            instance: INVALID_GEOMETRY_ID,
            instance_primitive: INVALID_GEOMETRY_ID,
            _pad: [0; 3],
        }
    }
}

impl From<&[layout::RayRecord]> for Ray16 {
    /// At most 16, at least one: lanes beyond repeat the first.
    fn from(rays: &[layout::RayRecord]) -> Self {
        let lanes: [&layout::RayRecord; 16] = std::array::from_fn(|lane| rays.get(lane).unwrap_or(&rays[0]));
        Self {
            origin: std::array::from_fn(|axis| lanes.map(|ray| ray.origin[axis])),
            t_near: lanes.map(|ray| ray.t_min),
            direction: std::array::from_fn(|axis| lanes.map(|ray| ray.direction[axis])),
            time: [0.0; 16],
            t_far: lanes.map(|ray| ray.t_max),
            mask: [c_uint::MAX; 16],
            id: [0; 16],
            flags: [0; 16],
        }
    }
}

impl From<Ray16> for RayHit16 {
    fn from(ray: Ray16) -> Self {
        Self {
            ray,
            normal: [[0.0; 16]; 3],
            uv: [[0.0; 16]; 2],
            primitive: [INVALID_GEOMETRY_ID; 16],
            geometry: [INVALID_GEOMETRY_ID; 16],
            instance: [INVALID_GEOMETRY_ID; 16],
            instance_primitive: [INVALID_GEOMETRY_ID; 16],
        }
    }
}

const _: () = {
    assert!(size_of::<Ray>() == 48 && size_of::<RayHit>() == 96);
    assert!(size_of::<Ray16>() == 12 * 64 && size_of::<RayHit16>() == 21 * 64);
};
