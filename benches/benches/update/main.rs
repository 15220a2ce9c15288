//! Edits of scenes of a thousand to a million nodes: the time until they can be traced again.
//!
//! `propagation`: world transforms, against `bevy_transform` and a plain tree in a slotmap; all move the same nodes to
//! the same places, in turns. `ready`: the whole way from an edit to device arrays. The top level against `obvhs`: the
//! benchmark `tlas`.

#![allow(missing_docs)]

mod memory;
mod propagation;
mod ready;
mod shape;

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use ropewalk_bench::{Options, Report, Target, median, milliseconds};

use crate::propagation::{Bevy, Plain, Propagation, Ropewalk};
use crate::ready::{Compiled, Cost, Edit};
use crate::shape::{HUMANOID, Pose, Shape, choose};

const LARGEST: usize = 1_000_000;
/// The goal when 1 % of a million nodes have moved.
const PROPAGATION_RATIO: f64 = 5.0;
/// Goals when one of a million instances has moved: microseconds until ready, and bytes to copy.
const ONE_MICROSECONDS: f64 = 50.0;
const ONE_BYTES: f64 = 1000.0;
const UNCHANGED_MICROSECONDS: f64 = 1.0;

const HEADER: [&str; 13] = [
    "nodes",
    "shape",
    "edit",
    "count",
    "who",
    "edit ms",
    "propagate ms",
    "times ours",
    "compile ms",
    "top level ms",
    "ready ms",
    "bytes",
    "top level",
];

fn main() -> ExitCode {
    let options = Options::parse();
    let mut report = Report::new(&HEADER);
    let sizes: &[usize] = if options.quick { &[1_000, LARGEST] } else { &[1_000, 10_000, 100_000, LARGEST] };
    let samples = if options.quick { 5 } else { 15 };
    for (what, bytes) in memory::bytes_each(LARGEST).expect("the scene is sound") {
        let mut cells = vec![String::new(); HEADER.len()];
        (cells[0], cells[2], cells[4], cells[11]) =
            (LARGEST.to_string(), what.into(), "ropewalk".into(), bytes.to_string());
        report.row(cells);
    }
    let mut lowest = f64::INFINITY;
    for shape in Shape::ALL {
        for &count in sizes {
            let ratio = propagate(shape, count, samples, &mut report);
            lowest = lowest.min(ratio);
        }
    }
    report.goal("propagation_against_bevy_lowest", lowest, Target::AtLeast(1.0), "x");
    for &count in sizes {
        ready(Shape::Humanoids, count / 2, samples, &mut report);
    }
    ready(Shape::Flat, LARGEST, samples, &mut report);
    report.finish(&options)
}

/// The numbers of nodes that move, for a number of nodes.
fn counts(of: usize) -> Vec<usize> {
    let mut counts = vec![1, 100, of / 100, of];
    counts.sort_unstable();
    counts.dedup();
    counts
}

/// Returns the lowest ratio of the peer's time to ours.
fn propagate(shape: Shape, count: usize, samples: usize, report: &mut Report) -> f64 {
    let mut random = fastrand::Rng::with_seed(1);
    let parents = shape.parents(count);
    let poses: Vec<Pose> = parents.iter().map(|_| Pose::random(&mut random)).collect();
    let mut contenders: [Box<dyn Propagation>; 3] = [
        Box::new(Ropewalk::new(&parents, &poses).expect("the tree is sound")),
        Box::new(Bevy::new(&parents, &poses)),
        Box::new(Plain::new(&parents, &poses)),
    ];
    contenders.iter_mut().for_each(|contender| contender.propagate());
    let mut lowest = f64::INFINITY;
    for moved in counts(count) {
        let mut times = vec![[const { Vec::new() }; 2]; contenders.len()];
        for sample in 0..=samples {
            let chosen = choose(&mut random, moved, count);
            let moves: Vec<_> = chosen.into_iter().map(|node| (node, Pose::random(&mut random))).collect();
            for (contender, times) in contenders.iter_mut().zip(&mut times) {
                let both = propagation::run(&mut **contender, &moves);
                if sample > 0 {
                    times.iter_mut().zip(both).for_each(|(times, time)| times.push(time));
                }
            }
        }
        let times: Vec<[Duration; 2]> = times.into_iter().map(|times| times.map(median)).collect();
        for (contender, [edit, propagate]) in contenders.iter().zip(&times) {
            let ratio = propagate.as_secs_f64() / times[0][1].as_secs_f64();
            report.row([
                count.to_string(),
                shape.name().into(),
                "move".into(),
                moved.to_string(),
                contender.name().into(),
                milliseconds(*edit),
                milliseconds(*propagate),
                format!("{ratio:.2}"),
                String::new(),
                String::new(),
                String::new(),
                String::new(),
                String::new(),
            ]);
        }
        let ratio = times[1][1].as_secs_f64() / times[0][1].as_secs_f64();
        lowest = lowest.min(ratio);
        if count == LARGEST && moved == count / 100 {
            let name = format!("propagation_{}_1_percent_of_1000000_against_bevy", shape.name());
            report.goal(name, ratio, Target::AtLeast(PROPAGATION_RATIO), "x");
        }
    }
    check_agreement(&mut contenders, count, &mut random);
    lowest
}

