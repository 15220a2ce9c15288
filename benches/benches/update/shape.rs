//! The trees that are measured, and how their nodes move.

use glam::{DQuat, DVec3};

/// The shape of a tree of a given number of nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// All nodes are roots.
    Flat,
    /// As many branches as leaves on each branch.
    Wide,
    /// A chain: each node below the one before.
    Chain,
    /// Skeletons of 100 joints each.
    Humanoids,
}

impl Shape {
    pub const ALL: [Self; 4] = [Self::Flat, Self::Wide, Self::Chain, Self::Humanoids];

    pub fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Wide => "wide",
            Self::Chain => "chain",
            Self::Humanoids => "humanoids",
        }
    }

    /// The parent of each node, which stands before it; `None` at the top.
    pub fn parents(self, count: usize) -> Vec<Option<usize>> {
        let branch = (count as f64).sqrt() as usize;
        let parent = |node: usize| match self {
            Self::Flat => None,
            Self::Wide => node.checked_sub(1).map(|place| if place % branch == 0 { 0 } else { node - place % branch }),
            Self::Chain => node.checked_sub(1),
            Self::Humanoids => {
                let first = node - node % HUMANOID;
                humanoid(node % HUMANOID).map(|joint| first + joint)
            }
        };
        (0..count).map(parent).collect()
    }
}

/// Joints of a skeleton.
pub const HUMANOID: usize = 100;

/// The parent of a joint: hips, spine and neck; a face; arms with fingers; legs with toes and helpers.
fn humanoid(joint: usize) -> Option<usize> {
    const CHEST: usize = 5;
    const HEAD: usize = 7;
    Some(match joint {
        0 => return None,
        1..=HEAD => joint - 1,
        8..=27 => HEAD,
        28..=75 => limb(joint, 28 + (joint - 28) / 24 * 24, CHEST),
        _ => limb(joint, 76 + (joint - 76) / 12 * 12, 1),
    })
}

/// Four joints in a row from `above` down, and digits of four joints each.
fn limb(joint: usize, first: usize, above: usize) -> usize {
    match joint - first {
        0 => above,
        1..=3 => joint - 1,
        digit if digit % 4 == 0 => first + 3,
        _ => joint - 1,
    }
}

/// The pose of a joint in its parent's space.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    pub translation: DVec3,
    pub rotation: DQuat,
}

impl Pose {
    /// A small random turn and step, so that products along a million nodes stay in range.
    pub fn random(random: &mut fastrand::Rng) -> Self {
        let mut number = || random.f64() - 0.5;
        let translation = DVec3::new(number(), number(), number());
        Self { translation, rotation: DQuat::from_scaled_axis(DVec3::new(number(), number(), number())) }
    }
}

/// `count` different numbers below `below`.
pub fn choose(random: &mut fastrand::Rng, count: usize, below: usize) -> Vec<usize> {
    if count == below {
        return (0..below).collect();
    }
    random.choose_multiple(0..below, count)
}
