//! The node hierarchy of a file, validated as a forest.

use std::path::Path;

use ::gltf::json;
use glam::DAffine3;

use super::{HierarchyFault, error_at};
use crate::Result;
use crate::graph::Transform;

/// The parent of each node and a topological order; proven to be a forest.
pub(super) struct NodeForest {
    /// The parent of each node.
    pub(super) parents: Vec<Option<usize>>,
    /// All nodes, parents before children.
    order: Vec<usize>,
}

impl NodeForest {
    /// Checks that no node has two parents or is its own ancestor, and that scenes list each node once.
    /// O(nodes).
    pub(super) fn new(nodes: &[json::Node], scenes: &[json::Scene], path: &Path) -> Result<Self> {
        // 1. The parent of each node: at most one.
        let mut parents = vec![None; nodes.len()];
        for (parent, node) in nodes.iter().enumerate() {
            for (k, child) in children(node).enumerate() {
                if let Some(other) = parents[child].replace(parent) {
                    let cause = HierarchyFault::TwoParents { child, other };
                    return Err(error_at(path, format!("/nodes/{parent}/children/{k}"), cause));
                }
            }
        }

        // 2. A topological order. Since each node has one parent, those that no root reaches are on or below a cycle.
        let order = topological_order(nodes, &parents);
        if order.len() < nodes.len() {
            let mut reached = vec![false; nodes.len()];
            order.iter().for_each(|&i| reached[i] = true);
            let unreached = reached.iter().position(|&r| !r).unwrap_or(0);
            return Err(error_at(path, format!("/nodes/{unreached}"), HierarchyFault::Cycle));
        }

        // 3. The roots of scenes.
        check_scenes(scenes, nodes.len(), path)?;
        Ok(Self { parents, order })
    }

    /// The nodes without a parent, which are shown if the file has no scene.
    pub(super) fn roots(&self) -> Vec<usize> {
        (0..self.parents.len()).filter(|&i| self.parents[i].is_none()).collect()
    }

    /// Where scenes list a node that has a parent: the JSON pointer and the fault of each, one by one.
    pub(super) fn scene_roots_with_parents<'s>(
        &'s self,
        scenes: &'s [json::Scene],
    ) -> impl Iterator<Item = (String, HierarchyFault)> + 's {
        let roots = |(s, scene): (usize, &'s json::Scene)| {
            scene.nodes.iter().enumerate().map(move |(k, node)| (s, k, node.value()))
        };
        let fault = |(s, k, node): (usize, usize, usize)| {
            let parent = self.parents[node]?;
            Some((format!("/scenes/{s}/nodes/{k}"), HierarchyFault::NotARoot { node, parent }))
        };
        scenes.iter().enumerate().flat_map(roots).filter_map(fault)
    }

    /// The matrix from each node's space to the space of the scene, whose roots may be children of other nodes.
    /// O(nodes).
    pub(super) fn scene_from_node(&self, transforms: &[Transform], is_root: &[bool]) -> Vec<DAffine3> {
        let mut world = vec![DAffine3::IDENTITY; transforms.len()];
        // Parents come first, so that their matrices are known.
        for &i in &self.order {
            let local = transforms[i].to_affine();
            let parent = self.parents[i].filter(|_| !is_root[i]);
            world[i] = parent.map_or(local, |parent| world[parent] * local);
        }
        world
    }
}

/// The indices of a node's children; [`references`](super::references) has checked them.
pub(super) fn children(node: &json::Node) -> impl DoubleEndedIterator<Item = usize> {
    node.children.iter().flatten().map(json::Index::value)
}

fn topological_order(nodes: &[json::Node], parents: &[Option<usize>]) -> Vec<usize> {
    // Begin with the roots, and append the children of each node in turn.
    let mut order: Vec<usize> = (0..nodes.len()).filter(|&i| parents[i].is_none()).collect();
    let mut next = 0;
    while let Some(&i) = order.get(next) {
        order.extend(children(&nodes[i]));
        next += 1;
    }
    order
}

fn check_scenes(scenes: &[json::Scene], node_count: usize, path: &Path) -> Result<()> {
    // The last scene that listed each node tells whether a scene lists a node twice.
    let mut last_scene = vec![None; node_count];
    for (s, scene) in scenes.iter().enumerate() {
        for (k, node) in scene.nodes.iter().map(json::Index::value).enumerate() {
            let pointer = || format!("/scenes/{s}/nodes/{k}");
            if last_scene[node].replace(s) == Some(s) {
                return Err(error_at(path, pointer(), HierarchyFault::ListedTwice { node }));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use glam::DVec3;
    use serde::Deserialize;
    use serde_json::json;

    fn hierarchy(nodes: serde_json::Value, scenes: serde_json::Value) -> Result<NodeForest> {
        let nodes = Vec::<json::Node>::deserialize(nodes).unwrap();
        let scenes = Vec::<json::Scene>::deserialize(scenes).unwrap();
        NodeForest::new(&nodes, &scenes, Path::new("a.gltf"))
    }

    #[test]
    fn forests_only() {
        let forest = json!([{"children": [2]}, {}, {"children": [3]}, {}]);
        assert_eq!(hierarchy(forest.clone(), json!([{"nodes": [0, 1]}, {"nodes": [1]}])).unwrap().roots(), [0, 1]);

        for (nodes, scenes, fault) in [
            (json!([{"children": [0]}]), json!([]), HierarchyFault::Cycle),
            (json!([{"children": [1]}, {"children": [2]}, {"children": [0]}]), json!([]), HierarchyFault::Cycle),
            (json!([{}, {"children": [2]}, {"children": [1]}]), json!([]), HierarchyFault::Cycle),
            (
                json!([{"children": [2]}, {"children": [2]}, {}]),
                json!([]),
                HierarchyFault::TwoParents { child: 2, other: 0 },
            ),
            (json!([{"children": [1, 1]}, {}]), json!([]), HierarchyFault::TwoParents { child: 1, other: 0 }),
            (forest.clone(), json!([{"nodes": [1, 1]}]), HierarchyFault::ListedTwice { node: 1 }),
        ] {
            let Err(Error::Gltf { cause, .. }) = hierarchy(nodes, scenes) else { panic!("no error: {fault}") };
            assert_eq!(cause, fault.into());
        }
        let scenes = Vec::<json::Scene>::deserialize(json!([{"nodes": [1]}, {"nodes": [0, 2]}])).unwrap();
        let nodes = Vec::<json::Node>::deserialize(forest).unwrap();
        let forest = NodeForest::new(&nodes, &scenes, Path::new("a.gltf")).unwrap();
        let found: Vec<_> = forest.scene_roots_with_parents(&scenes).collect();
        assert_eq!(found, [("/scenes/1/nodes/1".to_owned(), HierarchyFault::NotARoot { node: 2, parent: 0 })]);
    }

    #[test]
    fn a_long_chain_needs_no_stack() {
        let count = 200_000;
        let nodes = (0..count)
            .map(|i| if i + 1 < count { json!({"children": [i + 1], "translation": [1, 0, 0]}) } else { json!({}) })
            .collect();
        let chain = hierarchy(nodes, json!([])).unwrap();
        let transforms = vec![Transform::from_translation(DVec3::X); count];
        assert_eq!(
            chain.scene_from_node(&transforms, &vec![false; count])[count - 1].translation,
            DVec3::new(count as f64, 0.0, 0.0)
        );
    }
}
