//! The effect of each kind of core on the image.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use glam::{DQuat, DVec3, Vec3};
use ropewalk::compile::{Compiler, Viewpoint};
use ropewalk::graph::{Billboard, Hierarchy, KeepTransform, Lod, Switch};
use ropewalk::{
    Camera, Core, DeviceChoice, Error, Geometry, GeometryKey, Light, Material, MaterialKey, NodeKey, Renderer,
    RendererOptions, Scene, Transform, View,
};

const SIZE: u32 = 33;

/// A square from -1 to 1 in the plane z = 0, facing +Z.
fn square(scene: &mut Scene) -> GeometryKey {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| Vec3::new(x, y, 0.0));
    scene.add_geometry(Geometry::new(corners, [[0, 1, 2], [0, 2, 3]])).unwrap()
}

fn material(scene: &mut Scene) -> MaterialKey {
    scene.add_material(Material::default()).unwrap()
}

/// Squares below `parent`, all in the same place.
fn squares(scene: &mut Scene, parent: NodeKey, count: usize) -> Vec<NodeKey> {
    let (geometry, material) = (square(scene), material(scene));
    (0..count).map(|_| scene.add(parent, Core::Geometry { geometry, material }).unwrap()).collect()
}

fn at(x: f64, y: f64, z: f64) -> Transform {
    Transform::from_translation(DVec3::new(x, y, z))
}

fn view_from(eye: DVec3) -> View {
    View { aovs: true, ..View::look_at(eye, DVec3::ZERO, DVec3::Y, Camera::default(), SIZE, SIZE) }
}

fn cpu() -> Renderer {
    Renderer::new(&RendererOptions::default().with_device(DeviceChoice::Cpu)).unwrap()
}

/// The node seen at the centre of the image.
fn seen(renderer: &mut Renderer, scene: &mut Scene, eye: DVec3) -> Option<NodeKey> {
    let image = renderer.render(scene, &view_from(eye)).unwrap().image().unwrap();
    image.node_at(SIZE / 2, SIZE / 2)
}

#[test]
fn a_switch_shows_what_it_chooses() {
    let mut scene = Scene::new();
    let switch = scene.add(scene.root(), Switch::One(1)).unwrap();
    let children = squares(&mut scene, switch, 3);
    let (key, eye) = (scene.core_key(switch).unwrap(), DVec3::Z * 5.0);
    let mut renderer = cpu();
    assert_eq!(seen(&mut renderer, &mut scene, eye), Some(children[1]));

    scene.set_core(key, Core::Switch(Switch::One(2))).unwrap();
    assert_eq!(seen(&mut renderer, &mut scene, eye), Some(children[2]));
    for (switch, shown) in [
        (Switch::None, None),
        (Switch::One(7), None),
        (Switch::Set([2, 9].into()), Some(children[2])),
        // Of surfaces at the same place, the instance with the lower index is hit.
        (Switch::All, Some(children[0])),
    ] {
        scene.set_core(key, Core::Switch(switch.clone())).unwrap();
        assert_eq!(seen(&mut renderer, &mut scene, eye).is_some(), shown.is_some(), "{switch:?}");
    }

    // `Switch::One` counts children by position, so it shows another child after one is removed or added.
    scene.set_core(key, Core::Switch(Switch::One(1))).unwrap();
    scene.remove(children[0]).unwrap();
    assert_eq!(seen(&mut renderer, &mut scene, eye), Some(children[2]));
    scene.reparent(children[1], scene.root(), KeepTransform::Local).unwrap();
    assert_eq!(seen(&mut renderer, &mut scene, eye), Some(children[1]), "nobody hides it any more");
    // A switch that becomes a group shows all its children.
    scene.remove(children[1]).unwrap();
    assert_eq!(seen(&mut renderer, &mut scene, eye), None);
    scene.set_core(key, Core::Group).unwrap();
    assert_eq!(seen(&mut renderer, &mut scene, eye), Some(children[2]));
    scene.validate().unwrap();
}

#[test]
fn of_material_groups_the_outermost_counts() {
    let mut scene = Scene::new();
    let colors = [Vec3::X, Vec3::Y, Vec3::Z].map(|color| Material { unlit: true, ..Material::diffuse(color) });
    let [own, inner, outer] = colors.map(|material| scene.add_material(material).unwrap());
    let outer_group = scene.add(scene.root(), Core::MaterialGroup(outer)).unwrap();
    let between = scene.add(outer_group, at(0.0, 0.0, 0.0)).unwrap();
    let inner_group = scene.add(between, Core::MaterialGroup(inner)).unwrap();
    let geometry = square(&mut scene);
    scene.add(inner_group, Core::Geometry { geometry, material: own }).unwrap();
    let mut renderer = cpu();
    let mut color = |scene: &mut Scene| {
        let frame = renderer.render(scene, &view_from(DVec3::Z * 5.0)).unwrap();
        let pixel = frame.image().unwrap().color[(SIZE * SIZE / 2) as usize];
        Vec3::new(pixel[0], pixel[1], pixel[2])
    };
    assert_eq!(color(&mut scene), Vec3::Z);
    scene.assign_core(outer_group, Core::Group).unwrap();
    assert_eq!(color(&mut scene), Vec3::Y);
    scene.assign_core(inner_group, Core::Group).unwrap();
    assert_eq!(color(&mut scene), Vec3::X);
    assert!(scene.material(outer).is_err(), "a material group was its only user");
}

