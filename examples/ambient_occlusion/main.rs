//! Ambient occlusion by the application's own compute shader, which traces rays through the scene on the GPU.
//!
//! ```sh
//! cargo run --release --example ambient_occlusion   # writes occlusion.png
//! ```

mod occlusion;

use occlusion::Occlusion;
use ropewalk::glam::{DQuat, DVec3, Vec3};
use ropewalk::image::Image;
use ropewalk::{Core, DeviceChoice, Geometry, Material, Renderer, RendererOptions, Scene, Transform};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut scene = boxes()?;
    let mut renderer = Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Gpu))?;
    let [width, height] = [800, 600];
    let occlusion = Occlusion {
        eye: DVec3::new(5.0, 4.0, 8.0),
        target: DVec3::new(0.0, 0.5, 0.0),
        size: [width, height],
        samples: 64,
        radius: 3.0,
    };
    let visibility = occlusion.compute(&mut renderer, &mut scene)?.ok_or("no GPU is used")?;
    let color = visibility.iter().map(|&v| [v, v, v, 1.0]).collect();
    Image::new(width, height, color).save("occlusion.png")?;
    println!("{}: occlusion.png", renderer.device_info().name);
    Ok(())
}

/// A floor with boxes of increasing height in a spiral.
fn boxes() -> ropewalk::Result<Scene> {
    let mut scene = Scene::new();
    let corner = |i: u32| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) - Vec3::splat(0.5);
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let geometry = scene.add_geometry(Geometry::new((0..8).map(corner).collect::<Vec<_>>(), triangles))?;
    let material = scene.add_material(Material::diffuse(Vec3::splat(0.8)))?;
    let core = scene.add_core(Core::Geometry { geometry, material })?;
    let mut add_box = |translation, turn, scale| {
        let rotation = DQuat::from_rotation_y(turn);
        let node = scene.add(scene.root(), Transform::Trs { translation, rotation, scale })?;
        scene.add(node, core)
    };
    add_box(DVec3::new(0.0, -0.05, 0.0), 0.0, DVec3::new(20.0, 0.1, 20.0))?;
    for i in 0..9 {
        let (angle, height) = (f64::from(i) * 0.7, 0.4 + 0.3 * f64::from(i));
        let center = DVec3::new(2.2 * angle.cos(), 0.5 * height, 2.2 * angle.sin());
        add_box(center, -angle, DVec3::new(1.0, height, 1.0))?;
    }
    Ok(scene)
}
