//! Punctual lights: `KHR_lights_punctual`.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};

use ::gltf::json;
use glam::Vec3;
use json::extensions::scene::khr_lights_punctual::Type;
use json::validation::Checked::{Invalid, Valid};

use super::warnings::Warnings;
use super::{Document, GltfFault, WarningKind};
use crate::Result;
use crate::graph::{Light, LightKind};

/// The light with this index in the file; `None` if it is of a type that the extension does not define.
pub(super) fn convert(document: &Document, index: usize, warnings: &mut Warnings) -> Result<Option<Light>> {
    // One that is no light at all has been left out, with a warning.
    let Some(light) = &document.lights[index] else { return Ok(None) };
    let pointer = format!("/extensions/KHR_lights_punctual/lights/{index}");
    // Find the kind of light.
    let kind = match light.type_ {
        Valid(Type::Directional) => LightKind::Directional,
        Valid(Type::Point) => LightKind::Point,
        Valid(Type::Spot) => spot(document, light.spot.as_ref(), &pointer, warnings)?,
        Invalid => {
            warnings.add(document, WarningKind::Feature, "light of unknown type", pointer, "left out");
            return Ok(None);
        }
    };
    // Replace values below 0 by 0; a light with one that is not finite is broken.
    let mut at_least_zero = |what: &'static str, value: f32| {
        if !value.is_finite() {
            return Err(document.error_at(&*pointer, GltfFault::NotFinite { what }));
        }
        if value < 0.0 {
            let fallback = format!("is {value}, below zero: 0 is used");
            let error = document.error_at(&*pointer, GltfFault::OutOfRange { what, value, expected: "0 or more" });
            warnings.forgive(&document.value, what, fallback, error)?;
        }
        Ok(value.max(0.0))
    };
    let [r, g, b] = light.color;
    let color = Vec3::new(at_least_zero("color", r)?, at_least_zero("color", g)?, at_least_zero("color", b)?);
    let intensity = at_least_zero("intensity", light.intensity)?;
    // A range of 0 is taken as none.
    let range = match light.range {
        // A directional light has no position, so its range has no meaning.
        Some(range) if kind != LightKind::Directional => match at_least_zero("range", range)? {
            0.0 => None,
            range => Some(range),
        },
        _ => None,
    };
    // Limit the intensity, so that its product with the colour is finite.
    let brightest = color.max_element();
    let intensity = if (brightest * intensity).is_finite() {
        intensity
    } else {
        // Rounded down, so that the product is not rounded up to infinity.
        let largest = (f32::MAX / brightest).next_down();
        let fallback = format!("is {intensity:e}, and its product with the colour not finite: {largest:e} is used");
        warnings.add(document, WarningKind::Value, "intensity", pointer, fallback);
        largest
    };
    Ok(Some(Light { kind, color, intensity, range }))
}

fn spot(
    document: &Document,
    spot: Option<&json::extensions::scene::khr_lights_punctual::Spot>,
    pointer: &str,
    warnings: &mut Warnings,
) -> Result<LightKind> {
    // A cone without properties has the default of each.
    let default_spot =
        json::extensions::scene::khr_lights_punctual::Spot { inner_cone_angle: 0.0, outer_cone_angle: FRAC_PI_4 };
    if spot.is_none() {
        let fallback = "a spot light has none: its cone is the default one, of 45 degrees around its axis";
        warnings.forgive(&document.value, "spot", fallback, document.error_at(pointer, GltfFault::NoProperties))?;
    }
    let spot = spot.unwrap_or(&default_spot);
    // Check that both angles are finite, and the outer one above 0.
    let (inner, outer) = (spot.inner_cone_angle, spot.outer_cone_angle);
    if !inner.is_finite() {
        return Err(document.error_at(pointer, GltfFault::NotFinite { what: "innerConeAngle" }));
    }
    if !(outer > 0.0 && outer.is_finite()) {
        let (what, expected) = ("outerConeAngle", "finite and above 0");
        return Err(document.error_at(pointer, GltfFault::OutOfRange { what, value: outer, expected }));
    }
    // Limit the outer angle to 90 degrees, and the inner one to the outer.
    let outer_cone_angle = outer.min(FRAC_PI_2);
    let inner_cone_angle = inner.clamp(0.0, outer_cone_angle);
    if (inner_cone_angle, outer_cone_angle) != (inner, outer) {
        let fallback = format!("are {inner} and {outer}: {inner_cone_angle} and {outer_cone_angle} are used");
        let fault = GltfFault::OutOfRange {
            what: if outer > FRAC_PI_2 { "outerConeAngle" } else { "innerConeAngle" },
            value: if outer > FRAC_PI_2 { outer } else { inner },
            expected: "0 to pi/2, the inner one below the outer",
        };
        warnings.forgive(&document.value, "cone angles", fallback, document.error_at(pointer, fault))?;
    }
    Ok(LightKind::Spot { inner_cone_angle, outer_cone_angle })
}