/// A prototype with a light in it, instanced by prototypes that are themselves instanced, compared with the same scene
/// made of copies.
#[test]
fn instances_of_instances_look_like_copies() {
    let place = |i: usize| Transform::Trs {
        translation: DVec3::new(i as f64 - 1.0, 0.3 * i as f64, 0.0),
        rotation: DQuat::from_rotation_y(0.4 * i as f64),
        scale: DVec3::new(0.4, 0.3, 0.5),
    };
    let leaf = |scene: &mut Scene, parent, geometry, material| {
        let turn = scene.add(parent, Transform::from_rotation(DQuat::from_rotation_z(0.3))).unwrap();
        scene.add(turn, Core::Geometry { geometry, material }).unwrap();
        let lamp = scene.add(parent, at(0.0, 0.0, 2.0)).unwrap();
        scene.add(lamp, Light::point(Vec3::ONE, 3.0)).unwrap();
    };

    let mut copies = Scene::new();
    let (geometry, own) = (square(&mut copies), material(&mut copies));
    for i in 0..3 {
        let row = copies.add(copies.root(), place(i)).unwrap();
        for j in 0..3 {
            let parent = copies.add(row, place(j)).unwrap();
            leaf(&mut copies, parent, geometry, own);
        }
    }

    let mut scene = Scene::new();
    let (geometry, own) = (square(&mut scene), material(&mut scene));
    let hidden = scene.add(scene.root(), Core::Group).unwrap();
    scene.set_visible(hidden, false).unwrap();
    let prototype = scene.add(hidden, Core::Group).unwrap();
    let rows = scene.add(hidden, Core::Group).unwrap();
    for i in 0..3 {
        let parent = scene.add(scene.root(), place(i)).unwrap();
        scene.add(parent, Core::Instance(rows)).unwrap();
        let parent = scene.add(rows, place(i)).unwrap();
        scene.add(parent, Core::Instance(prototype)).unwrap();
    }
    // In the scene, the instances come before the nodes that they instance.
    leaf(&mut scene, prototype, geometry, own);

    let view = view_from(DVec3::new(1.0, 1.0, 4.0));
    let (mut one, mut other) = (cpu(), cpu());
    let check = |one: &mut Renderer, other: &mut Renderer, scene: &mut Scene, copies: &mut Scene| {
        let frame = one.render(scene, &view).unwrap();
        let found = (frame.report().compile.clone(), frame.image().unwrap());
        let frame = other.render(copies, &view).unwrap();
        let expected = (frame.report().compile.clone(), frame.image().unwrap());
        assert_eq!((found.0.instances, found.0.lights, found.0.blas_count), (9, 9, 1));
        assert_eq!((expected.0.instances, expected.0.lights), (9, 9));
        let hits = found.1.color.iter().filter(|c| **c != found.1.color[0]).count();
        assert!(hits > 50, "{hits} pixels show something");
        assert_eq!(found.1.color, expected.1.color);
    };
    check(&mut one, &mut other, &mut scene, &mut copies);

    // An edit of the prototype changes all nine appearances, and each has a path of its own.
    let (scene_, hierarchy) = scene.with_hierarchy().unwrap();
    let lamp = scene_.children(prototype).unwrap().last().unwrap();
    assert_eq!(hierarchy.entries(lamp).count(), 1 + 3 + 9);
    let paths: std::collections::HashSet<_> = hierarchy.entries(lamp).map(|entry| hierarchy.path(entry)).collect();
    assert_eq!(paths.len(), 13);
    scene.remove(rows).unwrap();
    let report = one.render(&mut scene, &view).unwrap().report().clone();
    assert_eq!((report.compile.instances, report.compile.lights), (0, 0));
    scene.validate().unwrap();
}

