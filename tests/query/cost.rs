//! The cost of queries in visited nodes: it grows far more slowly than the number of triangles.

use glam::DVec3;
use ropewalk::compile::Compiler;
use ropewalk::math::Bounds;
use ropewalk::query::Overlap;
use ropewalk::query::{Queries, Region};
use ropewalk::{Camera, Core, Geometry, Material, Ray, Scene, Transform, View};

use ropewalk_testkit::{Mesh, Random};

/// A lattice of `side` * `side` * `side` balls of radius 1, with centres 4 apart.
fn field(side: i32, subdivisions: u32) -> Scene {
    let mut scene = Scene::new();
    let mesh = Mesh::displaced_icosphere(subdivisions);
    let geometry = scene.add_geometry(Geometry::new(mesh.positions, mesh.indices)).unwrap();
    let material = scene.add_material(Material::default()).unwrap();
    let core = scene.add_core(Core::Geometry { geometry, material }).unwrap();
    for i in 0..side * side * side {
        let at = DVec3::new(f64::from(i % side), f64::from(i / side % side), f64::from(i / (side * side)));
        let place = scene.add(scene.root(), Transform::from_translation(at * 4.0)).unwrap();
        scene.add(place, core).unwrap();
    }
    scene
}

/// The average number of nodes that a query of one kind visits, of 200 queries.
fn cost(queries: &Queries<'_>, mut query: impl FnMut(&Queries<'_>, &mut Random)) -> u64 {
    const COUNT: u64 = 200;
    let (before, mut random) = (queries.visited_nodes(), Random::new(1));
    for _ in 0..COUNT {
        query(queries, &mut random);
    }
    (queries.visited_nodes() - before) / COUNT
}

/// The average cost of each kind of query.
fn costs(scene: &mut Scene) -> Vec<(&'static str, u64)> {
    let mut compiler = Compiler::new();
    let queries = Queries::new(&mut compiler, scene).unwrap();
    let bounds = queries.bounds();
    let point = |random: &mut Random| bounds.center() + random.in_cube().as_dvec3() * (bounds.max - bounds.min) * 0.5;
    let ray = |random: &mut Random| Ray::new(point(random), random.direction().as_dvec3());
    let around = |random: &mut Random, half: f64| {
        let center = point(random);
        Region::new_box(&Bounds { min: center - half, max: center + half }).unwrap()
    };
    let view = View::look_at(bounds.max * 1.5, bounds.center(), DVec3::Y, Camera::default(), 1000, 1000);
    let mut hits = 0;
    let costs = vec![
        ("closest", cost(&queries, |q, r| hits += usize::from(q.closest_hit(&ray(r)).unwrap().is_some()))),
        ("any", cost(&queries, |q, r| hits += usize::from(q.any_hit(&ray(r)).unwrap()))),
        ("all", cost(&queries, |q, r| hits += q.all_hits(&ray(r)).unwrap().len())),
        ("nearest", cost(&queries, |q, r| hits += usize::from(q.nearest(point(r), f64::INFINITY).unwrap().is_some()))),
        ("containing", cost(&queries, |q, r| hits += q.boxes_containing(point(r)).unwrap().len())),
        ("enclosing", cost(&queries, |q, r| hits += q.solids_containing(point(r)).unwrap().len())),
        ("box, touching", cost(&queries, |q, r| hits += q.overlapping(&around(r, 1.0), Overlap::Touching).len())),
        ("box, inside", cost(&queries, |q, r| hits += q.overlapping(&around(r, 1.0), Overlap::Inside).len())),
        (
            "rubber band",
            cost(&queries, |q, r| {
                let [x, y] = [0, 1].map(|_| r.index(950) as u32);
                let region = view.pixel_frustum(x..x + 50, y..y + 50).unwrap();
                hits += q.overlapping(&region, Overlap::Touching).len();
            }),
        ),
    ];
    assert!(hits > 500, "{hits}");
    costs
}

#[test]
fn queries_visit_few_nodes_of_many_triangles() {
    let mut scene = field(8, 5);
    let triangles = scene.instanced_triangle_count();
    assert_eq!(triangles, 512 * 20_480);
    for (what, visited) in costs(&mut scene) {
        println!("{what}: {visited} nodes visited of {triangles} triangles");
        assert!(visited > 0 && visited < triangles / 10_000, "{what} visits {visited} nodes");
    }
}

#[test]
fn cost_grows_far_slower_than_the_scene() {
    let [mut small, mut large] = [field(4, 3), field(8, 5)];
    for ((what, few), (_, many)) in costs(&mut small).into_iter().zip(costs(&mut large)) {
        // The second scene has 128 times as many triangles.
        assert!(many < few * 8, "{what}: {few} nodes, then {many}");
    }
}
