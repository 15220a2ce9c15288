//! The builders of the crates `obvhs`, `bvh` and `parry3d`.

use std::time::Duration;

use bvh::bounding_hierarchy::BoundingHierarchy as _;
use glam::Vec3;
use nalgebra::Point3;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::rt_triangle::RtTriangle;
use parry3d::shape::TriMesh;
use ropewalk_bench::bvh_shape::Shape;
use ropewalk_bench::time;

use crate::cost::{CostNode, half_area, sah_cost};

/// A builder.
pub struct Peer {
    pub name: &'static str,
    pub time: fn(&[[Vec3; 3]]) -> Duration,
    pub build: fn(&[[Vec3; 3]]) -> Tree,
}

/// What it has built.
pub enum Tree {
    Obvhs(Bvh2),
    Bvh(bvh::bvh::Bvh<f32, 3>),
    /// It cannot be read.
    Hidden,
}

macro_rules! obvhs {
    ($name:literal, $preset:ident) => {
        Peer {
            name: $name,
            time: |triangles| {
                let triangles = of_obvhs(triangles);
                time(|| {
                    let bvh = build_bvh2_from_tris(&triangles, BvhBuildParams::$preset(), &mut Duration::default());
                    let in_order = bvh.primitive_indices.iter().map(|&i| (&triangles[i as usize]).into());
                    (in_order.collect::<Vec<RtTriangle>>(), bvh)
                })
            },
            build: |triangles| {
                let triangles = of_obvhs(triangles);
                Tree::Obvhs(build_bvh2_from_tris(&triangles, BvhBuildParams::$preset(), &mut Duration::default()))
            },
        }
    };
}

/// All of them.
pub fn all() -> [Peer; 8] {
    [
        obvhs!("obvhs, fastest", fastest_build),
        obvhs!("obvhs, very fast", very_fast_build),
        obvhs!("obvhs, fast", fast_build),
        obvhs!("obvhs, medium", medium_build),
        obvhs!("obvhs, slow", slow_build),
        obvhs!("obvhs, very slow", very_slow_build),
        Peer {
            name: "bvh",
            time: |triangles| {
                let mut shapes = of_bvh(triangles);
                time(|| bvh::bvh::Bvh::build_par(&mut shapes))
            },
            build: |triangles| Tree::Bvh(bvh::bvh::Bvh::build_par(&mut of_bvh(triangles))),
        },
        Peer {
            name: "parry3d",
            time: |triangles| {
                let corner = |p: &Vec3| parry3d::math::Vector::new(p.x, p.y, p.z);
                let corners: Vec<_> = triangles.iter().flatten().map(corner).collect();
                let indices = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
                time(|| TriMesh::new(corners, indices))
            },
            build: |_| Tree::Hidden,
        },
    ]
}

fn of_obvhs(triangles: &[[Vec3; 3]]) -> Vec<obvhs::triangle::Triangle> {
    let triangle = |corners: &[Vec3; 3]| {
        let [v0, v1, v2] = corners.map(Into::into);
        obvhs::triangle::Triangle { v0, v1, v2 }
    };
    triangles.iter().map(triangle).collect()
}

fn of_bvh(triangles: &[[Vec3; 3]]) -> Vec<Shape> {
    Shape::all(triangles)
}

impl Tree {
    /// Its cost, if the tree can be read.
    pub fn cost(&self) -> Option<f64> {
        match self {
            Self::Obvhs(tree) => Some(of_obvhs_tree(tree)),
            Self::Bvh(tree) => Some(of_bvh_tree(tree)),
            Self::Hidden => None,
        }
    }
}

fn of_obvhs_tree(tree: &Bvh2) -> f64 {
    let node = |index: usize| {
        let node = &tree.nodes[index];
        let primitives = if node.is_leaf() { node.prim_count } else { 0 };
        CostNode { area: half_area(node.aabb().min.into(), node.aabb().max.into()), primitives }
    };
    sah_cost(node, |index, list| {
        let first = tree.nodes[index].first_index as usize;
        list.extend([first, first + 1]);
    })
}

/// Its nodes have the boxes of their children: here a node stands for one of them.
fn of_bvh_tree(tree: &bvh::bvh::Bvh<f32, 3>) -> f64 {
    use bvh::bvh::BvhNode::{Leaf, Node};
    let corner = |p: &Point3<f32>| Vec3::new(p.x, p.y, p.z);
    let area = |aabb: &bvh::aabb::Aabb<f32, 3>| half_area(corner(&aabb.min), corner(&aabb.max));
    let mut areas = vec![0.0; tree.nodes.len()];
    for node in &tree.nodes {
        if let Node { child_l_index, child_l_aabb, child_r_index, child_r_aabb, .. } = node {
            areas[*child_l_index] = area(child_l_aabb);
            areas[*child_r_index] = area(child_r_aabb);
        }
    }
    if let Some(Node { child_l_aabb, child_r_aabb, .. }) = tree.nodes.first() {
        areas[0] = area(&child_l_aabb.join(child_r_aabb));
    }
    let node = |index: usize| {
        let primitives = u32::from(matches!(tree.nodes[index], Leaf { .. }));
        CostNode { area: areas[index], primitives }
    };
    sah_cost(node, |index, list| {
        if let Node { child_l_index, child_r_index, .. } = tree.nodes[index] {
            list.extend([child_l_index, child_r_index]);
        }
    })
}