#[test]
fn nobody_instances_itself() {
    let mut scene = Scene::new();
    let a = scene.add(scene.root(), Core::Group).unwrap();
    let b = scene.add(scene.root(), Core::Group).unwrap();
    let in_a = scene.add(a, Core::Instance(b)).unwrap();
    let is_cycle = |result: Result<(), Error>| assert!(matches!(result, Err(Error::Cycle { .. })), "{result:?}");
    is_cycle(scene.add(b, Core::Instance(a)).map(drop));
    is_cycle(scene.add(b, Core::Instance(scene.root())).map(drop));
    is_cycle(scene.reparent(a, b, KeepTransform::Local));
    is_cycle(scene.assign_core(b, Core::Instance(a)));
    let key = scene.core_key(in_a).unwrap();
    is_cycle(scene.add(b, key).map(drop));
    is_cycle(scene.set_core(key, Core::Instance(a)));
    scene.remove(in_a).unwrap();
    scene.add(b, Core::Instance(a)).unwrap();
    scene.validate().unwrap();
}

/// 40 groups, each of which shows the next one twice: more than a trillion entries.
#[test]
fn instances_that_multiply_are_refused_before_they_take_memory() {
    let mut scene = Scene::new();
    let groups: Vec<NodeKey> = (0..40).map(|_| scene.add(scene.root(), Core::Group).unwrap()).collect();
    for pair in groups.windows(2) {
        scene.add(pair[0], Core::Instance(pair[1])).unwrap();
        scene.add(pair[0], Core::Instance(pair[1])).unwrap();
    }
    let limit = Hierarchy::MAX_INSTANCED as u64 + scene.node_count() as u64;
    let is_limit =
        |error: Error| matches!(error, Error::Limit { limit: l, needed, .. } if l == limit && needed > 1 << 40);
    assert!(is_limit(scene.hierarchy().unwrap_err()));
    assert!(is_limit(scene.world_bounds(scene.root()).unwrap_err()));
    assert!(is_limit(Compiler::new().compile(&mut scene, DVec3::ZERO).unwrap_err()));
    assert!(scene.world_from_local(groups[7]).is_ok(), "what needs no entries still answers");

    for &group in &groups[10..] {
        scene.remove(group).unwrap();
    }
    // Entries: 2^10 - 1 for what the first group shows, 2^9 - 1 for the second, and so on; each for the groups and
    // their instances.
    assert!(scene.hierarchy().unwrap().nodes().len() > 1 << 10);
    scene.validate().unwrap();
}

/// An instance of an instance: the outer one disappears together with the inner one, in the same update.
#[test]
fn instances_change_and_move_in_one_go() {
    let mut scene = Scene::new();
    let root = scene.root();
    let [one, other] = [0; 2].map(|_| scene.add(root, Core::Group).unwrap());
    let inner = scene.add(root, Core::Instance(one)).unwrap();
    scene.add(root, Core::Instance(inner)).unwrap();
    scene.hierarchy().unwrap();
    scene.assign_core(inner, Core::Instance(other)).unwrap();
    scene.reparent(inner, one, KeepTransform::Local).unwrap();
    scene.hierarchy().unwrap();
    scene.validate().unwrap();
    let shown = scene.hierarchy().unwrap().entries(other).count();
    // At its own place, below the inner instance, and below the outer instance's inner one.
    assert_eq!(shown, 3);
}

/// Ten thousand instances of a tree with levels of detail are edited and removed in no more than linear time.
#[test]
fn a_forest_is_planted_edited_and_felled() {
    let mut scene = Scene::new();
    let root = scene.root();
    let hidden = scene.add(root, Core::Group).unwrap();
    scene.set_visible(hidden, false).unwrap();
    let tree = scene.add(hidden, Lod::by_distance([1e9])).unwrap();
    squares(&mut scene, tree, 2);
    let count = 10_000;
    for i in 0..count {
        let place = scene.add(root, at(f64::from(i), 0.0, 0.0)).unwrap();
        scene.add(place, Core::Instance(tree)).unwrap();
    }
    let mut compiler = Compiler::new();
    assert_eq!(compiler.compile(&mut scene, DVec3::Z).unwrap().instances, count as usize);
    let twig = squares(&mut scene, tree, 1)[0];
    assert_eq!(compiler.compile(&mut scene, DVec3::Z).unwrap().instances, count as usize);
    scene.remove(twig).unwrap();
    assert_eq!(compiler.compile(&mut scene, DVec3::Z).unwrap().instances, count as usize);
    scene.remove(tree).unwrap();
    assert_eq!(compiler.compile(&mut scene, DVec3::Z).unwrap().instances, 0);
    scene.validate().unwrap();
}

