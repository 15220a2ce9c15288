//! Deforming geometries, and whether their structures are refitted or rebuilt.

#![expect(clippy::unwrap_used, reason = "a panic in a test is a failure")]

use std::sync::Arc;

use glam::{DVec3, Quat, Vec3};
use ropewalk::accel::{Blas, BlasBuildParams};
use ropewalk::compile::{BlasBuildReasons, CompileReport, Compiler, RebuildLimits};
use ropewalk::graph::{BlasKind, Change, ChangeCursor, Changes, Delta, ObjectKey, Quality};
use ropewalk::{Core, Error, Geometry, Material, Scene};

const CORNERS: [Vec3; 4] = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE];

fn two_triangles() -> Geometry {
    Geometry::new(CORNERS, [[0, 1, 2], [1, 3, 2]])
}

#[test]
fn set_positions_keeps_the_triangles_and_can_be_undone() {
    let mut scene = Scene::new();
    let key = scene.add_geometry(two_triangles()).unwrap();
    let material = scene.add_material(Material::default()).unwrap();
    let node = scene.add(scene.root(), Core::Geometry { geometry: key, material }).unwrap();
    let before = scene.geometry(key).unwrap().clone();
    let version = scene.geometry_version(key).unwrap();
    scene.enable_undo();
    let mut cursor = ChangeCursor::default();
    let _ = scene.changes_since(&mut cursor);

    scene.set_positions(key, CORNERS, None).unwrap();
    assert_eq!(scene.changes_since(&mut cursor), Changes::Since(vec![]), "set to what it was");
    scene.set_positions(key, CORNERS.map(|p| p * 2.0), Some(Arc::new([Vec3::Z; 4]))).unwrap();
    let after = scene.geometry(key).unwrap().clone();
    assert!(Arc::ptr_eq(&after.indices, &before.indices));
    assert_eq!((after.positions[3], after.normals.as_deref()), (Vec3::splat(2.0), Some(&[Vec3::Z; 4][..])));
    assert!(scene.geometry_version(key).unwrap() > version);
    assert_eq!(scene.world_bounds(node).unwrap().max, DVec3::splat(2.0), "boxes above follow");
    assert_eq!(scene.changes_since(&mut cursor), Changes::Since(vec![(ObjectKey::Geometry(key), Change::DATA)]));

    scene.set_positions(key, CORNERS, None).unwrap();
    assert_eq!(scene.geometry(key).unwrap().normals, after.normals, "the normals stay");
    scene.end_undo_group("deform");
    scene.undo().unwrap();
    assert_eq!(*scene.geometry(key).unwrap(), before);
    scene.redo().unwrap();
    assert_eq!(scene.geometry(key).unwrap().normals, after.normals);
    scene.validate().unwrap();
}

#[test]
fn bad_positions_are_refused() {
    let mut scene = Scene::new();
    let key = scene.add_geometry(two_triangles()).unwrap();
    let before = format!("{scene:?}");
    let mut broken = CORNERS;
    broken[2].y = f32::INFINITY;
    for (positions, normals, at) in [
        (&CORNERS[..3], None, ("positions", 3)),
        (&broken, None, ("positions", 2)),
        (&CORNERS, Some(&[Vec3::Z; 5][..]), ("normals", 5)),
        (&CORNERS, Some(&[Vec3::NAN; 4]), ("normals", 0)),
    ] {
        match scene.set_positions(key, positions, normals.map(Arc::from)) {
            Err(Error::InvalidGeometry { what, index, .. }) => assert_eq!((what, index), at),
            other => assert!(other.is_err(), "{at:?} was taken"),
        }
    }
    assert_eq!(format!("{scene:?}"), before);
    scene.remove_unused();
    assert!(matches!(scene.set_positions(key, CORNERS, None), Err(Error::StaleKey { .. })));
}