/// Checks that all contenders compute the same places. The peer computes in f32.
fn check_agreement(contenders: &mut [Box<dyn Propagation>], count: usize, random: &mut fastrand::Rng) {
    for node in choose(random, count.min(1000), count) {
        let [ours, bevy, plain] = [0, 1, 2].map(|i: usize| contenders[i].world(node));
        let tolerance = 1e-3 * (count as f64).sqrt();
        assert!(ours.distance(plain) < 1e-6 && ours.distance(bevy) < tolerance, "{ours} {bevy} {plain}");
    }
}

fn ready(shape: Shape, count: usize, samples: usize, report: &mut Report) {
    let mut random = fastrand::Rng::with_seed(2);
    let count = if shape == Shape::Humanoids { count.next_multiple_of(HUMANOID) } else { count };
    let mut compiled = Compiled::new(shape, count, &mut random).expect("the scene is sound");
    let one_percent = (count / 100).max(1);
    let moves = counts(count).into_iter().map(|moved| vec![(Edit::Move, moved)]);
    let mut plans: Vec<Vec<(Edit, usize)>> = vec![vec![(Edit::Nothing, 0)]];
    plans.extend(moves);
    for edited in [1, one_percent] {
        plans.push(vec![(Edit::Insert, edited), (Edit::Remove, edited)]);
        plans.push(vec![(Edit::Reparent, edited)]);
        plans.push(vec![(Edit::Swap, edited)]);
    }
    plans.push(vec![(Edit::Toggle, 1)]);
    for plan in plans {
        let mut costs = vec![Vec::new(); plan.len()];
        for sample in 0..=samples.max(if plan[0].1 <= 1 { 101 } else { 0 }) {
            for ((edit, edited), costs) in plan.iter().zip(&mut costs) {
                let cost = compiled.measure(*edit, *edited, &mut random).expect("the edit is sound");
                if sample > 0 {
                    costs.push(cost);
                }
            }
        }
        for ((edit, edited), mut costs) in plan.into_iter().zip(costs) {
            costs.sort_by_key(|cost| cost.total);
            let middle = costs[costs.len() / 2];
            row(report, compiled.scene().node_count(), shape, edit, edited, &middle);
            if count == LARGEST {
                goals(report, edit, edited, &middle);
            }
        }
    }
}

fn row(report: &mut Report, nodes: usize, shape: Shape, edit: Edit, edited: usize, cost: &Cost) {
    report.row([
        nodes.to_string(),
        shape.name().into(),
        edit.name().into(),
        edited.to_string(),
        "ropewalk".into(),
        milliseconds(cost.edit),
        milliseconds(cost.propagate),
        String::new(),
        milliseconds(cost.compile),
        milliseconds(cost.tlas),
        milliseconds(cost.total),
        cost.bytes.to_string(),
        // Commas would end a cell of the CSV file.
        cost.update.to_string().replace(',', " and"),
    ]);
}

fn goals(report: &mut Report, edit: Edit, edited: usize, cost: &Cost) {
    let microseconds = cost.total.as_secs_f64() * 1e6;
    match (edit, edited) {
        (Edit::Nothing, _) => report.goal("unchanged_time", microseconds, Target::AtMost(UNCHANGED_MICROSECONDS), "us"),
        (Edit::Move, 1) => {
            report.goal("one_of_1000000_time", microseconds, Target::AtMost(ONE_MICROSECONDS), "us");
            report.goal("one_of_1000000_bytes", cost.bytes as f64, Target::AtMost(ONE_BYTES), "B");
        }
        _ => {}
    }
}
