//! Direct light compared with glTF's formulas in f64, and shadows.

use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec3, Vec3, Vec4};
use ropewalk::graph::{AlphaMode, BlasKind, LightKind};
use ropewalk::{Camera, Geometry, Material, Scene, View};

use super::scenes::{at, black, cube, front, middle, put, put_light, render, square};

/// What a dielectric of ior 1.5, roughness 1 and this base colour reflects straight up (+Z) of light from an angle to
/// it, times the cosine: appendix B of glTF 2.0.
fn rough_dielectric(base_color: f64, cosine: f64) -> f64 {
    let half_way = ((1.0 + cosine) * 0.5).sqrt();
    let fresnel = 0.04 + 0.96 * (1.0 - half_way).powi(5);
    // At roughness 1, D is 1 / pi, and V is 0.5 / (n_l + n_v).
    let specular = fresnel / std::f64::consts::PI * 0.5 / (cosine + 1.0);
    ((1.0 - fresnel) * base_color / std::f64::consts::PI + specular) * cosine
}

#[test]
fn a_matt_square_is_lit_by_the_closed_form() {
    let (intensity, mut checked) = (50.0, 0);
    for eye in [DVec3::new(0.0, 0.0, 2.0), DVec3::new(3.0, 0.0, 2.0), DVec3::new(-1.0, 2.0, 0.5), DVec3::Z * 0.1] {
        for kind in
            [LightKind::Point, LightKind::Directional, LightKind::Spot { inner_cone_angle: 0.2, outer_cone_angle: 0.4 }]
        {
            let mut scene = Scene::new();
            put(&mut scene, square(1.0), Material::diffuse(Vec3::splat(0.6)), DAffine3::IDENTITY);
            put_light(&mut scene, kind, intensity, eye, DVec3::ZERO);
            let found = f64::from(middle(&mut scene, black()).x);
            let falloff = if kind == LightKind::Directional { 1.0 } else { eye.length_squared() };
            let cosine = eye.z / eye.length();
            let expected = rough_dielectric(0.6, cosine) * f64::from(intensity) / falloff;
            assert!((found - expected).abs() < 5e-5 * expected, "{kind:?} at {eye}: {found}, expected {expected}");
            checked += 1;
        }
    }
    assert_eq!(checked, 12);
}

#[test]
fn neither_side_is_lit_through_the_surface() {
    let mut scene = Scene::new();
    put(&mut scene, square(1.0), Material::default(), DAffine3::IDENTITY);
    put_light(&mut scene, LightKind::Point, 50.0, DVec3::new(0.1, 0.2, -2.0), DVec3::ZERO);
    assert_eq!(middle(&mut scene, black()), Vec3::ZERO);
}

#[test]
fn a_tilted_shading_normal_lets_no_light_round_the_surface() {
    for (height, is_lit) in [(-0.2, false), (0.2, true)] {
        let mut scene = Scene::new();
        let mut tilted = square(1.0);
        tilted.normals = Some(Arc::new([Vec3::new(0.9, 0.0, 0.44); 4]));
        put(&mut scene, tilted, Material::default(), DAffine3::IDENTITY);
        put_light(&mut scene, LightKind::Directional, 1.0, DVec3::new(1.0, 0.0, height), DVec3::ZERO);
        assert_eq!(middle(&mut scene, black()) != Vec3::ZERO, is_lit, "{height}");
    }
}

/// The share of the light that reaches a floor below a screen of this material.
fn left_below(screen: Material) -> Vec3 {
    left_below_shape(&square(0.5), screen)
}

fn left_below_shape(shape: &Geometry, screen: Material) -> Vec3 {
    let lit = |screen: Option<Material>| {
        let mut scene = Scene::new();
        put(&mut scene, square(1.0), Material::default(), DAffine3::IDENTITY);
        // Between the light and the floor, but outside of the view. The ray does not go along an edge of two triangles:
        // both would dim it.
        if let Some(material) = screen {
            put(&mut scene, shape.clone(), material, at(2.1, 0.0, 2.0));
        }
        put_light(&mut scene, LightKind::Point, 50.0, DVec3::new(4.0, 0.0, 4.0), DVec3::ZERO);
        middle(&mut scene, black())
    };
    lit(Some(screen)) / lit(None)
}

