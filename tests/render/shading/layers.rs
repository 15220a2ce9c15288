//! Surfaces that touch, and paths through many layers: every layer counts once, on every executor.

use glam::{DAffine3, DQuat, DVec3, Vec3, Vec4};
use ropewalk::graph::AlphaMode;
use ropewalk::image::Image;
use ropewalk::trace::{Emulated, Recursive, Traversal};
use ropewalk::{Camera, DeviceChoice, Geometry, Material, Renderer, RendererOptions, Scene, View};

use super::scenes::{at, black, cube, front, put, square};

const RED: Vec3 = Vec3::X;
const GREEN: Vec3 = Vec3::Y;

fn opaque(color: Vec3) -> Material {
    Material { unlit: true, ..Material::diffuse(color) }
}

fn blended(color: Vec3, alpha: f32) -> Material {
    Material { base_color: color.extend(alpha), alpha_mode: AlphaMode::Blend, unlit: true, ..Material::default() }
}

/// A square of `cells` by `cells` quads.
fn grid(half: f32, cells: u32) -> Geometry {
    let across = |i: u32| (i as f32 / cells as f32 * 2.0 - 1.0) * half;
    let positions: Vec<Vec3> =
        (0..=cells).flat_map(|y| (0..=cells).map(move |x| Vec3::new(across(x), across(y), 0.0))).collect();
    let corner = |x: u32, y: u32| y * (cells + 1) + x;
    let quads = (0..cells).flat_map(|y| (0..cells).map(move |x| (x, y)));
    let triangles = quads.flat_map(|(x, y)| {
        let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
        [[a, b, d], [b, c, d]]
    });
    Geometry::new(positions, triangles.collect::<Vec<_>>())
}

/// Every executor that can be used here, by name.
fn renderers() -> Vec<(String, Renderer)> {
    let open = |device| Renderer::new(&RendererOptions::default().with_device(device));
    #[cfg(feature = "gpu")]
    let gpu = ropewalk_testkit::gpu::usable(open(DeviceChoice::Gpu)).map(|gpu| (gpu.device_info().name.clone(), gpu));
    #[cfg(not(feature = "gpu"))]
    let gpu = None;
    let others = [
        ("cpu".to_owned(), open(DeviceChoice::Cpu).unwrap()),
        ("emulated".to_owned(), open(DeviceChoice::Emulated).unwrap()),
        ("rope".to_owned(), Renderer::with_tracer(Emulated::default().with_traversal(Traversal::Rope))),
        ("recursive".to_owned(), Renderer::with_tracer(Recursive::default())),
    ];
    others.into_iter().chain(gpu).collect()
}

fn draw(renderer: &mut Renderer, scene: &mut Scene, view: &View) -> (Image, u64) {
    let frame = renderer.render(scene, view).unwrap();
    (frame.image().unwrap(), frame.limited_pixels().unwrap())
}

/// The view of [`front`], moved and turned with the scene.
fn placed_front(size: u32, place: DAffine3) -> View {
    let view = front(size, black());
    View { world_from_view: place * view.world_from_view, ..view }
}

/// The pixel that differs most from a colour, and by how much.
fn worst(image: &Image, color: Vec3) -> (usize, f32) {
    let errors = image.color.iter().map(|found| (Vec3::from_slice(found) - color).abs().max_element());
    errors.enumerate().fold((0, 0.0), |worst, (i, error)| if error > worst.1 { (i, error) } else { worst })
}

