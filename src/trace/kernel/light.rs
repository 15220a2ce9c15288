//! Direct light from points, spots and directions, as `KHR_lights_punctual` defines them. Twin of
//! `shaders/shared/light.wgsl`, whose `direct_light` asks for each light what [`sample_light`] says here.

use glam::Vec3;

use super::brdf::evaluate_brdf;
use super::intersect::max_component;
use super::math::{dot3, length3, max, min};
use super::offset::offset_ray_origin;
use super::surface::{MIN_COSINE, Surface};
use crate::device::layout::{LIGHT_DIRECTIONAL, LIGHT_SPOT, LightRecord, RayRecord};

/// Light as it arrives at a point.
struct IncidentLight {
    /// Unit, towards the light.
    direction: Vec3,
    /// Of a surface that faces the light: lux times colour.
    irradiance: Vec3,
}

/// A surface that a light shines on unless something is in between.
pub(crate) struct LightSample {
    /// From the surface to the light.
    pub ray: RayRecord,
    /// What goes to the viewer of light that nothing stops.
    reflected: Vec3,
    terminator: f32,
}

impl LightSample {
    /// What goes to the viewer where so much light gets through along the ray.
    pub(crate) fn radiance(&self, transmittance: Vec3) -> Vec3 {
        self.reflected * (transmittance * self.terminator)
    }
}

/// `None` where nothing of that light goes to the viewer.
pub(super) fn sample_light(light: &LightRecord, surface: &Surface, to_viewer: Vec3) -> Option<LightSample> {
    let arrival = incident_light(light, surface.position);
    let facing = dot3(surface.geometric_normal, arrival.direction);
    if facing < MIN_COSINE || max_component(arrival.irradiance) <= 0.0 {
        return None;
    }
    let reflected = evaluate_brdf(surface, to_viewer, arrival.direction) * arrival.irradiance;
    if max_component(reflected) <= 0.0 {
        return None;
    }
    let ray = shadow_ray(light, offset_ray_origin(surface, arrival.direction));
    Some(LightSample { ray, reflected, terminator: shadow_terminator(surface, arrival.direction, facing) })
}

fn incident_light(light: &LightRecord, point: Vec3) -> IncidentLight {
    let [position, axis, color] = [light.position, light.direction, light.color].map(Vec3::from_array);
    if light.kind == LIGHT_DIRECTIONAL {
        return IncidentLight { direction: -axis, irradiance: color };
    }
    let to_light = position - point;
    let distance = length3(to_light);
    if distance <= 0.0 {
        return IncidentLight { direction: to_light, irradiance: Vec3::ZERO };
    }
    let direction = to_light * (1.0 / distance);
    let mut strength = range_attenuation(distance, light.range) / (distance * distance);
    if light.kind == LIGHT_SPOT {
        let cone = (-dot3(axis, direction) * light.cone_scale + light.cone_offset).clamp(0.0, 1.0);
        strength *= cone * cone;
    }
    IncidentLight { direction, irradiance: color * strength }
}

/// From a point to a light, and no farther.
fn shadow_ray(light: &LightRecord, start: Vec3) -> RayRecord {
    let (direction, t_max) = if light.kind == LIGHT_DIRECTIONAL {
        (-Vec3::from_array(light.direction), f32::MAX)
    } else {
        (Vec3::from_array(light.position) - start, 1.0)
    };
    RayRecord { origin: start.to_array(), t_min: 0.0, direction: direction.to_array(), t_max }
}

/// Falls smoothly to 0 at the light's range.
fn range_attenuation(distance: f32, range: f32) -> f32 {
    let ratio = distance / range;
    let square = ratio * ratio;
    (1.0 - square * square).clamp(0.0, 1.0)
}

/// Softens the edge where a facet of a smooth surface turns from the light before its shading normal does. 1 where both
/// normals agree. (M. J.-Y. Chiang, Y. K. Li, B. Burley, "Taming the Shadow Terminator", SIGGRAPH 2019 talks.)
fn shadow_terminator(surface: &Surface, direction: Vec3, facing: f32) -> f32 {
    let smooth_facing = dot3(surface.normal, direction) * dot3(surface.normal, surface.geometric_normal);
    let g = min(facing / max(smooth_facing, MIN_COSINE * MIN_COSINE), 1.0);
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
                let arrival = incident_light(&light, Vec3::new(1.0, 2.0, 3.0) - direction * distance);
                let window = (1.0 - (f64::from(distance) / f64::from(range)).powi(4)).clamp(0.0, 1.0);
                let expected = 5.0 / f64::from(distance).powi(2) * window;
                let found = f64::from(arrival.irradiance.x);
                let tolerance = 1e-5 * expected + 2e-6 * 5.0 / f64::from(distance).powi(2);
                assert!(
                    (found - expected).abs() <= tolerance,
                    "range {range}, {distance}: {found}, expected {expected}"
                );
                assert!((arrival.direction - direction).length() < 1e-5);
            }
        }
    }

    #[test]
    fn a_spot_fades_between_its_cones() {
        let (inner, outer) = (0.3f32, 0.6f32);
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
            let arrival = incident_light(&light, Vec3::new(angle.sin(), 0.0, -angle.cos()) * 2.0);
            let t = ((angle.cos() - outer.cos()) / (inner.cos() - outer.cos())).clamp(0.0, 1.0);
            let expected = t * t / 4.0;
            assert!((arrival.irradiance.x - expected).abs() < 1e-5, "{angle}: {} {expected}", arrival.irradiance.x);
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
            let arrival = incident_light(&light, position);
            assert_eq!((arrival.direction, arrival.irradiance), (Vec3::Z, Vec3::splat(2.0)));
        }
    }

    #[test]
    fn a_light_in_the_surface_does_not_shine() {
        let light = LightRecord { kind: LIGHT_POINT, color: [5.0; 3], range: f32::MAX, ..LightRecord::zeroed() };
        assert_eq!(incident_light(&light, Vec3::ZERO).irradiance, Vec3::ZERO);
    }
}