#[test]
fn the_choice_of_a_structure_travels() {
    let mut scene = Scene::new();
    let key = scene.add_geometry(two_triangles().with_blas_kind(BlasKind::KdTree)).unwrap();
    let mut cursor = ChangeCursor::default();
    let mut mirror = Scene::new();
    mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
    assert_eq!(mirror.geometry(key).unwrap().blas_kind, Some(BlasKind::KdTree));

    // A change of the kind of structure alone is a change, too.
    let best = BlasKind::Bvh(Quality::High);
    scene.set_geometry(key, scene.geometry(key).unwrap().clone().with_blas_kind(best)).unwrap();
    mirror.apply(&scene.delta_since(&mut cursor)).unwrap();
    assert_eq!(mirror.geometry(key).unwrap().blas_kind, Some(best), "though all arrays are shared");

    scene.set_geometry(key, scene.geometry(key).unwrap().clone().with_blas_kind(None)).unwrap();
    let delta = scene.delta_since(&mut cursor);
    let delta: Delta = serde_json::from_slice(&serde_json::to_vec(&delta).unwrap()).unwrap();
    mirror.apply(&delta).unwrap();
    assert_eq!(mirror.geometry(key).unwrap().blas_kind, None);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ropewalk");
    scene.set_geometry(key, two_triangles().with_blas_kind(BlasKind::KdTree)).unwrap();
    scene.save(&path).unwrap();
    assert_eq!(Scene::load(&path).unwrap().geometry(key).unwrap().blas_kind, Some(BlasKind::KdTree));
}

/// A sphere with bumps, of 2 * `rows` * 2 * `rows` triangles, all with an area.
fn sphere(rows: u32) -> Geometry {
    let (columns, pi) = (2 * rows, std::f32::consts::PI);
    let point = |i: u32| {
        let (u, v) = ((i % columns) as f32 / rows as f32 * pi, ((i / columns) as f32 + 0.5) / (rows + 1) as f32 * pi);
        Vec3::new(v.sin() * u.cos(), v.cos(), v.sin() * u.sin()) * (1.0 + 0.05 * (u * 9.0).sin() * (v * 7.0).cos())
    };
    let next = |i: u32| if i % columns + 1 == columns { i + 1 - columns } else { i + 1 };
    let triangles = (0..rows * columns).flat_map(|a| {
        let (b, c, d) = (next(a), next(a) + columns, a + columns);
        [[a, b, c], [a, c, d]]
    });
    Geometry::new((0..(rows + 1) * columns).map(point).collect::<Vec<_>>(), triangles.collect::<Vec<_>>())
}

/// Its positions, twisted about the vertical axis.
fn twisted(geometry: &Geometry, turn: f32) -> Vec<Vec3> {
    geometry.positions.iter().map(|p| Quat::from_rotation_y(turn * p.y) * *p).collect()
}

/// A scene of geometries, each with one user, and its compiler.
struct Shown {
    scene: Scene,
    compiler: Compiler,
    keys: Vec<ropewalk::GeometryKey>,
}

/// No builds but those that `set` counts.
fn reasons(set: impl FnOnce(&mut BlasBuildReasons)) -> BlasBuildReasons {
    let mut reasons = BlasBuildReasons::default();
    set(&mut reasons);
    reasons
}

impl Shown {
    fn new(geometries: Vec<Geometry>) -> Self {
        let mut scene = Scene::new();
        let material = scene.add_material(Material::default()).unwrap();
        let keys: Vec<_> = geometries.into_iter().map(|geometry| scene.add_geometry(geometry).unwrap()).collect();
        for &geometry in &keys {
            scene.add(scene.root(), Core::Geometry { geometry, material }).unwrap();
        }
        let mut shown = Self { scene, compiler: Compiler::new(), keys };
        assert_eq!(shown.compile().blas_builds, reasons(|reasons| reasons.new = shown.keys.len()));
        shown
    }

    fn compile(&mut self) -> CompileReport {
        let report = self.compiler.compile(&mut self.scene, DVec3::Z * 9.0).unwrap();
        let again = self.compiler.compile(&mut self.scene, DVec3::Z * 9.0).unwrap();
        assert_eq!((again.blas_refitted, again.blas_built, again.blas_builds), (0, 0, BlasBuildReasons::default()));
        report
    }

    fn twist(&mut self, which: usize, turn: f32) -> CompileReport {
        let positions = twisted(self.scene.geometry(self.keys[which]).unwrap(), turn);
        self.scene.set_positions(self.keys[which], positions, None).unwrap();
        self.compile()
    }