#[test]
fn what_touches_is_seen_whichever_is_first_and_however_it_is_tilted() {
    let turn = |x, y, z| DQuat::from_euler(glam::EulerRot::XYZ, x, y, z);
    let places = [
        DAffine3::IDENTITY,
        DAffine3::from_rotation_translation(turn(0.3, 0.5, 0.2), DVec3::new(1.5, -2.5, 0.7)),
        DAffine3::from_rotation_translation(turn(-1.1, 2.0, 0.9), DVec3::new(-31.0, 12.0, 77.0)),
        DAffine3::from_scale_rotation_translation(DVec3::new(1.0, 1.0, -1.0), turn(0.1, 0.2, 3.0), DVec3::splat(0.3)),
    ];
    // Unmoved glass of an index of 1 neither bends nor reflects: its tint is all that it does.
    let pane = Material { base_color: Vec4::new(0.5, 0.5, 0.5, 1.0), ..Material::glass(1.0) };
    let dense = Material::glass(1.5);
    let covers: [(&str, Geometry, Material, DAffine3, Vec3); 5] = [
        ("label", square(1.1), blended(RED, 0.5), at(0.05, 0.02, 0.0), Vec3::new(0.5, 0.5, 0.0)),
        ("fine label", grid(1.2, 7), blended(RED, 0.5), at(-0.03, 0.01, 0.0), Vec3::new(0.5, 0.5, 0.0)),
        ("clear label", square(1.3), blended(RED, 0.0), at(0.0, 0.0, 0.0), GREEN),
        ("pane", grid(1.1, 3), pane, at(0.01, 0.0, 0.0), GREEN * 0.5),
        // Two refractions, each of which reflects (0.5 / 2.5)^2.
        ("block", cube(), dense, at(0.01, -0.02, 1.0), GREEN * (0.96 * 0.96)),
    ];
    let mut renderers = renderers();
    let mut compared = 0;
    for place in places {
        for (cover, geometry, material, shift, expected) in &covers {
            for distance in [0.0, 1e-5, 1e-3] {
                for cover_is_first in [false, true] {
                    let mut scene = Scene::new();
                    let wall =
                        || (grid(3.0, 5), Material { double_sided: true, ..opaque(GREEN) }, place * at(0.1, 0.2, 0.0));
                    let cover_place = place * at(0.0, 0.0, distance) * *shift;
                    if !cover_is_first {
                        let (geometry, material, place) = wall();
                        put(&mut scene, geometry, material, place);
                    }
                    let double_sided = Material { double_sided: true, ..material.clone() };
                    put(&mut scene, geometry.clone(), double_sided, cover_place);
                    if cover_is_first {
                        let (geometry, material, place) = wall();
                        put(&mut scene, geometry, material, place);
                    }
                    // Within the cover, whose sides a block shows only at its edge.
                    let mut view = placed_front(33, place);
                    view.camera = Camera::orthographic(0.9, 0.9);
                    for (name, renderer) in &mut renderers {
                        let (image, limited) = draw(renderer, &mut scene, &view);
                        let (pixel, error) = worst(&image, *expected);
                        assert!(
                            error < 1e-5,
                            "{name}: {cover} {distance} above the wall, first {cover_is_first}, {place:?}: pixel \
                             {pixel} is {:?}, expected {expected}",
                            image.color[pixel]
                        );
                        assert_eq!(limited, 0);
                        compared += image.color.len();
                    }
                }
            }
        }
    }
    assert!(compared > 400_000, "{compared}");
}

#[test]
fn a_hundred_layers_hide_nothing_but_by_their_alpha() {
    let mut scene = Scene::new();
    put(&mut scene, square(2.0), opaque(GREEN), at(0.0, 0.0, -1.0));
    for layer in 0..100 {
        put(&mut scene, square(1.0), blended(RED, 0.02), at(0.0, 0.0, f64::from(layer) * 1e-3));
    }
    let behind = 0.98f32.powi(100);
    let expected = RED * (1.0 - behind) + GREEN * behind;
    for (name, mut renderer) in renderers() {
        let (image, limited) = draw(&mut renderer, &mut scene, &front(9, black()));
        let (pixel, error) = worst(&image, expected);
        assert!(error < 1e-5 && limited == 0, "{name}: pixel {pixel} is {:?}, expected {expected}", image.color[pixel]);
    }
}

#[test]
fn a_pixel_that_has_used_up_its_rays_sees_what_is_opaque() {
    let mut scene = Scene::new();
    // A wall behind the left half; the sky is black.
    put(&mut scene, square(1.0), opaque(GREEN), at(-1.0, 0.0, -1.0));
    for layer in 0..20 {
        put(&mut scene, square(1.0), blended(RED, 0.1), at(0.0, 0.0, f64::from(layer) * 0.1));
    }
    let view = View { max_rays: 10, ..front(8, black()) };
    let behind = 0.9f32.powi(10);
    for (name, mut renderer) in renderers() {
        let (image, limited) = draw(&mut renderer, &mut scene, &view);
        assert_eq!(limited, 64, "{name}");
        for (pixel, found) in image.color.iter().enumerate() {
            let expected = RED * (1.0 - behind) + GREEN * if pixel % 8 < 4 { behind } else { 0.0 };
            let found = Vec3::from_slice(found);
            assert!((found - expected).abs().max_element() < 1e-5, "{name}: pixel {pixel} is {found}, not {expected}");
        }
        // With as many rays as it needs nothing is cut off.
        let enough = View { max_rays: 21, ..view.clone() };
        assert_eq!(draw(&mut renderer, &mut scene, &enough).1, 0, "{name}");
    }
}

#[test]
fn a_layer_counts_once_at_the_edges_of_its_triangles() {
    let mut scene = Scene::new();
    put(&mut scene, grid(1.0, 8), blended(RED, 0.5), DAffine3::IDENTITY);
    // 16 pixels across 8 cells, then odd numbers: through the diagonals, the vertices and the sides of the quads.
    for (name, mut renderer) in renderers() {
        for size in [16, 17, 31, 33] {
            let (image, _) = draw(&mut renderer, &mut scene, &front(size, black()));
            let (pixel, error) = worst(&image, RED * 0.5);
            assert!(error < 1e-6, "{name}, {size} pixels: pixel {pixel} is {:?}", image.color[pixel]);
        }
    }
}
