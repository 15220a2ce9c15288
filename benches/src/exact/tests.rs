use super::*;

/// A triangle at x = 2 whose corners are not on axes.
const CORNERS: [[f64; 3]; 3] = [[2.0, 0.0, 0.0], [2.0, 3.0, 0.0], [2.0, 0.0, 3.0]];

fn oracle() -> Oracle {
    Oracle::new(vec![CORNERS.map(DVec3::from_array)], Ends::Open)
}

fn ray(y: f32, z: f32) -> RayRecord {
    RayRecord { origin: [0.0, y, z], t_min: 0.0, direction: [1.0, 0.0, 0.0], t_max: 10.0 }
}

fn place(ray: &RayRecord) -> Option<Place> {
    let nearest = oracle().truth(ray).nearest;
    assert!(nearest.is_none_or(|hit| hit.t == 2.0 && hit.triangle == 0));
    nearest.map(|hit| hit.place)
}

#[test]
fn interior_edges_corners_and_an_ulp_beside_them() {
    assert_eq!(place(&ray(1.0, 1.0)), Some(Place::Interior));
    assert_eq!(place(&ray(0.0, 1.0)), Some(Place::Edge));
    assert_eq!(place(&ray(-0.0, 1.0)), Some(Place::Edge));
    assert_eq!(place(&ray(0.0_f32.next_down(), 1.0)), None);
    assert_eq!(place(&ray(1.25, 1.75)), Some(Place::Edge));
    assert_eq!(place(&ray(1.25, 1.75_f32.next_up())), None);
    assert_eq!(place(&ray(1.25, 1.75_f32.next_down())), Some(Place::Interior));
    let least = f32::from_bits(1);
    for (corner, beside) in [((0.0, 0.0), (0.0, -least)), ((3.0, 0.0), (3.0, -least)), ((0.0, 3.0), (-least, 3.0))] {
        assert_eq!(place(&ray(corner.0, corner.1)), Some(Place::Corner));
        assert_eq!(place(&ray(beside.0, beside.1)), None);
    }
    assert_eq!(place(&ray(3.0_f32.next_up(), 0.0)), None);
    // An edge that only exact arithmetic meets: f64 rounds the corners' differences.
    let corners = [[0.0, 1e-20, 1.0], [1e20, 1e-20, 1.0], [0.0, 2.0, 1.0]].map(DVec3::from_array);
    let oracle = Oracle::new(vec![corners], Ends::Open);
    let up = |y| RayRecord { origin: [1.0, y, 0.0], t_min: 0.0, direction: [0.0, 0.0, 1.0], t_max: 10.0 };
    assert!(oracle.truth(&up(1e-19)).nearest.is_some() && oracle.truth(&up(1e-21)).nearest.is_none());
}

#[test]
fn rays_in_the_plane_and_triangles_without_area_are_not_hit() {
    let along = RayRecord { origin: [2.0, -1.0, 1.0], t_min: 0.0, direction: [0.0, 1.0, 0.0], t_max: 10.0 };
    assert_eq!(oracle().truth(&along), Truth::default());
    let line = [[2.0, 0.0, 0.0], [2.0, 1.0, 1.0], [2.0, 2.0, 2.0]].map(DVec3::from_array);
    assert_eq!(Oracle::new(vec![line], Ends::Open).truth(&ray(1.0, 1.0)), Truth::default());
}

#[test]
fn ends_of_the_range() {
    let until = |t_max| RayRecord { t_max, ..ray(1.0, 1.0) };
    let truth = |ends, ray| Oracle { ends, ..oracle() }.truth(&ray);
    assert!(truth(Ends::Open, until(2.0)).nearest.is_some() && truth(Ends::Open, until(2.0)).must_hit.is_none());
    assert!(truth(Ends::Closed, until(2.0)).must_hit.is_some());
    assert!(truth(Ends::Closed, until(2.0_f32.next_down())).nearest.is_none());
    assert!(truth(Ends::Open, until(2.001)).must_hit.is_some());
}

