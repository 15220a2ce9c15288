//! Top level: build, refit and patch, against the crate `obvhs`.
//!
//! All contenders build over the same random boxes, on all threads, and one function computes the cost of their
//! hierarchies. A build starts from boxes and ends with everything that later updates need.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Parser;
use glam::Vec3;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::ploc::PlocBuilder;
use ropewalk::accel::{Tlas, TlasUpdate};
use ropewalk::device::DeviceBuffer;
use ropewalk::device::layout::{Node, PrimitiveRange};
use ropewalk::math::Aabb;
use ropewalk_bench::{Contender, Options, Report, Target, medians, milliseconds, time};

/// Builds no slower than the fastest of the peer's presets, at no greater cost; refits no slower.
const LARGE: usize = 100_000;
/// Goals for the move of one instance of a million: microseconds, and bytes of changed nodes.
const PATCH_MICROSECONDS: f64 = 50.0;
const PATCH_BYTES: f64 = 800.0;

const PRESETS: [(&str, BvhBuildParams); 3] = [
    ("obvhs fastest", BvhBuildParams::fastest_build()),
    ("obvhs very fast", BvhBuildParams::very_fast_build()),
    ("obvhs fast", BvhBuildParams::fast_build()),
];

fn main() -> ExitCode {
    let options = Options::parse();
    let samples = if options.quick { 5 } else { 15 };
    let mut report = Report::new(&["boxes", "what", "who", "ms", "times ours", "SAH cost"]);
    for count in [10_000, 100_000, 1_000_000] {
        let boxes = random_boxes(count);
        build(&boxes, samples, &mut report);
        refit(&boxes, samples, &mut report);
        patch(boxes, &mut report);
    }
    report.finish(&options)
}

/// Cubes in a cube, of up to the size at which they would fill it.
fn random_boxes(count: usize) -> Vec<Aabb> {
    let mut random = fastrand::Rng::with_seed(1);
    let size = (count as f32).cbrt().recip();
    let cube = |_| {
        let center = Vec3::new(random.f32(), random.f32(), random.f32());
        let half = 0.5 * size * random.f32();
        Aabb { min: center - half, max: center + half }
    };
    (0..count).map(cube).collect()
}

fn peer_boxes(boxes: &[Aabb]) -> Vec<obvhs::aabb::Aabb> {
    boxes.iter().map(|b| obvhs::aabb::Aabb::new(b.min.into(), b.max.into())).collect()
}

fn ours(boxes: &[Aabb]) -> (Tlas, DeviceBuffer<Node>) {
    let (mut tlas, mut nodes) = (Tlas::default(), DeviceBuffer::default());
    tlas.build(&mut nodes, boxes);
    (tlas, nodes)
}

fn peer(boxes: &[obvhs::aabb::Aabb], params: BvhBuildParams) -> Bvh2 {
    build_bvh2(boxes, params, &mut Duration::default())
}

