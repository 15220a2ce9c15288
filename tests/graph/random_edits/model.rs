//! The naive model of a scene: maps and vectors, without any index; every question is answered by a search through all.

use std::collections::{HashMap, HashSet};

use glam::DVec3;
use ropewalk::graph::{Change, NodePath, ObjectKey};
use ropewalk::{
    Core, CoreKey, Geometry, GeometryKey, Material, MaterialKey, NodeKey, Scene, Texture, TextureKey, Transform,
};

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ModelNode {
    pub(crate) parent: Option<NodeKey>,
    pub(crate) children: Vec<NodeKey>,
    pub(crate) core: CoreKey,
    pub(crate) name: String,
    pub(crate) mask: u32,
    pub(crate) visible: bool,
}

#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) root: NodeKey,
    pub(crate) nodes: HashMap<NodeKey, ModelNode>,
    pub(crate) cores: HashMap<CoreKey, Core>,
    pub(crate) geometries: HashMap<GeometryKey, Geometry>,
    pub(crate) materials: HashMap<MaterialKey, Material>,
    pub(crate) textures: HashMap<TextureKey, Texture>,
    /// Objects that have had a user.
    used: HashSet<ObjectKey>,
}

/// One step of a path from the root.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    pub(crate) node: NodeKey,
    /// Whether the step before instances the node.
    pub(crate) instanced: bool,
}

impl ModelNode {
    pub(crate) fn new(parent: Option<NodeKey>, core: CoreKey) -> Self {
        Self { parent, children: vec![], core, name: String::new(), mask: u32::MAX, visible: true }
    }
}

impl Model {
    pub(crate) fn new(scene: &Scene) -> Self {
        let (root, core) = (scene.root(), scene.core_key(scene.root()).unwrap());
        Self {
            root,
            nodes: HashMap::from([(root, ModelNode::new(None, core))]),
            cores: HashMap::from([(core, Core::Group)]),
            geometries: HashMap::new(),
            materials: HashMap::new(),
            textures: HashMap::new(),
            used: HashSet::from([core.into()]),
        }
    }

    pub(crate) fn core(&self, node: NodeKey) -> &Core {
        &self.cores[&self.nodes[&node].core]
    }

    pub(crate) fn users(&self, core: CoreKey) -> HashSet<NodeKey> {
        self.nodes.iter().filter(|(_, node)| node.core == core).map(|(&key, _)| key).collect()
    }

    pub(crate) fn preorder(&self, node: NodeKey) -> Vec<NodeKey> {
        let below = self.nodes[&node].children.iter().flat_map(|&child| self.preorder(child));
        std::iter::once(node).chain(below).collect()
    }

    /// The node, its parent, and so on.
    pub(crate) fn upwards(&self, node: NodeKey) -> Vec<NodeKey> {
        std::iter::successors(Some(node), |node| self.nodes[node].parent).collect()
    }

    /// Every path, by children and by instances, to the last node of `chain` and to every node below it.
    pub(crate) fn chains(&self, chain: Vec<Step>) -> Vec<Vec<Step>> {
        let node = chain.last().unwrap().node;
        let instanced = match *self.core(node) {
            Core::Instance(target) => Some(target),
            _ => None,
        };
        let instanced = instanced.map(|node| Step { node, instanced: true });
        let children = self.nodes[&node].children.iter().map(|&node| Step { node, instanced: false });
        let below = instanced.into_iter().chain(children);
        let longer = |next| chain.iter().copied().chain([next]).collect();
        let below: Vec<_> = below.flat_map(|next| self.chains(longer(next))).collect();
        std::iter::once(chain).chain(below).collect()
    }

    /// The node path of a chain from the root.
    pub(crate) fn path(chain: &[Step]) -> NodePath {
        let steps = chain.windows(2).filter(|step| step[1].instanced);
        NodePath { instances: steps.map(|step| step[0].node).collect(), node: chain.last().unwrap().node }
    }

    /// The path to a node by children only.
    pub(crate) fn chain(&self, node: NodeKey) -> Vec<Step> {
        self.upwards(node).into_iter().rev().map(|node| Step { node, instanced: false }).collect()
    }

    /// Whether a node would show itself if it stood below, or instanced, `target`.
    pub(crate) fn shows(&self, target: NodeKey, node: NodeKey) -> bool {
        let (mut open, mut seen) = (vec![target], HashSet::new());
        while let Some(next) = open.pop() {
            if next == node {
                return true;
            }
            if seen.insert(next) && self.nodes.contains_key(&next) {
                open.extend(&self.nodes[&next].children);
                if let Core::Instance(target) = *self.core(next) {
                    open.push(target);
                }
            }
        }
        false
    }

    /// Whether the switch above a node, if there is one, shows it.
    pub(crate) fn is_chosen(&self, node: NodeKey) -> bool {
        let Some(parent) = self.nodes[&node].parent else { return true };
        let Core::Switch(switch) = self.core(parent) else { return true };
        let number = self.nodes[&parent].children.iter().position(|&child| child == node).unwrap();
        switch.shows(number as u32)
    }

