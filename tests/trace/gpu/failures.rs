//! Lost devices and exhausted memory: the errors, and how rendering recovers.

use glam::{DVec3, Vec3};
use ropewalk::trace::gpu::{GpuTracer, required_limits};
use ropewalk::{
    Core, DeviceChoice, Error, Geometry, Light, Material, Renderer, RendererOptions, Scene, Transform, View,
    image::Image,
};

use super::device::{adapter, device};
use ropewalk_testkit::gpu::usable;

fn scene() -> Scene {
    let mut scene = Scene::new();
    let geometry = scene.add_geometry(Geometry::new([Vec3::NEG_X, Vec3::X, Vec3::Y], [[0, 1, 2]])).unwrap();
    let material = scene.add_material(Material::diffuse(Vec3::new(0.8, 0.3, 0.1))).unwrap();
    for x in [-1.0, 1.0] {
        let place = scene.add(scene.root(), Transform::from_translation(DVec3::X * x)).unwrap();
        scene.add(place, Core::Geometry { geometry, material }).unwrap();
    }
    let place = Transform::looking_at(DVec3::new(1.0, 2.0, 3.0), DVec3::ZERO, DVec3::Y);
    let sun = scene.add(scene.root(), place).unwrap();
    scene.add(sun, Light::directional(Vec3::ONE, 3.0)).unwrap();
    scene
}

fn draw(renderer: &mut Renderer, scene: &mut Scene, view: &View) -> Image {
    renderer.render(scene, view).unwrap().image().unwrap()
}

#[test]
fn a_renderer_opens_its_device_again_and_uploads_everything_but_builds_nothing() {
    let Some(mut renderer) = usable(Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Gpu))) else {
        return;
    };
    let mut scene = scene();
    let view = View::framing(&mut scene, 40, 30).unwrap();
    let first = renderer.render(&mut scene, &view).unwrap();
    let uploaded = first.report().uploaded_bytes;
    let expected = first.image().unwrap();
    assert!(expected.color.iter().any(|color| color[0] > 2.0 * color[2]), "the triangles are seen");

    // The device is lost between two frames, and between a frame and the reading of its image.
    renderer.gpu_tracer().unwrap().wgpu_device().destroy();
    let error = renderer.render(&mut scene, &view).err().unwrap();
    assert!(matches!(error, Error::DeviceLost { .. }), "{error}");
    let second = renderer.render(&mut scene, &view).unwrap();
    assert_eq!((second.report().uploaded_bytes, second.report().compile.blas_built), (uploaded, 0));
    assert_eq!(second.image().unwrap().color, expected.color);

    let lost = renderer.gpu_tracer().unwrap().wgpu_device().clone();
    let frame = renderer.render(&mut scene, &view).unwrap();
    lost.destroy();
    assert!(matches!(frame.image(), Err(Error::DeviceLost { .. })));
    assert_eq!(draw(&mut renderer, &mut scene, &view).color, expected.color);
}

#[test]
fn a_lost_device_of_the_application_is_the_applications_to_replace() {
    let Some((adapter, _)) = adapter() else { return };
    let open = || {
        let (device, queue) = device(&adapter, required_limits(&adapter), wgpu::Features::empty());
        (device.clone(), GpuTracer::from_device(device, queue).unwrap())
    };
    let (lost, tracer) = open();
    let mut renderer = Renderer::with_tracer(tracer);
    let mut scene = scene();
    let view = View::framing(&mut scene, 40, 30).unwrap();
    let expected = draw(&mut renderer, &mut scene, &view);
    lost.destroy();
    for _ in 0..3 {
        let error = renderer.render(&mut scene, &view).err().unwrap();
        assert!(matches!(error, Error::DeviceLost { .. }), "{error}");
    }
    renderer.set_tracer(open().1);
    let frame = renderer.render(&mut scene, &view).unwrap();
    assert_eq!(frame.report().compile.blas_built, 0);
    assert_eq!(frame.image().unwrap().color, expected.color);
}

#[test]
fn an_image_that_memory_cannot_hold_is_refused_and_the_next_is_drawn() {
    let Some(mut renderer) = usable(Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Gpu))) else {
        return;
    };
    let mut scene = scene();
    let view = View::framing(&mut scene, 40, 30).unwrap();
    let expected = draw(&mut renderer, &mut scene, &view);
    // Three textures of 4 GiB each, more than a software renderer allocates.
    let side = renderer.gpu_tracer().unwrap().wgpu_device().limits().max_texture_dimension_2d;
    let huge = View { width: side, height: side, aovs: true, ..view.clone() };
    if renderer.gpu_tracer().unwrap().wgpu_device().adapter_info().device_type != wgpu::DeviceType::Cpu {
        println!("skipped: this GPU may have the memory");
        return;
    }
    let error = renderer.render(&mut scene, &huge).err().unwrap();
    assert!(matches!(error, Error::OutOfMemory { during: "tracing the frame", .. }), "{error}");
    assert_eq!(draw(&mut renderer, &mut scene, &view).color, expected.color);
    assert_eq!(renderer.device_info().executor, "gpu");
}