fn build(boxes: &[Aabb], samples: usize, report: &mut Report) {
    let peer_boxes = peer_boxes(boxes);
    let (mut tlas, mut nodes) = ours(boxes);
    let (mut builder, mut bvh) = (PlocBuilder::with_capacity(boxes.len()), Bvh2::zeroed(boxes.len()));
    let peer_boxes = &peer_boxes;
    let mut rebuild_peer = || {
        let indices = (0..boxes.len() as u32).collect();
        let fastest = BvhBuildParams::fastest_build();
        builder.build_with_bvh(&mut bvh, fastest.ploc_search_distance, peer_boxes, indices, fastest.sort_precision, 0);
    };
    let mut costs = vec![our_cost(&nodes), our_cost(&nodes)];
    costs.extend(PRESETS.map(|(_, params)| peer_cost(&peer(peer_boxes, params))));
    costs.push(costs[2]);
    let mut contenders: Vec<Contender> =
        vec![Box::new(|| time(|| ours(boxes))), Box::new(|| time(|| tlas.build(&mut nodes, boxes)))];
    for (_, params) in PRESETS {
        contenders.push(Box::new(move || time(|| peer(peer_boxes, params))));
    }
    contenders.push(Box::new(|| time(&mut rebuild_peer)));
    let times = medians(samples, &mut contenders);
    let names = ["ropewalk", "ropewalk, memory reused"].into_iter().chain(PRESETS.map(|(name, _)| name));
    let names = names.chain(["obvhs fastest, memory reused"]);
    for ((name, &time), cost) in names.zip(&times).zip(&costs) {
        add(report, boxes, "build", name, time, times[0], Some(*cost));
    }
    if boxes.len() >= LARGE {
        let name = boxes.len();
        let ratio = |peer: usize, ours: usize| times[peer].as_secs_f64() / times[ours].as_secs_f64();
        report.goal(format!("build_{name}_against_obvhs_fastest"), ratio(2, 0), Target::AtLeast(1.0), "x");
        report.goal(format!("rebuild_{name}_against_obvhs_fastest"), ratio(5, 1), Target::AtLeast(1.0), "x");
        report.goal(format!("build_{name}_cost"), costs[0] / costs[2], Target::AtMost(1.0), "x");
    }
}

fn refit(boxes: &[Aabb], samples: usize, report: &mut Report) {
    // Two sets of boxes in turn: every box changes every time.
    let moved: Vec<Aabb> =
        boxes.iter().map(|b| Aabb { min: b.min + Vec3::splat(1e-4), max: b.max + Vec3::splat(1e-4) }).collect();
    let sets = [&moved[..], boxes];
    let slots: Vec<u32> = (0..boxes.len() as u32).collect();
    let (mut tlas, mut nodes) = ours(boxes);
    let peer_sets = sets.map(peer_boxes);
    let mut bvh = peer(&peer_sets[1], BvhBuildParams::fastest_build());
    bvh.init_primitives_to_nodes_if_uninit();
    let mut bvh_alone = bvh.clone();
    let [mut our_turn, mut peer_turn] = [1; 2];
    let mut contenders: Vec<Contender> = vec![
        Box::new(|| {
            our_turn ^= 1;
            let (start, update) = (Instant::now(), tlas.update(&mut nodes, sets[our_turn], &slots));
            assert!(matches!(update, TlasUpdate::Refitted { .. }), "{update:?}");
            start.elapsed()
        }),
        Box::new(|| {
            peer_turn ^= 1;
            let start = Instant::now();
            for (node, aabb) in bvh.primitives_to_nodes.iter().zip(&peer_sets[peer_turn]) {
                bvh.nodes[*node as usize].set_aabb(*aabb);
            }
            bvh.refit_all();
            start.elapsed()
        }),
        Box::new(|| time(|| bvh_alone.refit_all())),
    ];
    let times = medians(samples, &mut contenders);
    let names = ["ropewalk", "obvhs, leaves and all", "obvhs, inner nodes only"];
    for (name, &time) in names.into_iter().zip(&times) {
        add(report, boxes, "refit", name, time, times[0], None);
    }
    // Our refit finds the leaves and their boxes itself, so the same work is included in the peer's time.
    let ratio = times[1].as_secs_f64() / times[0].as_secs_f64();
    report.goal(format!("refit_{}_against_obvhs", boxes.len()), ratio, Target::AtLeast(1.0), "x");
}

