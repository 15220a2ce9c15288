//! A plain hierarchy of boxes: split at the median of the widest axis.

use glam::DVec3;

const LEAF_SIZE: usize = 4;

/// A box and what is in it.
#[derive(Clone, Copy, Debug)]
pub struct TreeNode {
    /// Least corner.
    pub min: DVec3,
    /// Greatest corner.
    pub max: DVec3,
    /// Of a leaf: the first of its items in [`Tree::order`]. Else the index of the second child; the first follows this
    /// node.
    pub first: u32,
    /// The number of items of a leaf; 0 of an inner node.
    pub count: u32,
}

/// The hierarchy.
#[derive(Clone, Debug, Default)]
pub struct Tree {
    /// Depth first. Empty without items.
    pub nodes: Vec<TreeNode>,
    /// The items, leaf after leaf.
    pub order: Vec<u32>,
}

impl Tree {
    /// Over triangles.
    pub fn new(triangles: &[[DVec3; 3]]) -> Self {
        let mut tree = Self { nodes: Vec::new(), order: (0..triangles.len() as u32).collect() };
        let mut order = std::mem::take(&mut tree.order);
        if !order.is_empty() {
            tree.add(triangles, &mut order, 0);
        }
        Self { order, ..tree }
    }

    fn add(&mut self, triangles: &[[DVec3; 3]], items: &mut [u32], first: u32) {
        let corners = |item: u32| triangles[item as usize];
        let all = || items.iter().flat_map(|&item| corners(item));
        let min = all().fold(DVec3::INFINITY, DVec3::min);
        let max = all().fold(DVec3::NEG_INFINITY, DVec3::max);
        let index = self.nodes.len();
        self.nodes.push(TreeNode { min, max, first, count: items.len() as u32 });
        if items.len() <= LEAF_SIZE {
            return;
        }
        let axis = (max - min).max_position();
        let center = |item: u32| corners(item).iter().map(|corner| corner[axis]).sum::<f64>();
        let middle = items.len() / 2;
        items.select_nth_unstable_by(middle, |&a, &b| center(a).total_cmp(&center(b)));
        let (left, right) = items.split_at_mut(middle);
        self.add(triangles, left, first);
        (self.nodes[index].first, self.nodes[index].count) = (self.nodes.len() as u32, 0);
        self.add(triangles, right, first + middle as u32);
    }

    /// Visits the items of all leaves in boxes that `enters` admits, first child first. Both functions get the state,
    /// so that what has been found can spare boxes.
    pub fn visit<S>(&self, state: &mut S, enters: impl Fn(&S, &TreeNode) -> bool, mut visit: impl FnMut(&mut S, u32)) {
        let mut pending = Vec::with_capacity(64);
        pending.extend((!self.nodes.is_empty()).then_some(0));
        while let Some(index) = pending.pop() {
            let node = &self.nodes[index as usize];
            if !enters(state, node) {
                continue;
            }
            if node.count == 0 {
                pending.extend([node.first, index + 1]);
            }
            for &item in &self.order[node.first as usize..][..node.count as usize] {
                visit(state, item);
            }
        }
    }
}
