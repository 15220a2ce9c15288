//! Applies each kind of edit to a scene of a thousand pyramids, and prints what it costs the next frame: acceleration
//! structures built, bytes uploaded, time.
//!
//!     cargo run --release --example edit_scene

use comfy_table::Table;
use comfy_table::presets::UTF8_FULL_CONDENSED;
use ropewalk::glam::{DQuat, DVec3, Vec3};
use ropewalk::graph::{KeepTransform, Lod, Switch};
use ropewalk::{
    Core, CoreKey, FrameReport, Geometry, GeometryKey, Light, Material, MaterialKey, NodeKey, Renderer,
    RendererOptions, Result, Scene, Transform, View,
};

fn main() -> Result<()> {
    let mut field = PyramidField::new()?;
    let mut renderer = Renderer::new(&RendererOptions::default())?;
    let view = View::framing(&mut field.scene, 160, 120)?;
    println!(
        "{} ({}), {} nodes",
        renderer.device_info().executor,
        renderer.device_info().name,
        field.scene.node_count()
    );

    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header(["edit", "TLAS", "BLAS built", "instances written", "bytes uploaded", "update, ms"]);
    for (name, edit) in EDITS {
        edit(&mut field)?;
        let report = renderer.render(&mut field.scene, &view)?.report().clone();
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

type Edit = fn(&mut PyramidField) -> Result<()>;

/// Every kind of edit, in an order in which each can be applied to the result of those before it.
const EDITS: [(&str, Edit); 20] = [
    ("(first frame)", |_| Ok(())),
    ("nothing", |_| Ok(())),
    ("a name", |field| field.scene.set_name(field.first, "first")),
    ("a transform set to its current value", |field| {
        let local = field.scene.local(field.first)?;
        field.scene.set_local(field.first, local)
    }),
    ("move one", |field| field.scene.set_local(field.first, at(0.0, 1.0, 0.0))),
    ("turn all, by a transform above them", |field| {
        field.scene.set_local(field.pyramids, Transform::from_rotation(DQuat::from_rotation_y(0.1)))
    }),
    ("hide one", |field| field.scene.set_visible(field.first, false)),
    ("show it again", |field| field.scene.set_visible(field.first, true)),
    ("mask one", |field| field.scene.set_mask(field.first, 1)),
    ("a material that a thousand share", |field| {
        field.scene.set_material(field.material, Material::diffuse(Vec3::new(0.9, 0.4, 0.2)))
    }),
    ("a geometry that a thousand share", |field| field.scene.set_geometry(field.geometry, pyramid(1.5))),
    ("add one of the same geometry", |field| {
        let node = field.scene.add(field.scene.root(), at(0.0, 5.0, 0.0))?;
        field.scene.add(node, field.pyramid_core).map(drop)
    }),
    ("another kind of core", |field| field.scene.assign_core(field.first, Core::Group)),
    ("move to another parent, keeping the world transform", |field| {
        field.scene.reparent(field.second, field.scene.root(), KeepTransform::World)
    }),
    ("remove one", |field| field.scene.remove(field.second)),
    ("toggle a switch", |field| {
        let core = field.scene.core_key(field.switch)?;
        field.scene.set_core(core, Core::Switch(Switch::One(1)))
    }),
    ("levels of detail instead of the switch", |field| field.scene.assign_core(field.switch, Lod::by_distance([1e3]))),
    ("override the material of a subtree", |field| {
        let glass = field.scene.add_material(Material::glass(1.5))?;
        field.scene.assign_core(field.group, Core::MaterialGroup(glass))
    }),
    ("a thousand more by one instance of a subtree", |field| {
        let node = field.scene.add(field.scene.root(), at(0.0, 0.0, -60.0))?;
        field.scene.add(node, Core::Instance(field.pyramids)).map(drop)
    }),
    ("a light", |field| {
        let node = field.scene.add(field.scene.root(), at(0.0, 20.0, 0.0))?;
        field.scene.add(node, Light::point(Vec3::ONE, 500.0)).map(drop)
    }),
];

/// A scene of a thousand pyramids of one geometry, and the nodes that the edits change.
struct PyramidField {
    scene: Scene,
    geometry: GeometryKey,
    material: MaterialKey,
    /// The core that all pyramids share.
    pyramid_core: CoreKey,
    /// The transform above the thousand pyramids.
    pyramids: NodeKey,
    first: NodeKey,
    second: NodeKey,
    switch: NodeKey,
    group: NodeKey,
}

impl PyramidField {
    fn new() -> Result<Self> {
        let mut scene = Scene::new();
        let root = scene.root();
        let geometry = scene.add_geometry(pyramid(1.0))?;
        let material = scene.add_material(Material::diffuse(Vec3::splat(0.8)))?;
        let pyramid_core = scene.add_core(Core::Geometry { geometry, material })?;
        let sun = scene.add(root, Transform::looking_at(DVec3::new(2.0, 5.0, 3.0), DVec3::ZERO, DVec3::Y))?;
        scene.add(sun, Light::directional(Vec3::ONE, 3.0))?;

        let pyramids = scene.add(root, Transform::IDENTITY)?;
        let mut transforms = Vec::new();
        for i in 0..1000_u32 {
            let position = at(f64::from(i % 40) * 1.5 - 30.0, 0.0, f64::from(i / 40) * 1.5 - 20.0);
            let node = scene.add(pyramids, position)?;
            scene.add(node, pyramid_core)?;
            transforms.push(node);
        }
        let group = scene.add(root, Core::Group)?;
        let switch = scene.add(group, Switch::One(0))?;
        for i in 0..2 {
            let node = scene.add(switch, at(0.0, 3.0 + f64::from(i), 0.0))?;
            scene.add(node, pyramid_core)?;
        }
        let (first, second) = (transforms[0], transforms[1]);
        Ok(Self { scene, geometry, material, pyramid_core, pyramids, first, second, switch, group })
    }
}

fn at(x: f64, y: f64, z: f64) -> Transform {
    Transform::from_translation(DVec3::new(x, y, z))
}

fn pyramid(height: f32) -> Geometry {
    let corners = [[-0.5, 0.0, -0.5], [0.5, 0.0, -0.5], [0.5, 0.0, 0.5], [-0.5, 0.0, 0.5], [0.0, height, 0.0]];
    Geometry::new(corners.map(Vec3::from_array), [[0, 1, 2], [0, 2, 3], [1, 0, 4], [2, 1, 4], [3, 2, 4], [0, 3, 4]])
}