#[test]
fn shadows_let_through_what_the_material_does() {
    let orange = Vec4::new(1.0, 0.49, 0.04, 0.25);
    let surface = Material { base_color: orange, ..Material::default() };
    let part = 1.0 - 0.04; // what enters at normal incidence

    assert_eq!(left_below(surface.clone()), Vec3::ZERO, "opaque");
    let blend = Material { alpha_mode: AlphaMode::Blend, ..surface.clone() };
    assert!((left_below(blend) - Vec3::splat(0.75)).abs().max_element() < 1e-5, "blend");
    let glass = Material { transmission: 1.0, ..surface.clone() };
    let expected = orange.truncate() * part;
    assert!((left_below(glass.clone()) - expected).abs().max_element() < 1e-5, "a pane");
    let solid = left_below_shape(&cube(), glass.clone());
    assert!((solid - expected * part).abs().max_element() < 1e-5, "a solid: tinted once, reflecting twice");
    let half = Material { transmission: 0.5, metallic: 0.5, ..glass };
    assert!(
        (left_below(half) - expected * 0.25).abs().max_element() < 1e-5,
        "half of it transmits, half of that is metal"
    );
    let hole = Material { alpha_mode: AlphaMode::Mask { cutoff: 0.3 }, ..surface.clone() };
    assert_eq!(left_below(hole), Vec3::ONE, "a hole");
    let solid = Material { alpha_mode: AlphaMode::Mask { cutoff: 0.2 }, ..surface };
    assert_eq!(left_below(solid), Vec3::ZERO, "no hole");
}

#[test]
fn shadows_have_sharp_edges_where_they_belong() {
    let mut scene = Scene::new();
    put(&mut scene, square(1.0), Material::default(), DAffine3::IDENTITY);
    // A light far to the left, a screen whose shadow covers x > 0.25.
    put(&mut scene, square(0.5), Material::default(), at(-1.75 + 0.5, 0.0, 2.0));
    put_light(&mut scene, LightKind::Directional, 1.0, DVec3::new(-1.0, 0.0, 1.0), DVec3::ZERO);
    let image = render(&mut scene, &front(64, black()));
    for (i, color) in image.color.iter().enumerate() {
        let (x, y) = ((i % 64) as f32 / 32.0 - 1.0 + 1.0 / 64.0, 1.0 - (i / 64) as f32 / 32.0 - 1.0 / 64.0);
        // The screen hides what lies to its left, where x + 2 is also within it seen from above.
        let in_shadow = (0.25..1.25).contains(&x) && y.abs() < 0.5;
        let hidden = (-1.75..-0.75).contains(&x) && y.abs() < 0.5;
        assert!(hidden || (color[0] == 0.0) == in_shadow, "({x}, {y}): {color:?}");
    }
}

/// Whether a square plate above the middle of a ground throws a shadow of this length to the right, and no farther.
/// `size` has half the sides of ground and plate; everything is turned by `turn` about the middle.
fn plate_throws_its_shadow(size: [f32; 2], height: f64, length: f64, turn: DQuat) -> bool {
    let turned = |z: f64| DAffine3::from_quat(turn) * at(0.0, 0.0, z);
    let half = f64::from(size[1]);
    let mut scene = Scene::new();
    put(&mut scene, square(size[0]), Material::default(), turned(0.0));
    put(&mut scene, square(size[1]), Material::default(), turned(height));
    put_light(&mut scene, LightKind::Directional, 1.0, turn * DVec3::new(-length, 0.0, height), DVec3::ZERO);
    let mut is_lit = |x: f64, y: f64| {
        let target = turn * DVec3::new(half + x * length, y * half, 0.0);
        let camera = Camera::orthographic(1e-3 * length as f32, 1e-3 * length as f32);
        let view = View::look_at(target + turn * DVec3::Z * 2.0, target, turn * DVec3::Y, camera, 1, 1);
        render(&mut scene, &View { sky: black(), ..view }).color[0][0] > 0.0
    };
    // Beside the ground's diagonal, which leaves the plate at its corner, and elsewhere.
    [-0.98, -0.4, 0.0, 0.3].iter().all(|&y| !is_lit(0.2, y) && !is_lit(0.5, y) && is_lit(1.3, y))
}