    /// A local point in the world, and the largest number of the computation, to which rounding errors are relative.
    pub(crate) fn to_world(&self, node: NodeKey, point: DVec3) -> (DVec3, f64) {
        self.to_world_up(&self.upwards(node), point)
    }

    /// The same for a path towards the root.
    pub(crate) fn to_world_up(&self, upwards: &[NodeKey], point: DVec3) -> (DVec3, f64) {
        let (mut point, mut magnitude) = (point, point.abs().max_element());
        for &node in upwards {
            if let Core::Transform(transform) = self.core(node) {
                let (moved, growth) = apply(transform, point);
                point = moved;
                magnitude = (magnitude * growth).max(point.abs().max_element());
            }
        }
        (point, magnitude)
    }

    /// Frees objects that lost their last user, until there are none left. With `all` also those that never had one.
    pub(crate) fn collect(&mut self, all: bool) {
        loop {
            let of_core = |core: &Core| match *core {
                Core::Geometry { geometry, material } => vec![geometry.into(), material.into()],
                Core::MaterialGroup(material) => vec![material.into()],
                _ => vec![],
            };
            let by_nodes = self.nodes.values().map(|node| ObjectKey::from(node.core));
            let by_cores = self.cores.values().flat_map(of_core);
            let by_materials = self.materials.values().flat_map(Material::textures).map(|t| t.texture.into());
            let in_use: HashSet<ObjectKey> = by_nodes.chain(by_cores).chain(by_materials).collect();
            self.used.extend(&in_use);

            let used = &self.used;
            let keep = |object: ObjectKey| in_use.contains(&object) || (!all && !used.contains(&object));
            let count = self.count();
            self.cores.retain(|&key, _| keep(key.into()));
            self.geometries.retain(|&key, _| keep(key.into()));
            self.materials.retain(|&key, _| keep(key.into()));
            self.textures.retain(|&key, _| keep(key.into()));
            if self.count() == count {
                return;
            }
        }
    }

    fn count(&self) -> usize {
        self.cores.len() + self.geometries.len() + self.materials.len() + self.textures.len()
    }

    /// The objects whose state differs in `later`.
    pub(crate) fn changes_to(&self, later: &Self) -> Vec<(ObjectKey, Change)> {
        let mut changes = Vec::new();
        compare_maps(&self.nodes, &later.nodes, &mut changes, |old, new| {
            let flags = [
                (Change::PARENT, old.parent != new.parent),
                (Change::CORE, old.core != new.core),
                (Change::MASK, old.mask != new.mask),
                (Change::VISIBILITY, old.visible != new.visible),
                (Change::NAME, old.name != new.name),
                (Change::CHILDREN, old.children != new.children),
            ];
            flags.into_iter().filter(|(_, differs)| *differs).map(|(flag, _)| flag).collect()
        });
        compare_maps(&self.cores, &later.cores, &mut changes, |old, new| match (old, new) {
            (old, new) if old == new => Change::empty(),
            (Core::Transform(_), Core::Transform(_)) => Change::TRANSFORM,
            (Core::Transform(_), _) | (_, Core::Transform(_)) => Change::TRANSFORM | Change::KIND | Change::DATA,
            _ if old.kind() != new.kind() => Change::KIND | Change::DATA,
            _ => Change::DATA,
        });
        compare_maps(&self.geometries, &later.geometries, &mut changes, data_differs);
        compare_maps(&self.materials, &later.materials, &mut changes, data_differs);
        compare_maps(&self.textures, &later.textures, &mut changes, data_differs);
        changes
    }
}

fn data_differs<T: PartialEq>(old: &T, new: &T) -> Change {
    if old == new { Change::empty() } else { Change::DATA }
}

fn compare_maps<K: Copy + Eq + std::hash::Hash + Into<ObjectKey>, V>(
    old: &HashMap<K, V>,
    new: &HashMap<K, V>,
    changes: &mut Vec<(ObjectKey, Change)>,
    compare: impl Fn(&V, &V) -> Change,
) {
    for (&key, value) in new {
        let change = old.get(&key).map_or(Change::ADDED, |old| compare(old, value));
        if !change.is_empty() {
            changes.push((key.into(), change));
        }
    }
    changes.extend(old.keys().filter(|key| !new.contains_key(key)).map(|&key| (key.into(), Change::REMOVED)));
}

/// The point in the parent's space, and the greatest factor by which a length grows there.
fn apply(transform: &Transform, point: DVec3) -> (DVec3, f64) {
    match *transform {
        Transform::Pivoted { .. } => apply(&Transform::Matrix(transform.to_affine()), point),
        Transform::Trs { translation, rotation, scale } => {
            (rotation * (scale * point) + translation, scale.abs().max_element())
        }
        Transform::Matrix(affine) => {
            let columns = (0..3).map(|i| affine.matrix3.col(i).length());
            (affine.transform_point3(point), columns.sum())
        }
    }
}