    /// How many nodes, triangles and normals were copied to the device.
    fn written(&mut self) -> [Vec<std::ops::Range<usize>>; 3] {
        let arrays = self.compiler.arrays_mut();
        [arrays.blas_nodes.take_dirty(), arrays.triangles.take_dirty(), arrays.normals.take_dirty()]
    }
}

#[test]
fn a_deformed_geometry_is_refitted_in_its_place() {
    let mut shown = Shown::new(vec![sphere(20), sphere(30), sphere(10)]);
    shown.written();
    let places = shown.compiler.arrays().instances.to_vec();
    let report = shown.twist(1, 0.2);
    assert_eq!((report.blas_refitted, report.blas_refitted_triangles), (1, 3600));
    assert_eq!((report.blas_built, report.blas_freed, report.blas_builds), (0, 0, BlasBuildReasons::default()));
    let after = shown.compiler.arrays().instances.to_vec();
    for (old, new) in places.iter().zip(&after) {
        assert_eq!((old.first_node, old.first_triangle), (new.first_node, new.first_triangle));
    }
    // Only the ranges of this geometry were written.
    let others: Vec<_> = after.iter().map(|instance| instance.first_triangle as usize).collect();
    let [nodes, triangles, normals] = shown.written();
    assert!(!nodes.is_empty() && normals.is_empty());
    let end = others.iter().copied().filter(|&start| start > others[1]).min().unwrap_or(usize::MAX);
    assert!(triangles.iter().all(|range| range.start >= others[1] && range.end <= end), "{triangles:?} {others:?}");
    let count: usize = triangles.iter().map(ExactSizeIterator::len).sum();
    assert_eq!(count, 3600);
}

#[test]
fn each_reason_is_told() {
    let mut shown = Shown::new(vec![sphere(20)]);
    let key = shown.keys[0];
    let original = shown.scene.geometry(key).unwrap().clone();

    // If only normals change, only normals are written.
    let normals: Arc<[Vec3]> = original.positions.iter().map(|p| p.normalize()).collect();
    shown.scene.set_geometry(key, Geometry { normals: Some(normals.clone()), ..original.clone() }).unwrap();
    let report = shown.compile();
    assert_eq!((report.blas_built, report.blas_refitted), (0, 0));
    shown.written();
    let turned: Arc<[Vec3]> = normals.iter().map(|n| -*n).collect();
    shown.scene.set_positions(key, original.positions.clone(), Some(turned.clone())).unwrap();
    shown.compile();
    let [nodes, triangles, written] = shown.written();
    assert!(nodes.is_empty() && triangles.is_empty());
    assert_eq!(written.first(), Some(&(0..3 * normals.len())));
    assert_eq!(shown.compiler.arrays().normals[0].to_bits(), turned[0].x.to_bits());

    // Two corners become equal, and differ again; three corners come to lie on one line, and leave it again:
    // degenerate triangles require a rebuild.
    let all = shown.compiler.arrays().triangles.len();
    let mut pinched = original.positions.to_vec();
    pinched[1] = pinched[0];
    let mut flattened = original.positions.to_vec();
    let [a, b, c] = original.indices[original.indices.len() / 2].map(|v| v as usize);
    (flattened[b], flattened[c]) = (2.0 * flattened[a], 4.0 * flattened[a]);
    for changed in [pinched, flattened] {
        for (positions, count) in [(changed, all - 1), (original.positions.to_vec(), all)] {
            shown.scene.set_positions(key, positions, None).unwrap();
            let report = shown.compile();
            assert_eq!((report.blas_refitted, report.blas_builds.triangles_changed, report.blas_built), (0, 1, 1));
            assert_eq!(shown.compiler.arrays().triangles.len(), count);
        }
    }
    // Other triangles require a rebuild.
    shown.scene.set_geometry(key, sphere(21)).unwrap();
    assert_eq!(shown.compile().blas_builds, reasons(|reasons| reasons.triangles_changed = 1));
    // Another structure requires a build, and one of high quality is not refitted.
    let best = sphere(21).with_blas_kind(BlasKind::Bvh(Quality::High));
    shown.scene.set_geometry(key, best).unwrap();
    assert_eq!(shown.compile().blas_builds, reasons(|reasons| reasons.structure_changed = 1));
    assert_eq!(shown.twist(0, 0.1).blas_builds, reasons(|reasons| reasons.structure_changed = 1));
    let automatic = shown.scene.geometry(key).unwrap().clone().with_blas_kind(None);
    shown.scene.set_geometry(key, automatic).unwrap();
    assert_eq!(shown.compile().blas_built, 0, "what is there will do");
    assert_eq!(shown.twist(0, 0.1).blas_builds, reasons(|reasons| reasons.structure_changed = 1));
    assert_eq!(shown.twist(0, 0.1).blas_refitted, 1);
}