#[test]
fn what_almost_touches_a_wide_ground_throws_its_shadow() {
    // A plane that lies along two axes has no rounding along its normal, however large it is. The shadow must be longer
    // than the rounding within the plane.
    for (size, height, length) in [
        ([10.0, 0.5], 0.05, 0.05),
        ([10.0, 0.5], 1e-4, 1e-3),
        ([1e4, 0.5], 0.05, 0.05),
        ([1e4, 0.5], 1e-3, 0.1),
        ([1e6, 50.0], 0.05, 10.0),
    ] {
        let found = plate_throws_its_shadow(size, height, length, DQuat::IDENTITY);
        assert!(found, "{height} above a ground of {size:?}");
    }
    // A tilted one has that of its coordinates: 5 cm are 50 ulps of 10 km.
    let tilted = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 0.5).normalize(), 0.7);
    for (size, height) in [([1e4, 0.5], 0.05), ([10.0, 0.5], 1e-4)] {
        assert!(plate_throws_its_shadow(size, height, height, tilted), "{height} above a tilted ground of {size:?}");
    }
}

#[test]
fn emission_and_unlit_need_no_light() {
    let mut scene = Scene::new();
    let base_color = Vec4::new(0.2, 0.4, 0.6, 1.0);
    put(&mut scene, square(1.0), Material { unlit: true, base_color, ..Material::default() }, DAffine3::IDENTITY);
    assert_eq!(middle(&mut scene, black()), base_color.truncate());
    let mut scene = Scene::new();
    let emissive = Vec3::new(3.0, 0.0, 1.0);
    put(&mut scene, square(1.0), Material { emissive, ..Material::default() }, DAffine3::IDENTITY);
    assert_eq!(middle(&mut scene, black()), emissive);
}

/// Light from above, a floor, and between them a square that faces up or down.
#[test]
fn single_sided_surfaces_cast_shadows_where_their_front_is_lit() {
    let half_open =
        Material { base_color: Vec4::new(1.0, 1.0, 1.0, 0.5), alpha_mode: AlphaMode::Blend, ..Material::default() };
    // Of a kd-tree several leaves refer to one triangle: a blended square then takes the second pass of shadow rays.
    let doubled = Geometry { blas_kind: Some(BlasKind::KdTree), ..square(0.5) };
    let mut compared = 0;
    for (material, geometry, let_through) in
        [(Material::default(), square(0.5), 0.0), (half_open.clone(), square(0.5), 0.5), (half_open, doubled, 0.5)]
    {
        for (double_sided, faces_light) in [(true, true), (true, false), (false, true), (false, false)] {
            let mut scene = Scene::new();
            put(&mut scene, square(1.0), Material { double_sided: true, ..Material::default() }, DAffine3::IDENTITY);
            put_light(&mut scene, LightKind::Directional, 1.0, DVec3::Z, DVec3::ZERO);
            let lit = under(&mut scene);
            let turn = DAffine3::from_rotation_x(if faces_light { 0.0 } else { std::f64::consts::PI });
            put(&mut scene, geometry.clone(), Material { double_sided, ..material.clone() }, at(0.0, 0.0, 0.5) * turn);
            let share = if double_sided || faces_light { let_through } else { 1.0 };
            let found = under(&mut scene);
            assert!(
                (found - lit * share).abs() < 1e-6,
                "double-sided {double_sided}, faces the light {faces_light}: {found} of {lit}"
            );
            compared += 1;
        }
    }
    assert_eq!(compared, 12);
}

/// The radiance of the floor, seen from just above it.
fn under(scene: &mut Scene) -> f32 {
    let mut view = front(1, black());
    view.world_from_view.translation.z = 0.25;
    render(scene, &view).color[0][0]
}

#[test]
fn a_closed_single_sided_surface_casts_its_whole_shadow() {
    let mut scene = Scene::new();
    put(&mut scene, square(1.0), Material::default(), DAffine3::IDENTITY);
    put(&mut scene, cube(), Material { double_sided: false, ..Material::default() }, at(0.0, 0.0, 2.0));
    put_light(&mut scene, LightKind::Directional, 1.0, DVec3::Z * 9.0, DVec3::ZERO);
    assert_eq!(under(&mut scene), 0.0);
}