#[test]
fn verdicts() {
    let behind = CORNERS.map(|[x, y, z]| DVec3::new(x + 1.0, y, z));
    let oracle = Oracle::new(vec![CORNERS.map(DVec3::from_array), behind], Ends::Open);
    let judge = |ray: RayRecord, primitive, t| oracle.judge(&ray, &oracle.truth(&ray), &Hit { primitive, t });
    let inside = ray(1.0, 1.0);
    assert_eq!(judge(inside, 0, 2.0), Verdict::Right(0.0));
    // The nearest corner is farther than t.
    assert_eq!(judge(inside, 0, 2.5), Verdict::Right(0.5 / 6_f64.sqrt()));
    assert_eq!(judge(inside, 1, 3.0), Verdict::WrongTriangle);
    assert_eq!(judge(inside, 7, 3.0), Verdict::WrongTriangle);
    assert_eq!(judge(inside, NONE, 0.0), Verdict::FalseMiss);
    assert_eq!(judge(ray(-1.0, 1.0), NONE, 0.0), Verdict::RightMiss);
    assert_eq!(judge(ray(-1.0, 1.0), 0, 2.0), Verdict::FalseHit);
    assert_eq!(judge(ray(-1e-6, 1.0), 0, 2.0), Verdict::RightByTolerance);
    assert_eq!(judge(ray(-1e-4, 1.0), 0, 2.0), Verdict::FalseHit);
    // The triangle behind is hit by rays whose range starts between the two, as is nothing by rays that end there.
    let from = RayRecord { t_min: 2.5, ..inside };
    assert_eq!(judge(from, 1, 3.0), Verdict::Right(0.0));
    assert_eq!(judge(from, 0, 2.0), Verdict::WrongTriangle);
    assert_eq!(judge(RayRecord { t_max: 1.0, ..inside }, 0, 2.0), Verdict::FalseHit);
}

#[test]
fn a_surface_is_crossed_at_its_edges_and_touched_at_its_rim() {
    // A fan of four around (2, 1, 1), and a fold at its edge y = 0.
    let [center, a, b, c, d] = [[2.0, 1.0, 1.0], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0], [2.0, 2.0, 2.0], [2.0, 0.0, 2.0]];
    let fold = [3.0, 1.0, 1.0];
    let triangles = [[center, a, b], [center, b, c], [center, c, d], [center, d, a], [fold, d, a]];
    let oracle = Oracle::new(triangles.map(|corners| corners.map(DVec3::from_array)).to_vec(), Ends::Open);
    let must_hit = |y, z| oracle.truth(&ray(y, z)).must_hit;
    let is_met = |y, z| oracle.truth(&ray(y, z)).nearest.is_some();
    assert_eq!(must_hit(1.0, 1.0), Some(2.0));
    assert_eq!(must_hit(0.5, 0.5), Some(2.0));
    for (y, z) in [(1.0, 0.0), (0.0, 1.0), (0.0, 0.0), (2.0, 2.0)] {
        assert!(is_met(y, z) && must_hit(y, z).is_none(), "{y} {z}");
    }
}

fn right(met: Meeting) -> Hit {
    Hit { primitive: met.triangle, t: met.t }
}

/// A sphere from within, traced by the oracle itself, with every hundredth answer made wrong.
#[test]
fn planted_faults_are_counted() {
    let geometry = crate::shapes::sphere(24, 48);
    let corners = |triangle: &[u32; 3]| triangle.map(|vertex| geometry.positions[vertex as usize].as_dvec3());
    let oracle = Oracle::new(geometry.indices.iter().map(corners).collect(), Ends::Open);
    let mut random = fastrand::Rng::with_seed(9);
    let mut number = || random.f32() - 0.5;
    let mut vector = || [0; 3].map(|_| number());
    let rays: Vec<RayRecord> =
        (0..10_000).map(|_| RayRecord { origin: vector(), t_min: 0.0, direction: vector(), t_max: f32::MAX }).collect();
    let truths = oracle.truths(&rays);
    let count = |answer: fn(usize, Meeting) -> Hit, verdict: fn(&Verdict) -> bool| {
        let judged = rays.iter().zip(&truths).enumerate().map(|(i, (ray, truth))| {
            oracle.judge(ray, truth, &answer(i, truth.nearest.expect("the sphere is closed")))
        });
        judged.filter(verdict).count()
    };
    let is_fault = |v: &Verdict| matches!(v, Verdict::FalseMiss | Verdict::FalseHit | Verdict::WrongTriangle);
    assert_eq!(count(|_, met| right(met), is_fault), 0);
    let dropped = |i, met| if i % 100 == 0 { Hit::MISS } else { right(met) };
    assert_eq!(count(dropped, |v| *v == Verdict::FalseMiss), 100);
    // The triangle half way around the list is on the other half of the sphere.
    let across = |i, met: Meeting| match i % 100 {
        0 => Hit { primitive: (met.triangle + 1104) % 2208, ..right(met) },
        _ => right(met),
    };
    assert_eq!(count(across, |v| *v == Verdict::WrongTriangle), 100);
}
