//! An edited scene: after each edit the GPU, which receives only the changes, renders what the executor `cpu` renders
//! of the scene compiled from scratch.

use glam::{DVec3, Vec3, Vec4};
use ropewalk::image::Image;
use ropewalk::trace::gpu::GpuTracer;
use ropewalk::trace::{Cpu, Traversal};
use ropewalk::{Camera, Core, Geometry, GeometryKey, Material, MaterialKey, NodeKey, Renderer, Scene, Transform, View};

use super::device::limited;
use ropewalk_testkit::Random;
use ropewalk_testkit::gpu::tracer;

#[test]
fn after_every_edit_the_gpu_shows_the_scene() {
    after_every_edit(tracer(), 80);
}

#[test]
fn after_every_edit_it_does_where_nodes_and_triangles_are_split_too() {
    for layout in [Traversal::Rope, Traversal::Wide] {
        let gpu = limited(|limits| limits.max_storage_buffer_binding_size = 8192);
        after_every_edit(gpu.map(|gpu| gpu.with_traversal(layout)), 30);
    }
}

fn after_every_edit(gpu: Option<GpuTracer>, steps: u32) {
    let Some(gpu) = gpu else { return };
    let mut incremental = Renderer::with_tracer(gpu);
    let mut random = Random::new(1);
    let mut edited = Edited::new();
    for step in 0..steps {
        let edit = edited.edit(&mut random);
        let found = draw(&mut incremental, &mut edited.scene);
        let expected = draw(&mut Renderer::with_tracer(Cpu::default()), &mut edited.scene);
        compare(&found, &expected, &format!("after step {step}, {edit}"));
    }
}

#[test]
fn an_unchanged_scene_uploads_nothing() {
    let Some(gpu) = tracer() else { return };
    let mut renderer = Renderer::with_tracer(gpu);
    let mut edited = Edited::new();
    let mut uploaded = |scene: &mut Scene| renderer.render(scene, &view()).unwrap().report().uploaded_bytes;
    assert!(uploaded(&mut edited.scene) > 0);
    assert_eq!(uploaded(&mut edited.scene), 0);
}

/// A scene, and the keys from which its edits choose.
struct Edited {
    scene: Scene,
    geometries: Vec<GeometryKey>,
    materials: Vec<MaterialKey>,
    places: Vec<NodeKey>,
}

impl Edited {
    /// Nine visible nodes of three geometries and three materials.
    fn new() -> Self {
        let mut scene = Scene::new();
        let geometries = [4, 9, 30].map(|sides| scene.add_geometry(cone(sides)).unwrap()).to_vec();
        let materials = [Vec3::X, Vec3::Y, Vec3::Z].map(|color| scene.add_material(colored(color)).unwrap()).to_vec();
        // Hidden nodes that use each asset, since assets without users are freed.
        for (&geometry, &material) in geometries.iter().zip(&materials) {
            let node = scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
            scene.set_visible(node, false).unwrap();
        }
        let mut edited = Self { scene, geometries, materials, places: Vec::new() };
        let mut random = Random::new(2);
        for _ in 0..9 {
            edited.add(&mut random);
        }
        edited
    }

    fn add(&mut self, random: &mut Random) {
        let place = Transform::from_translation(DVec3::from_array(random.in_cube().to_array().map(f64::from)) * 2.0);
        let node = self.scene.add(self.scene.root(), place).unwrap();
        let geometry = pick(&self.geometries, random);
        let material = pick(&self.materials, random);
        self.scene.add(node, Core::Geometry { geometry, material }).unwrap();
        self.places.push(node);
    }

    /// Makes a random edit and returns its description.
    fn edit(&mut self, random: &mut Random) -> &'static str {
        let node = pick(&self.places, random);
        let point = random.in_cube().to_array();
        match (random.unsigned() * 8.0) as u32 {
            0 => {
                self.add(random);
                "a node added"
            }
            1 if self.places.len() > 4 => {
                self.scene.remove(node).unwrap();
                self.places.retain(|&place| place != node);
                "a node removed"
            }
            2 => {
                let sides = 3 + (random.unsigned() * 200.0) as u32;
                self.scene.set_geometry(pick(&self.geometries, random), cone(sides)).unwrap();
                "a geometry changed"
            }
            3 => {
                let color = Vec3::from_array(point).abs();
                self.scene.set_material(pick(&self.materials, random), colored(color)).unwrap();
                "a material changed"
            }
            4 => {
                let is_visible = self.scene.is_visible(node).unwrap();
                self.scene.set_visible(node, !is_visible).unwrap();
                "a node shown or hidden"
            }
            _ => {
                let place = Transform::from_translation(DVec3::from_array(point.map(f64::from)) * 2.0);
                self.scene.set_local(node, place).unwrap();
                "a node moved"
            }
        }
    }
}

/// A cone around the y axis, from -0.7 to 0.7, without a base.
fn cone(sides: u32) -> Geometry {
    let rim = (0..sides).map(|i| {
        let angle = i as f32 / sides as f32 * std::f32::consts::TAU;
        Vec3::new(angle.sin(), -1.0, angle.cos()) * 0.7
    });
    let positions: Vec<Vec3> = std::iter::once(Vec3::Y * 0.7).chain(rim).collect();
    let triangles: Vec<[u32; 3]> = (0..sides).map(|i| [0, 1 + i, 1 + (i + 1) % sides]).collect();
    Geometry::new(positions, triangles)
}

fn colored(color: Vec3) -> Material {
    Material { base_color: Vec4::from((color, 1.0)), roughness: 1.0, double_sided: true, ..Material::default() }
}

fn pick<T: Copy>(from: &[T], random: &mut Random) -> T {
    from[((random.unsigned() * from.len() as f32) as usize).min(from.len() - 1)]
}

fn view() -> View {
    let mut view = View::look_at(DVec3::new(1.0, 2.0, 9.0), DVec3::ZERO, DVec3::Y, Camera::default(), 96, 72);
    view.aovs = true;
    view
}

fn draw(renderer: &mut Renderer, scene: &mut Scene) -> Image {
    renderer.render(scene, &view()).unwrap().image().unwrap()
}

/// Compares two images. Where a GPU rounds differently, an edge or a shadow may fall to the other side of a pixel's
/// ray: a few pixels may differ.
fn compare(found: &Image, expected: &Image, when: &str) {
    let (a, b) = (found.aovs.as_ref().unwrap(), expected.aovs.as_ref().unwrap());
    assert!(b.triangle.iter().any(|&triangle| triangle != u32::MAX), "{when}: nothing is seen");
    assert_eq!(a.node.len(), b.node.len());
    let other = (0..b.node.len()).filter(|&i| (a.node[i], a.triangle[i]) != (b.node[i], b.triangle[i])).count();
    assert!(other * 1000 < b.node.len(), "{when}: {other} pixels show another triangle");
    let differs = |(a, b): &(&[f32; 4], &[f32; 4])| a.iter().zip(b.iter()).any(|(a, b)| (a - b).abs() > 1e-3);
    let other = found.color.iter().zip(&expected.color).filter(differs).count();
    assert!(other * 200 < b.node.len(), "{when}: {other} pixels have another colour");
}
