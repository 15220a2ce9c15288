//! Punctual lights, as `KHR_lights_punctual` defines them.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// A light at its node's origin, shining along the node's -Z axis where it has a direction. Scale does not affect it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// Its shape.
    pub kind: LightKind,
    /// Linear colour, multiplied with `intensity`.
    pub color: Vec3,
    /// Candela (point, spot) or lux (directional).
    pub intensity: f32,
    /// Beyond this distance it does not shine (point, spot); unlimited if `None`.
    pub range: Option<f32>,
}

impl Light {
    /// Shines equally in all directions, with this intensity in candela.
    pub fn point(color: Vec3, intensity: f32) -> Self {
        Self { kind: LightKind::Point, color, intensity, range: None }
    }

    /// Infinitely far away, with this illuminance in lux.
    pub fn directional(color: Vec3, intensity: f32) -> Self {
        Self { kind: LightKind::Directional, color, intensity, range: None }
    }
}

/// The shape of a light. More are to come: areas, environments.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum LightKind {
    /// Shines equally in all directions.
    Point,
    /// Shines in a cone around -Z.
    Spot {
        /// Half angle, in radians, inside which it shines fully.
        inner_cone_angle: f32,
        /// Half angle, in radians, outside which it does not shine; at most pi / 2.
        outer_cone_angle: f32,
    },
    /// Infinitely far away, shining along -Z.
    Directional,
}
