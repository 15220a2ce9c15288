//! Invalid arguments of queries.

use glam::{DAffine3, DMat3, DVec3};
use ropewalk::compile::Compiler;
use ropewalk::math::Bounds;
use ropewalk::query::{HalfSpace, Overlap};
use ropewalk::query::{Queries, Region};
use ropewalk::{Camera, DeviceChoice, Error, Ray, Renderer, RendererOptions, Result, Scene, View};

#[expect(clippy::needless_pass_by_value, reason = "a result is asked once")]
fn is_out_of_range<T>(result: Result<T>, expected: &str) -> bool {
    matches!(result, Err(Error::OutOfRange { what, .. }) if what == expected)
}

#[test]
fn impossible_questions_are_typed_errors() {
    let mut scene = Scene::new();
    let mut compiler = Compiler::new();
    let queries = Queries::new(&mut compiler, &mut scene).unwrap();
    let (nan, infinite) = (DVec3::new(0.0, f64::NAN, 0.0), DVec3::new(0.0, f64::INFINITY, 0.0));
    for bad in [nan, infinite] {
        assert!(is_out_of_range(queries.closest_hit(&Ray::new(bad, DVec3::X)), "ray origin"));
        assert!(is_out_of_range(queries.any_hit(&Ray::new(DVec3::X, bad)), "ray direction"));
        assert!(is_out_of_range(queries.nearest(bad, 1.0), "point"));
        assert!(is_out_of_range(queries.boxes_containing(bad), "point"));
        assert!(is_out_of_range(queries.solids_containing(bad), "point"));
        assert!(is_out_of_range(Region::new([HalfSpace { normal: bad, offset: 0.0 }]), "half space"));
        assert!(is_out_of_range(Region::new_box(&Bounds { min: -DVec3::ONE, max: bad }), "box"));
    }
    assert!(is_out_of_range(queries.all_hits(&Ray::new(DVec3::X, DVec3::ZERO)), "ray direction"));
    let limits = Ray { t_max: f64::NAN, ..Ray::new(DVec3::X, DVec3::X) };
    assert!(is_out_of_range(queries.closest_hit(&limits), "ray interval"));
    assert!(is_out_of_range(queries.nearest(DVec3::X, -1.0), "greatest distance"));
    assert!(is_out_of_range(queries.nearest(DVec3::X, f64::NAN), "greatest distance"));
    assert!(is_out_of_range(Region::new([HalfSpace { normal: DVec3::ZERO, offset: 0.0 }]), "half space"));
    assert!(is_out_of_range(Region::new_box(&Bounds::EMPTY), "box"));
}

#[test]
fn pixels_outside_the_image_are_typed_errors() {
    let mut scene = Scene::new();
    let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap();
    let view = View::look_at(DVec3::Z, DVec3::ZERO, DVec3::Y, Camera::default(), 40, 30);
    for pixel in [[40, 0], [0, 30], [u32::MAX, 0]] {
        assert!(is_out_of_range(renderer.pick(&mut scene, &view, pixel), "pixel"));
    }
    assert!(renderer.pick(&mut scene, &view, [39, 29]).unwrap().is_none());
    for (columns, rows) in [(0..41, 0..30), (0..40, 10..31), (5..5, 0..1), (0..1, u32::MAX..u32::MAX)] {
        assert!(is_out_of_range(view.pixel_frustum(columns, rows), "pixel"));
    }
    assert!(is_out_of_range(View { height: 0, ..view.clone() }.frustum(), "pixel"));
    let in_a_plane = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::X, DVec3::Z));
    assert!(is_out_of_range(View { world_from_view: in_a_plane, ..view.clone() }.frustum(), "half space"));
    let nowhere = DAffine3::from_translation(DVec3::NAN);
    assert!(is_out_of_range(View { world_from_view: nowhere, ..view }.frustum(), "camera pose"));
}

#[test]
fn nothing_is_found_where_nothing_is() {
    let mut scene = Scene::new();
    let mut compiler = Compiler::new();
    let queries = Queries::new(&mut compiler, &mut scene).unwrap();
    assert!(queries.bounds().is_empty());
    assert!(queries.closest_hit(&Ray::new(DVec3::ZERO, DVec3::X)).unwrap().is_none());
    assert!(queries.nearest(DVec3::ZERO, f64::INFINITY).unwrap().is_none());
    assert!(queries.overlapping(&Region::new([]).unwrap(), Overlap::Touching).is_empty());
    assert!(queries.boxes_containing(DVec3::ZERO).unwrap().is_empty());
}
