//! Frames of a renderer that are cancelled.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use glam::{DVec3, Vec3};
use ropewalk::trace::Emulated;
use ropewalk::{
    Camera, Cancel, Core, DeviceChoice, Error, Geometry, Light, Material, Renderer, RendererOptions, Scene, View,
};
use ropewalk_testkit::Mesh;

fn scene() -> Scene {
    let mut scene = Scene::new();
    let Mesh { positions, indices } = Mesh::displaced_icosphere(4);
    let geometry = scene.add_geometry(Geometry::new(positions, indices)).unwrap();
    let material = scene.add_material(Material::diffuse(Vec3::new(0.7, 0.5, 0.3))).unwrap();
    scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
    scene.add(scene.root(), Light::directional(Vec3::ONE, 2.0)).unwrap();
    scene
}

fn view() -> View {
    View::look_at(DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, DVec3::Y, Camera::default(), 64, 48)
}

fn cpu() -> Renderer {
    Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap()
}

#[test]
fn a_first_frame_that_is_cancelled_anywhere_is_rendered_by_the_next_call() {
    let expected = cpu().render(&mut scene(), &view()).unwrap().image().unwrap();
    for checks in 0.. {
        let (mut renderer, mut scene) = (cpu(), scene());
        renderer.set_cancel(Cancel::after_checks(checks));
        let rendered = renderer.render(&mut scene, &view()).map(|frame| frame.image().unwrap());
        if let Ok(image) = rendered {
            assert!(checks > 15, "only {checks} places to cancel");
            assert_eq!(image, expected);
            break;
        }
        assert_eq!(rendered.err(), Some(Error::Cancelled));
        renderer.set_cancel(None);
        assert_eq!(renderer.render(&mut scene, &view()).unwrap().image().unwrap(), expected, "after {checks} checks");
    }
}

#[test]
fn a_token_stops_a_frame_from_another_thread_and_every_call_until_there_is_another() {
    let (mut renderer, mut scene) = (cpu(), scene());
    let cancel = Cancel::new();
    renderer.set_cancel(cancel.clone());
    std::thread::scope(|threads| {
        threads.spawn(|| cancel.cancel());
        // Some frame is the first that is cancelled.
        while renderer.render(&mut scene, &view()).is_ok() {}
    });
    assert_eq!(renderer.render(&mut scene, &view()).err(), Some(Error::Cancelled));
    assert_eq!(renderer.prepare(&mut scene).err(), Some(Error::Cancelled));
    assert_eq!(renderer.queries(&mut scene).err(), Some(Error::Cancelled));
    renderer.set_tracer(Emulated::default());
    assert_eq!(renderer.render(&mut scene, &view()).err(), Some(Error::Cancelled));
    renderer.set_cancel(Cancel::new());
    assert!(renderer.render(&mut scene, &view()).is_ok());
}

#[test]
fn a_tracer_that_replaces_another_gets_its_token() {
    let (mut renderer, mut scene) = (cpu(), scene());
    renderer.render(&mut scene, &view()).unwrap();
    // The compile looks at the token once, since nothing has changed, and the frame from then on.
    renderer.set_cancel(Cancel::after_checks(1));
    renderer.set_tracer(Emulated::default());
    assert_eq!(renderer.render(&mut scene, &view()).err(), Some(Error::Cancelled));
}
