//! What each kind of edit costs: makes a scene, edits it in every way, and prints what the renderer did about it.
//!
//!     cargo run --release --example edit_scene

use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use ropewalk::glam::{DQuat, DVec3, Vec3};
use ropewalk::{
    Core, CoreKey, DeviceChoice, FrameReport, Geometry, GeometryKey, KeepTransform, Light, Lod, Material, MaterialKey,
    NodeKey, Renderer, RendererOptions, Result, Scene, Switch, Transform, View,
};

fn main() -> Result<()> {
    let mut lamps = Lamps::new()?;
    let mut renderer = Renderer::new(&RendererOptions::default())?;
    let view = View::framing(&mut lamps.scene, 160, 120)?;
    println!(
        "{} ({}), {} nodes",
        renderer.device_info().executor,
        renderer.device_info().name,
        lamps.scene.node_count()
    );

    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header([
        "edit",
        "top level",
        "bottom levels built",
        "instances written",
        "bytes to the GPU",
        "update, ms",
    ]);
    for (name, edit) in EDITS {
        edit(&mut lamps)?;
        let report = renderer.render(&mut lamps.scene, &view)?.report().clone();
        table.add_row(row(name, &report));
    }
    println!("{table}");
    Ok(())
}

fn row(name: &str, report: &FrameReport) -> [String; 6] {
    let compile = &report.compile;
    let time = compile.update_time + compile.blas_time + compile.tlas_time + report.upload_time;
    [
        name.to_owned(),
        compile.tlas.to_string(),
        compile.blas_built.to_string(),
        compile.instances_written.to_string(),
        report.uploaded_bytes.to_string(),
        format!("{:.3}", time.as_secs_f64() * 1e3),
    ]
}

type Edit = fn(&mut Lamps) -> Result<()>;

/// Every kind of edit, in an order that makes sense for all of them.
const EDITS: [(&str, Edit); 20] = [
    ("(first frame)", |_| Ok(())),
    ("nothing", |_| Ok(())),
    ("a name", |lamps| lamps.scene.set_name(lamps.first, "first")),
    ("a transform set to what it was", |lamps| {
        let local = lamps.scene.local(lamps.first)?;
        lamps.scene.set_local(lamps.first, local)
    }),
    ("move one", |lamps| lamps.scene.set_local(lamps.first, at(0.0, 1.0, 0.0))),
    ("turn all, by a transform above them", |lamps| {
        lamps.scene.set_local(lamps.all, Transform::from_rotation(DQuat::from_rotation_y(0.1)))
    }),
    ("hide one", |lamps| lamps.scene.set_visible(lamps.first, false)),
    ("show it again", |lamps| lamps.scene.set_visible(lamps.first, true)),
    ("mask one", |lamps| lamps.scene.set_mask(lamps.first, 1)),
    ("a material that a thousand share", |lamps| {
        lamps.scene.set_material(lamps.material, Material::diffuse(Vec3::new(0.9, 0.4, 0.2)))
    }),
    ("a geometry that a thousand share", |lamps| lamps.scene.set_geometry(lamps.geometry, pyramid(1.5))),
    ("add one of the same geometry", |lamps| {
        let place = lamps.scene.add(lamps.scene.root(), at(0.0, 5.0, 0.0))?;
        lamps.scene.add(place, lamps.shape).map(drop)
    }),
    ("another kind of core", |lamps| lamps.scene.assign_core(lamps.first, Core::Group)),
    ("move to another parent, staying in place", |lamps| {
        lamps.scene.reparent(lamps.second, lamps.scene.root(), KeepTransform::World)
    }),
    ("remove one", |lamps| lamps.scene.remove(lamps.second)),
    ("toggle a switch", |lamps| {
        let core = lamps.scene.core_key(lamps.switch)?;
        lamps.scene.set_core(core, Core::Switch(Switch::One(1)))
    }),
    ("levels of detail instead of the switch", |lamps| lamps.scene.assign_core(lamps.switch, Lod::by_distance([1e3]))),
    ("override the material of a subtree", |lamps| {
        let glass = lamps.scene.add_material(Material::glass(1.5))?;
        lamps.scene.assign_core(lamps.group, Core::MaterialGroup(glass))
    }),
    ("a thousand more by one instance of a subtree", |lamps| {
        let place = lamps.scene.add(lamps.scene.root(), at(0.0, 0.0, -60.0))?;
        lamps.scene.add(place, Core::Instance(lamps.all)).map(drop)
    }),
    ("a light", |lamps| {
        let place = lamps.scene.add(lamps.scene.root(), at(0.0, 20.0, 0.0))?;
        lamps.scene.add(place, Light::point(Vec3::ONE, 500.0)).map(drop)
    }),
];

/// A thousand pyramids of one geometry, and the nodes that the edits are about.
struct Lamps {
    scene: Scene,
    geometry: GeometryKey,
    material: MaterialKey,
    shape: CoreKey,
    all: NodeKey,
    first: NodeKey,
    second: NodeKey,
    switch: NodeKey,
    group: NodeKey,
}

impl Lamps {
    fn new() -> Result<Self> {
        let mut scene = Scene::new();
        let root = scene.root();
        let geometry = scene.add_geometry(pyramid(1.0))?;
        let material = scene.add_material(Material::diffuse(Vec3::splat(0.8)))?;
        let shape = scene.add_core(Core::Geometry { geometry, material })?;
        let sun = scene.add(root, Transform::looking_at(DVec3::new(2.0, 5.0, 3.0), DVec3::ZERO, DVec3::Y))?;
        scene.add(sun, Light::directional(Vec3::ONE, 3.0))?;

        let all = scene.add(root, Transform::IDENTITY)?;
        let mut places = Vec::new();
        for i in 0..1000_u32 {
            let place = at(f64::from(i % 40) * 1.5 - 30.0, 0.0, f64::from(i / 40) * 1.5 - 20.0);
            let node = scene.add(all, place)?;
            scene.add(node, shape)?;
            places.push(node);
        }
        let group = scene.add(root, Core::Group)?;
        let switch = scene.add(group, Switch::One(0))?;
        for i in 0..2 {
            let node = scene.add(switch, at(0.0, 3.0 + f64::from(i), 0.0))?;
            scene.add(node, shape)?;
        }
        Ok(Self { scene, geometry, material, shape, all, first: places[0], second: places[1], switch, group })
    }
}

fn at(x: f64, y: f64, z: f64) -> Transform {
    Transform::from_translation(DVec3::new(x, y, z))
}

fn pyramid(height: f32) -> Geometry {
    let corners = [[-0.5, 0.0, -0.5], [0.5, 0.0, -0.5], [0.5, 0.0, 0.5], [-0.5, 0.0, 0.5], [0.0, height, 0.0]];
    Geometry::new(corners.map(Vec3::from_array), [[0, 1, 2], [0, 2, 3], [1, 0, 4], [2, 1, 4], [3, 2, 4], [0, 3, 4]])
}
