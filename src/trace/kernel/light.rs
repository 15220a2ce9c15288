//! Direct light from point, spot and directional lights, as `KHR_lights_punctual` defines them. Twin of
//! `shaders/shared/light.wgsl`: there `direct_light` loops over lights; here [`sample_light`] is one iteration, so that
//! callers can batch shadow rays.

use glam::Vec3;

use super::brdf::evaluate_brdf;
use super::intersect::max_component;
use super::math::{dot3, length3, max, min};
use super::offset::offset_ray_origin;
use super::surface::{MIN_COSINE, Surface};
use crate::device::layout::{LIGHT_DIRECTIONAL, LIGHT_SPOT, LightRecord, RayRecord};

/// Incident light at a point.
struct IncidentLight {
    /// Unit vector toward the light.
    direction: Vec3,
    /// Irradiance at normal incidence (lux, linear RGB).
    irradiance: Vec3,
}

/// One light's unshadowed contribution and its shadow ray.
pub(crate) struct LightSample {
    /// The shadow ray, from the surface to the light.
    pub ray: RayRecord,
    /// Unshadowed radiance toward the viewer.
    reflected: Vec3,
    terminator: f32,
}

impl LightSample {
    /// Radiance toward the viewer, given the shadow ray's transmittance.
    pub(crate) fn radiance(&self, transmittance: Vec3) -> Vec3 {
        self.reflected * (transmittance * self.terminator)
    }
}

/// The sample of a light at a surface, or `None` if it contributes nothing toward the viewer.
pub(super) fn sample_light(light: &LightRecord, surface: &Surface, to_viewer: Vec3) -> Option<LightSample> {
    let incident = incident_light(light, surface.position);
    // Skip lights below the horizon or out of range.
    let geometric_cosine = dot3(surface.geometric_normal, incident.direction);
    if geometric_cosine < MIN_COSINE || max_component(incident.irradiance) <= 0.0 {
        return None;
    }
    // BRDF.
    let reflected = evaluate_brdf(surface, to_viewer, incident.direction) * incident.irradiance;
    if max_component(reflected) <= 0.0 {
        return None;
    }
    // Shadow ray.
    let ray = shadow_ray(light, offset_ray_origin(surface, incident.direction));
    Some(LightSample { ray, reflected, terminator: shadow_terminator(surface, incident.direction, geometric_cosine) })
}

fn incident_light(light: &LightRecord, point: Vec3) -> IncidentLight {
    let [position, axis, color] = [light.position, light.direction, light.color].map(Vec3::from_array);
    // Directional: the same everywhere.
    if light.kind == LIGHT_DIRECTIONAL {
        return IncidentLight { direction: -axis, irradiance: color };
    }
    // Point or spot: find direction and distance. A light at the point itself gives nothing.
    let to_light = position - point;
    let distance = length3(to_light);
    if distance <= 0.0 {
        return IncidentLight { direction: to_light, irradiance: Vec3::ZERO };
    }
    // Inverse square of the distance, cut off at the range.
    let direction = to_light * (1.0 / distance);
    let mut attenuation = range_attenuation(distance, light.range) / (distance * distance);
    // Spot cone.
    if light.kind == LIGHT_SPOT {
        let cone = (-dot3(axis, direction) * light.cone_scale + light.cone_offset).clamp(0.0, 1.0);
        attenuation *= cone * cone;
    }
    IncidentLight { direction, irradiance: color * attenuation }
}

/// Shadow ray; `t_max` is 1 at a point or spot light.
fn shadow_ray(light: &LightRecord, start: Vec3) -> RayRecord {
    // Toward a position the direction is not normalised, so that the light is at t = 1.
    let (direction, t_max) = if light.kind == LIGHT_DIRECTIONAL {
        (-Vec3::from_array(light.direction), f32::MAX)
    } else {
        (Vec3::from_array(light.position) - start, 1.0)
    };
    RayRecord { origin: start.to_array(), t_min: 0.0, direction: direction.to_array(), t_max }
}

/// Window that falls smoothly to 0 at the light's range (`KHR_lights_punctual`).
fn range_attenuation(distance: f32, range: f32) -> f32 {
    let ratio = distance / range;
    let square = ratio * ratio;
    (1.0 - square * square).clamp(0.0, 1.0)
}

