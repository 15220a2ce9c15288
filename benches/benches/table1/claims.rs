//! The paper's three claims, checked against times and counts.

use ropewalk::device::DeviceArrays;
use ropewalk::device::layout::NONE;
use ropewalk::trace::{Emulated, Recursive, Tracer as _, Traversal, TraversalCounts};
use ropewalk_bench::Result;
use ropewalk_bench::rays::{RayKind, RaySets};
use ropewalk_bench::scenes::BenchScene;

use crate::{Measured, PaperColumn, Setting};

/// "2.5 to 9 times as fast": the paper's least gain of arrays over pointers.
const LEAST_GAIN: f64 = 2.5;
/// The paper's largest exponent of a frame's time in the number of triangles: CUDA's, sphere to dragon.
const HARDLY: f64 = 0.31;
const NEAR: Setting = Setting { is_far: false, has_shadows: true };
const FAR: Setting = Setting { is_far: true, has_shadows: true };

/// The cost of the same rays in the same structure, traversed by pointers and by arrays.
pub struct Walks {
    scene: &'static str,
    kinds: Vec<(RayKind, usize, [TraversalCounts; 2])>,
}

impl Walks {
    /// Counts closest hits of coherent and of incoherent rays.
    pub fn count(scene: &BenchScene, paper: &mut DeviceArrays) -> Result<Self> {
        let mut recursive = Recursive::default();
        recursive.upload(paper)?;
        let ropes = Emulated::default().with_traversal(Traversal::Rope);
        let sets = RaySets::new(scene)?;
        let kinds = [RayKind::Primary, RayKind::Diffuse].map(|kind| {
            let rays = sets.of(kind);
            let by_pointers = recursive.count_closest_hits(paper, rays, NONE);
            (kind, rays.len(), [by_pointers, ropes.count_closest_hits(paper, rays, NONE)])
        });
        Ok(Self { scene: scene.name, kinds: kinds.into() })
    }
}

/// Each claim: whether it holds, and the figures that say so.
pub fn claims(measured: &[Measured], walks: &[Walks]) -> Vec<String> {
    let mut lines = arrays_against_pointers(measured, walks);
    lines.extend(triangle_count(measured));
    lines.extend(primary_hits(measured));
    lines
}

fn verdict(holds: bool) -> &'static str {
    if holds { "reproduced" } else { "refuted" }
}

fn arrays_against_pointers(measured: &[Measured], walks: &[Walks]) -> Vec<String> {
    let of = |column| measured.iter().filter(move |figure| figure.paper_column == Some(column));
    let gains = of(PaperColumn::Emulated).filter_map(|arrays| {
        let pointers = of(PaperColumn::Recursive)
            .find(|pointers| (pointers.scene, pointers.setting) == (arrays.scene, arrays.setting))?;
        Some((arrays.scene, arrays.setting, pointers.seconds / arrays.seconds))
    });
    let gains: Vec<_> = gains.collect();
    let holds = gains.iter().all(|(.., gain)| *gain >= LEAST_GAIN);
    let mut lines =
        vec![format!("CLAIM arrays are 2.5 to 9 times as fast as pointers, one thread: {}", verdict(holds))];
    for (scene, setting, gain) in gains {
        lines.push(format!("    {scene}, {setting}: {gain:.2} times"));
    }
    for Walks { scene, kinds } in walks {
        for (kind, rays, [pointers, arrays]) in kinds {
            let a_ray = |count: u64| count as f64 / *rays as f64;
            lines.push(format!(
                "    {scene}, {} rays: by pointers {:.1} nodes and {:.1} triangles a ray, by arrays {:.1} and {:.1}",
                kind.name(),
                a_ray(pointers.nodes),
                a_ray(pointers.triangles),
                a_ray(arrays.nodes),
                a_ray(arrays.triangles),
            ));
        }
    }
    lines
}

/// The smallest and the largest scene from the usual distance, with shadows.
fn triangle_count(measured: &[Measured]) -> Vec<String> {
    let near: Vec<_> = measured.iter().filter(|figure| figure.setting == NEAR).collect();
    let counts = || near.iter().map(|figure| figure.triangles);
    let (Some(least), Some(most)) = (counts().min(), counts().max()) else { return Vec::new() };
    let exponent = |[small, large]: [f64; 2]| (large / small).ln() / (most as f64 / least as f64).ln();
    let mut cases = Vec::new();
    let mut held = 0;
    for small in near.iter().filter(|figure| figure.triangles == least) {
        let same = |figure: &&&Measured| figure.triangles == most && figure.executor == small.executor;
        let Some(large) = near.iter().find(same) else { continue };
        let [a_frame, a_ray] = [[small.seconds, large.seconds], [small, large].map(|f| f.a_ray(f.seconds * 1e9))];
        let nodes = [small, large].map(|figure| figure.a_ray(figure.counts.cost.nodes as f64));
        held += usize::from(exponent(a_frame) <= HARDLY);
        let counted = if nodes[0] > 0.0 {
            format!(", {:.1} to {:.1} nodes, exponent {:.2}", nodes[0], nodes[1], exponent(nodes))
        } else {
            String::new()
        };
        cases.push(format!(
            "    {}, {} to {}: a frame takes {:.2} times as long, exponent {:.2}; a ray {:.0} to {:.0} ns, exponent {:.2}{counted}",
            small.executor,
            small.scene,
            large.scene,
            a_frame[1] / a_frame[0],
            exponent(a_frame),
            a_ray[0],
            a_ray[1],
            exponent(a_ray),
        ));
    }
    let (verdict, all) = (verdict(held == cases.len()), cases.len());
    let mut lines = vec![format!(
        "CLAIM triangle count hardly matters: {verdict}, time grows by an exponent of {HARDLY} or less, as the paper's own does, in {held} of {all} executors"
    )];
    lines.extend(cases);
    lines
}

/// Each scene from twice the distance against each smaller one from the usual.
fn primary_hits(measured: &[Measured]) -> Vec<String> {
    let with = |setting| measured.iter().filter(move |figure| figure.setting == setting);
    let counted = |setting| with(setting).filter(|figure| figure.paper_column == Some(PaperColumn::Emulated));
    let mut lines = Vec::new();
    let [mut faster, mut all] = [0, 0];
    for large in counted(FAR) {
        for small in counted(NEAR).filter(|small| small.triangles < large.triangles) {
            lines.push(format!("    {}; {}", told(large), told(small)));
            for large in with(FAR).filter(|figure| figure.scene == large.scene) {
                let same = |figure: &&Measured| figure.scene == small.scene && figure.executor == large.executor;
                let Some(small) = with(NEAR).find(same) else { continue };
                let gain = small.seconds / large.seconds;
                faster += usize::from(gain > 1.0);
                all += 1;
                lines.push(format!("        {}: the larger is {gain:.2} times as fast", large.executor));
            }
        }
    }
    let verdict = verdict(faster > 0);
    lines.insert(
        0,
        format!(
            "CLAIM a larger scene can be faster when fewer primary rays hit it: {verdict}, in {faster} of {all} cases"
        ),
    );
    lines
}

/// The counts that explain a time.
fn told(figure: &Measured) -> String {
    let counts = figure.counts;
    format!(
        "{} from {}: {} primary rays hit, {} rays in all, {:.1} nodes a ray",
        figure.scene,
        figure.setting,
        counts.primary_hits,
        counts.radiance_rays + counts.shadow_rays,
        figure.a_ray(counts.cost.nodes as f64),
    )
}