#[test]
fn levels_of_detail_suit_the_distance_of_each_camera() {
    let mut scene = Scene::new();
    let lod = Lod { hysteresis: 0.1, ..Lod::by_distance([10.0, 20.0]) };
    let node = scene.add(scene.root(), lod).unwrap();
    let children = squares(&mut scene, node, 2);
    let (mut near, mut far) = (cpu(), cpu());
    let eye = |distance: f64| DVec3::Z * distance;
    assert_eq!(seen(&mut near, &mut scene, eye(5.0)), Some(children[0]));
    assert_eq!(seen(&mut far, &mut scene, eye(15.0)), Some(children[1]));
    assert_eq!(seen(&mut near, &mut scene, eye(5.0)), Some(children[0]));
    // Beyond the last limit there is no third child.
    assert_eq!(seen(&mut far, &mut scene, eye(30.0)), None);
    // The nearer level stays until 11, the farther one until 9.
    for (distance, child) in [(9.9, 0), (10.9, 0), (11.1, 1), (9.1, 1), (8.9, 0)] {
        assert_eq!(seen(&mut near, &mut scene, eye(distance)), Some(children[child]), "at {distance}");
    }
    // A node added below a level that is not shown is not compiled.
    let more = squares(&mut scene, children[1], 1);
    assert_eq!(seen(&mut near, &mut scene, eye(5.0)), Some(children[0]));
    scene.remove(children[0]).unwrap();
    assert!(children[1..].iter().chain(&more).any(|&node| seen(&mut near, &mut scene, eye(5.0)) == Some(node)));
    assert_eq!(seen(&mut near, &mut scene, eye(15.0)), None);
}

#[test]
fn levels_of_detail_suit_the_size_in_the_image() {
    let mut scene = Scene::new();
    // A sphere of radius 2 after scaling fills the image of a 90 degree camera at distance 2.
    let scale = scene.add(scene.root(), Transform::from_scale(DVec3::new(1.0, 2.0, 1.0))).unwrap();
    let node = scene.add(scale, Lod::by_projected_size(1.0, [0.5])).unwrap();
    squares(&mut scene, node, 2);
    let instances = |scene: &mut Scene, viewpoint: Viewpoint| {
        let mut compiler = Compiler::new();
        compiler.compile(scene, viewpoint).unwrap();
        let hierarchy = scene.hierarchy().unwrap();
        let shown = (0..2).find_map(|slot| compiler.instance_source(slot, hierarchy)).unwrap().path.node;
        scene.children(node).unwrap().position(|child| child == shown)
    };
    let at = |distance: f64| {
        let camera = Camera::perspective(std::f32::consts::FRAC_PI_2);
        View { camera, ..view_from(DVec3::Z * distance) }.viewpoint()
    };
    assert_eq!(instances(&mut scene, at(3.99)), Some(0));
    assert_eq!(instances(&mut scene, at(4.01)), Some(1));
    let orthographic =
        |half| View { camera: Camera::orthographic(half, half), ..view_from(DVec3::Z * 100.0) }.viewpoint();
    assert_eq!(instances(&mut scene, orthographic(3.99)), Some(0));
    assert_eq!(instances(&mut scene, orthographic(4.01)), Some(1));
}

#[test]
fn billboards_face_each_camera() {
    let mut scene = Scene::new();
    let place = Transform::from_rotation(DQuat::from_rotation_x(0.7)).with_translation(DVec3::new(0.1, 0.2, 0.3));
    let place = scene.add(scene.root(), place).unwrap();
    let board = scene.add(place, Billboard::Spherical).unwrap();
    // Nodes below a billboard move as elsewhere.
    let below = scene.add(board, at(0.0, 0.0, 0.0)).unwrap();
    squares(&mut scene, below, 1);
    let center = scene.world_from_local(board).unwrap().translation;
    let mut renderer = cpu();
    let eyes = [DVec3::new(4.0, 1.0, 3.0), DVec3::new(-3.0, 2.0, -4.0), DVec3::new(0.3, -5.0, 0.2)];
    for eye in eyes {
        let view = View { aovs: true, ..View::look_at(eye, center, DVec3::Y, Camera::default(), SIZE, SIZE) };
        let image = renderer.render(&mut scene, &view).unwrap().image().unwrap();
        let normal = image.aovs.unwrap().normal[(SIZE * SIZE / 2) as usize];
        let to_eye = (eye - center).normalize().as_vec3();
        assert!(Vec3::from(normal).dot(to_eye) > 0.999_99, "{normal:?} does not look at {to_eye}");
    }
    // A cylindrical billboard turns about its axis only.
    scene.assign_core(board, Billboard::Cylindrical(DVec3::Y)).unwrap();
    scene.set_local(place, at(0.0, 0.0, 0.0)).unwrap();
    let image = renderer.render(&mut scene, &view_from(DVec3::new(3.0, 3.0, 0.0))).unwrap().image().unwrap();
    let normal = Vec3::from(image.aovs.unwrap().normal[(SIZE * SIZE / 2) as usize]);
    assert!(normal.abs_diff_eq(Vec3::X, 1e-5), "{normal}");
    // Billboards are evaluated by the compiler: the scene graph itself does not change.
    assert_eq!(scene.world_from_local(below).unwrap().translation, DVec3::ZERO);
}