/// Shadow terminator correction: fades the light where the geometric normal is nearer to grazing than the shading
/// normal; 1 where both agree. (M. J.-Y. Chiang, Y. K. Li, B. Burley, "Taming the Shadow Terminator", SIGGRAPH 2019
/// talks.)
fn shadow_terminator(surface: &Surface, direction: Vec3, geometric_cosine: f32) -> f32 {
    let shading_cosine = dot3(surface.normal, direction) * dot3(surface.normal, surface.geometric_normal);
    // Ratio of the geometric to the shading cosine, then a smooth curve from 0 at 0 to 1 at 1.
    let g = min(geometric_cosine / max(shading_cosine, MIN_COSINE * MIN_COSINE), 1.0);
    ((1.0 - g) * g + 1.0) * g
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable as _;

    use super::*;
    use crate::device::layout::LIGHT_POINT;

    #[test]
    fn a_point_falls_off_by_the_inverse_square_up_to_its_range() {
        for range in [f32::MAX, 10.0, 2.0] {
            let light = LightRecord {
                kind: LIGHT_POINT,
                position: [1.0, 2.0, 3.0],
                color: [5.0; 3],
                range,
                ..LightRecord::zeroed()
            };
            for distance in [0.1f32, 0.5, 1.0, 1.9, 2.0, 3.0, 9.0, 11.0, 1e6] {
                let direction = Vec3::new(2.0, -1.0, 2.0) / 3.0;
                let incident = incident_light(&light, Vec3::new(1.0, 2.0, 3.0) - direction * distance);
                // Expect the inverse square law, computed in f64, times the window at the range.
                let window = (1.0 - (f64::from(distance) / f64::from(range)).powi(4)).clamp(0.0, 1.0);
                let expected = 5.0 / f64::from(distance).powi(2) * window;
                let found = f64::from(incident.irradiance.x);
                let tolerance = 1e-5 * expected + 2e-6 * 5.0 / f64::from(distance).powi(2);
                assert!(
                    (found - expected).abs() <= tolerance,
                    "range {range}, {distance}: {found}, expected {expected}"
                );
                assert!((incident.direction - direction).length() < 1e-5);
            }
        }
    }

    #[test]
    fn a_spot_fades_between_its_cones() {
        let (inner, outer) = (0.3f32, 0.6f32);
        // A linear ramp in the cosine: 0 at the outer cone, 1 at the inner one.
        let cone_scale = 1.0 / (inner.cos() - outer.cos());
        let cone_offset = -outer.cos() * cone_scale;
        let light = LightRecord {
            kind: LIGHT_SPOT,
            direction: [0.0, 0.0, -1.0],
            color: [1.0; 3],
            range: f32::MAX,
            cone_scale,
            cone_offset,
            ..LightRecord::zeroed()
        };
        for step in 0..=100 {
            let angle = step as f32 * 0.01;
            let incident = incident_light(&light, Vec3::new(angle.sin(), 0.0, -angle.cos()) * 2.0);
            // Expect the square of the ramp, over the square of the distance 2.
            let t = ((angle.cos() - outer.cos()) / (inner.cos() - outer.cos())).clamp(0.0, 1.0);
            let expected = t * t / 4.0;
            assert!((incident.irradiance.x - expected).abs() < 1e-5, "{angle}: {} {expected}", incident.irradiance.x);
        }
    }

    #[test]
    fn a_direction_is_the_same_everywhere() {
        let light = LightRecord {
            kind: LIGHT_DIRECTIONAL,
            direction: [0.0, 0.0, -1.0],
            color: [2.0; 3],
            ..LightRecord::zeroed()
        };
        for position in [Vec3::ZERO, Vec3::splat(1e6)] {
            let incident = incident_light(&light, position);
            assert_eq!((incident.direction, incident.irradiance), (Vec3::Z, Vec3::splat(2.0)));
        }
    }

    #[test]
    fn a_light_in_the_surface_does_not_shine() {
        let light = LightRecord { kind: LIGHT_POINT, color: [5.0; 3], range: f32::MAX, ..LightRecord::zeroed() };
        assert_eq!(incident_light(&light, Vec3::ZERO).irradiance, Vec3::ZERO);
    }
}