/// Instances move one after the other, each by its size.
fn patch(mut boxes: Vec<Aabb>, report: &mut Report) {
    const MOVES: usize = 2001;
    let (mut tlas, mut nodes) = ours(&boxes);
    nodes.take_dirty();
    let peer_boxes = peer_boxes(&boxes);
    let mut bvh = peer(&peer_boxes, BvhBuildParams::fastest_build());
    bvh.init_primitives_to_nodes_if_uninit();
    bvh.init_parents_if_uninit();
    let mut random = fastrand::Rng::with_seed(2);
    let (mut times, mut peer_times, mut bytes) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..MOVES {
        let slot = random.usize(..boxes.len());
        let moved = &mut boxes[slot];
        let by = (moved.max - moved.min) * (Vec3::new(random.f32(), random.f32(), random.f32()) - 0.5);
        *moved = Aabb { min: moved.min + by, max: moved.max + by };
        times.push(time(|| tlas.update(&mut nodes, &boxes, &[slot as u32])));
        bytes.push(nodes.take_dirty().iter().map(ExactSizeIterator::len).sum::<usize>() * size_of::<Node>());
        let peer_box = obvhs::aabb::Aabb::new(boxes[slot].min.into(), boxes[slot].max.into());
        peer_times.push(time(|| {
            let node = bvh.primitives_to_nodes[slot] as usize;
            bvh.nodes[node].set_aabb(peer_box);
            bvh.refit_from_fast(node);
        }));
    }
    for sorted in [&mut times, &mut peer_times] {
        sorted.sort_unstable();
    }
    bytes.sort_unstable();
    let [time, peer_time] = [times[MOVES / 2], peer_times[MOVES / 2]];
    add(report, &boxes, "patch one", "ropewalk", time, time, None);
    add(report, &boxes, "patch one", "obvhs", peer_time, time, None);
    if boxes.len() == 1_000_000 {
        report.goal("patch_1000000_time", time.as_secs_f64() * 1e6, Target::AtMost(PATCH_MICROSECONDS), "us");
        report.goal("patch_1000000_bytes_median", bytes[MOVES / 2] as f64, Target::AtMost(PATCH_BYTES), "B");
        report.goal("patch_1000000_bytes_99", bytes[MOVES * 99 / 100] as f64, Target::AtMost(PATCH_BYTES), "B");
    }
}

fn add(report: &mut Report, boxes: &[Aabb], what: &str, who: &str, time: Duration, ours: Duration, cost: Option<f64>) {
    let ratio = time.as_secs_f64() / ours.as_secs_f64();
    report.row([
        boxes.len().to_string(),
        what.into(),
        who.into(),
        milliseconds(time),
        format!("{ratio:.2}"),
        cost.map_or(String::new(), |cost| format!("{cost:.2}")),
    ]);
}

/// A node as the cost sees it: half its area, and its children or how many primitives it holds.
type CostNode = (f64, Result<[usize; 2], u32>);

/// Expected node fetches and primitive tests of a ray that meets the root: the same function for all.
fn sah_cost(node: impl Fn(usize) -> CostNode) -> f64 {
    let root_area = node(0).0;
    let (mut cost, mut stack) = (root_area, vec![0]);
    while let Some(index) = stack.pop() {
        match node(index) {
            (area, Ok(children)) => {
                cost += 2.0 * area;
                stack.extend(children);
            }
            (area, Err(primitives)) => cost += area * f64::from(primitives),
        }
    }
    cost / root_area
}

fn half_area(min: Vec3, max: Vec3) -> f64 {
    let d = max.as_dvec3() - min.as_dvec3();
    d.x * d.y + d.y * d.z + d.z * d.x
}

fn our_cost(nodes: &[Node]) -> f64 {
    sah_cost(|index| {
        let node = &nodes[index];
        let content = match node.primitives {
            PrimitiveRange::INNER => Ok([index + 1, nodes[index + 1].escape_index as usize]),
            leaf => Err(leaf.primitive_count()),
        };
        (half_area(node.min.into(), node.max.into()), content)
    })
}

fn peer_cost(bvh: &Bvh2) -> f64 {
    sah_cost(|index| {
        let node = &bvh.nodes[index];
        let first = node.first_index as usize;
        let content = if node.is_leaf() { Err(node.prim_count) } else { Ok([first, first + 1]) };
        (half_area(node.aabb().min.into(), node.aabb().max.into()), content)
    })
}