#[test]
fn undo_refits_too() {
    let mut shown = Shown::new(vec![sphere(20)]);
    shown.scene.enable_undo();
    let before = shown.compiler.arrays().triangles.to_vec();
    assert_eq!(shown.twist(0, 0.2).blas_refitted, 1);
    assert_ne!(shown.compiler.arrays().triangles.to_vec(), before);
    shown.scene.undo().unwrap();
    assert_eq!(shown.compile().blas_refitted, 1);
    assert_eq!(shown.compiler.arrays().triangles.to_vec(), before);
}

/// However long a deformation lasts, the structure's cost stays near that of a newly built one.
#[test]
fn what_twists_on_and_on_is_rebuilt_now_and_then() {
    let mut shown = Shown::new(vec![sphere(40)]);
    let params = BlasBuildParams::default();
    let (mut rebuilt, mut refitted, mut worst) = (0, 0, 0.0f64);
    for _ in 0..60 {
        let report = shown.twist(0, 0.2);
        assert_eq!(report.blas_built, report.blas_builds.cost_grown);
        rebuilt += report.blas_built;
        refitted += report.blas_refitted;
        let geometry = shown.scene.geometry(shown.keys[0]).unwrap();
        let fresh = Blas::build(geometry, &params).unwrap();
        // The compiled structure's nodes in place of the new one's, to compare their costs.
        let mut ours = fresh.clone();
        ours.nodes = shown.compiler.arrays().blas_nodes.to_vec();
        worst = worst.max(ours.stats().sah_cost / fresh.stats().sah_cost);
    }
    println!("{rebuilt} built, {refitted} refitted; up to {worst} times the cost of a new one");
    assert!(rebuilt >= 2 && refitted > 2 * rebuilt, "{rebuilt} built, {refitted} refitted");
    assert!(worst < 2.0, "{worst} times the cost of a new one");
}

/// The same deformation under limits: never, as soon as the cost grows, and by default between these.
#[test]
fn limits_say_how_often_is_rebuilt() {
    let default = RebuildLimits::default();
    let rebuilt = [default.with_max_blas_cost_ratio(1.0), default, default.with_max_blas_cost_ratio(f64::INFINITY)]
        .map(|limits| {
            let mut shown = Shown::new(vec![sphere(40)]);
            shown.compiler.set_rebuild_limits(limits);
            (0..40).map(|_| shown.twist(0, 0.2).blas_built).sum::<usize>()
        });
    let [at_once, now_and_then, never] = rebuilt;
    assert!(never == 0 && now_and_then > 0 && at_once > 2 * now_and_then, "{rebuilt:?}");
}

#[test]
fn what_changes_frame_after_frame_is_built_fast() {
    let mut shown = Shown::new(vec![sphere(20)]);
    let nodes_of =
        |rows: u32, quality| Blas::build(&sphere(rows), &BlasBuildParams::new(BlasKind::Bvh(quality))).unwrap().nodes;
    for (i, quality) in [Quality::Medium, Quality::Medium, Quality::Low, Quality::Low].into_iter().enumerate() {
        let rows = 21 + i as u32;
        shown.scene.set_geometry(shown.keys[0], sphere(rows)).unwrap();
        assert_eq!(shown.compile().blas_builds.triangles_changed, 1);
        assert_eq!(shown.compiler.arrays().blas_nodes.to_vec(), nodes_of(rows, quality), "change {i}");
    }
}
